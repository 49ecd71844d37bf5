"""The robot of the page: its connection, its sliders, and shapes within their limits.

The page uses coordinates w of the open tree, (m,), in which a ball is a rotation vector.  Sliders
move the independent coordinates u, (d,).  Without closed loops, u = w.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...analysis.connections.connection import Connection
from ...analysis.connections.loop_connection import LoopConnectionCode
from ...common.arrays import Array, FrozenArrays
from ...common.errors import InputError, PinredError
from ...system.loops.loop_chart import LoopChart
from ...system.system import System

_FARTHEST = np.pi  # largest range of a joint without narrower limits [rad | m]
_SHRINKING = (1.0, 0.5, 0.25, 0.1, 0.0)  # fractions of the way to a shape that may be out of reach


@dataclass(frozen=True, eq=False)
class FeltRobot(FrozenArrays):
    """A robot that is moved by hand; arrays are read-only.

    Attributes:
        connection: Connection of the open tree, in rotation vectors of balls.
        moved: Connection over the independent coordinates.
        system: The system.
        chart: Independent joints of a robot with closed loops, or None.
        independent: Indices of the independent coordinates, (d,).
        names: Names of the independent coordinates, (d,).
        units: Their units, (d,).
        rest: Coordinates w of the first shape, (m,).
        low: Lower limits of all coordinates, (m,) [rad | m].
        high: Upper limits, (m,) [rad | m].
    """

    connection: Connection
    moved: Connection
    system: System
    chart: LoopChart | None
    independent: NDArray[np.intp]
    names: tuple[str, ...]
    units: tuple[str, ...]
    rest: Array
    low: Array
    high: Array

    @property
    def dim(self) -> int:
        """Number of independent coordinates, d."""
        return len(self.independent)

    def shape(self, u: Array) -> Array:
        """Return the shape of the system at independent coordinates u (d,), (nx,).

        Raises:
            SingularInertiaError: The loops do not close there.
        """
        if self.chart is not None:
            return np.asarray(self.chart.shapes(u[None])[0])
        return u if self.moved.chart is None else self.moved.chart.shapes(u)

    def random(self, count: int) -> list[Array]:
        """Return independent coordinates within the limits, of which the first are at rest.

        Args:
            count: Number of shapes.
        Returns:
            Coordinates, (d,) each, at which the loops close.
        """
        rng, start = np.random.default_rng(0), self.rest[self.independent]
        low, high = self.low[self.independent], self.high[self.independent]
        found = [start]
        for u in rng.uniform(low, high, (count - 1, self.dim)):
            for part in _SHRINKING:
                with suppress(PinredError):  # the loops do not close there
                    self.shape(start + part * (u - start))
                    found.append(start + part * (u - start))
                    break
        return found


def felt_robot(source: System | Connection) -> FeltRobot:
    """Return the robot of a system, or of a connection of a system.

    Args:
        source: A system, whose mechanical connection is used, or a connection of a system.
    Returns:
        The robot.
    Raises:
        InputError: There are no joints, or the connection has no system.
        SymmetryError: Gravity changes the momenta.
    """
    connection = source if isinstance(source, Connection) else Connection.mechanical(source)
    connection.refuse_gravity()
    code = connection.code
    chart = code.chart if isinstance(code, LoopConnectionCode) else None
    system = code.chart_system if isinstance(code, LoopConnectionCode) else connection.system
    if system is None:
        raise InputError("feel: expected a System, or a Connection of a System as loaded")
    if not connection.m:
        raise InputError(f"feel: '{system.name}' has no joints to move")
    if chart is None:
        moved = tree = connection.in_chart()
        rest, independent = np.zeros(system.m), np.arange(system.m, dtype=np.intp)
    else:
        moved, (tree, rest) = connection, _open_tree(system)
        independent = chart.independent.copy()
    low, high = _limits(tree, system)
    if chart is None:
        rest = np.clip(rest, low, high)
    else:  # the assembled shape may be beyond the limits
        low, high = np.minimum(low, rest), np.maximum(high, rest)
    return FeltRobot(
        connection=tree,
        moved=moved,
        system=system,
        chart=chart,
        independent=independent,
        names=tuple(system.space.names[k] for k in independent),
        units=tuple(system.units[k] for k in independent),
        rest=rest,
        low=low,
        high=high,
    )


def _open_tree(system: System) -> tuple[Connection, Array]:
    """Return the connection of the tree of a robot with loops, and a closed shape, (m,)."""
    assert system.closure is not None
    tree, closed = system.open_tree(), np.asarray(system.closure.x)
    centre, rest = np.array(system.space.neutral), np.zeros(system.m)
    for joint in system.space.joints:
        if joint.kind.is_ball:
            centre[joint.x] = closed[joint.x]
        else:
            rest[joint.v] = closed[joint.x]
    connection = Connection.mechanical(tree)
    return connection.in_chart(centre if system.space.balls else None), rest


def _limits(connection: Connection, system: System) -> tuple[Array, Array]:
    """Return the limits of all coordinates, (m,) [rad | m]."""
    model, space = system.sorted_model, system.space
    low, high = np.full(system.m, -_FARTHEST), np.full(system.m, _FARTHEST)
    for joint in space.joints:
        number = model.joints[model.getJointId(joint.name)]
        if joint.kind.m == 1 and number.nq == 1:
            least, most = (
                float(limit[number.idx_q])
                for limit in (model.lowerPositionLimit, model.upperPositionLimit)
            )
            centre = 0.0 if connection.chart is None else float(connection.chart.centre[joint.x][0])
            if least < most:
                low[joint.v] = max(least - centre, -_FARTHEST)
                high[joint.v] = min(most - centre, _FARTHEST)
    wrong = ~(low < high)
    low[wrong], high[wrong] = -_FARTHEST, _FARTHEST
    return low, high
