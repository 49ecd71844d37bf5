"""Connections of robots with loops along paths that state all joints.

Such a path needs no chart, so it passes dead points of any joints.  Its shapes are replaced by the
nearest closed ones: y minimises ½ |y − x|² with φ(y) = 0, so

    W (y − x) + J(y)ᵀ λ = 0,   φ(y) = 0,   [W + ∂(Jᵀλ) Jᵀ; J 0] [ẏ; λ̇] = [W ẋ; 0],

where the diagonal matrix W divides metres by the size of the loops.  ẏ is the exact derivative of
y along the path, so the phase depends on the closed path alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np

from ...common.arrays import Array, rows
from ...common.errors import InputError
from ...common.memo import once
from ...common.names import quoted
from ...kernels.connection.connection_code import ConnectionCode, Locals, Velocities
from ...reduction.tree.body_frames import bodies_of
from ...reduction.tree.loop_constraints import constraint_values, jacobian_function
from ...simulation.closed_loops import refuse_singular_shapes
from ...system.loops.loop_assembly import describe_gap, loop_gaps, rate_units
from ...system.system import System
from ..gaits.gait import Gait
from .connection import Connection
from .loop_connection import LoopConnectionCode

_OPEN = 1e-2  # largest gap of a loop along a path, relative to its size
_ITERATIONS = 20  # largest number of Newton steps
_CLOSED = 1e-13  # largest change of a joint in the last Newton step [rad | m]
_SHUT = 1e-10  # largest gap of a loop that counts as closed, relative to its size
_ROUND_OFF = 1e-11  # largest change that ends the iteration if it does not shrink any more
_CHUNK = 1024  # number of shapes that are closed at once
_KNOTS = 65  # number of times between which dependent equations are sought


@dataclass(frozen=True, eq=False)
class AllJointsCode(ConnectionCode):
    """A connection along paths of all joints, (N, m), of a robot with loops.

    Attributes:
        form: Form of the open tree.
        tree: Machine code of the open tree's connection.
        system: The robot.
    """

    tree: ConnectionCode = field(repr=False)
    system: System = field(repr=False)

    def velocities(self, x: Array, xdot: Array) -> Velocities:
        """Compute the horizontal motions."""
        return self.tree.velocities(*self.closed(x, xdot))

    def locals(self, x: Array) -> Locals:
        """Compute the matrix of the form, the local connection, and the metric, of the tree."""
        return self.tree.locals(self.closed(x, np.zeros_like(x))[0])

    def closed(self, x: Array, xdot: Array) -> tuple[Array, Array]:
        """Return the nearest closed shapes and their rates, (N, m) each.

        Args:
            x: Shapes, (N, m) [rad | m].
            xdot: Rates, (N, m).
        Raises:
            InputError: A loop is open; the message names it and its gap. Or no closed shape is
                found nearby.
        """
        x, xdot = rows(x, self.form.nx, "x"), rows(xdot, self.form.m, "xdot")
        shapes, rates = np.empty_like(x), np.empty_like(xdot)
        for start in range(0, len(x), _CHUNK):
            chunk = slice(start, start + _CHUNK)
            shapes[chunk], rates[chunk] = self._nearest(x[chunk], xdot[chunk])
        return shapes, rates

    def _nearest(self, x: Array, xdot: Array) -> tuple[Array, Array]:
        """Solve for the nearest closed shapes by Newton's method; return them and their rates."""
        closure = self.system.closure
        assert closure is not None
        count, m, k = len(x), self.form.m, closure.rank
        weight = rate_units(self.system, closure.length) ** -2.0
        self._refuse_open(x)
        y, nu, size = x, np.zeros((count, k)), np.inf
        for _ in range(_ITERATIONS):
            phi, J, bends = self._terms(y, nu)
            matrix = self._matrix(weight, J, bends)
            residual = np.concatenate(
                [weight * (y - x) + np.einsum("nkm,nk->nm", J, nu), phi], axis=1
            )
            step = np.linalg.solve(matrix, residual[..., None])[..., 0]
            y, nu, last, size = (
                y - step[:, :m], nu - step[:, m:], size, np.abs(step[:, :m]).max(initial=0.0),
            )  # fmt: skip
            if size <= _CLOSED or (size < _ROUND_OFF and size >= last):
                break
        phi, J, bends = self._terms(y, nu)
        worst = int(np.argmax(np.abs(phi).max(axis=1)))
        if not loop_gaps(self.system, y[worst], closure.length).max() <= _SHUT:
            raise InputError(
                f"gait: no closed shape of {quoted(self.system.name)} was found near x = "
                f"{x[worst]} in {_ITERATIONS} Newton steps. LoopReduction.shape returns closed "
                "shapes."
            )
        matrix = self._matrix(weight, J, bends)
        right = np.concatenate([weight * xdot, np.zeros((count, k))], axis=1)
        return y, np.linalg.solve(matrix, right[..., None])[:, :m, 0]

    def _refuse_open(self, x: Array) -> None:
        """Raise InputError if a loop is open at a shape (N, m)."""
        system, closure = self.system, self.system.closure
        assert closure is not None
        phi = np.abs(np.array(self._function(x.T, np.zeros((closure.rank, len(x))))[0]))
        worst = int(np.argmax(phi.max(axis=0)))
        gaps = loop_gaps(system, x[worst], closure.length)
        if not gaps.max() <= _OPEN:
            raise InputError(
                f"gait: expected a path of closed shapes of {quoted(system.name)}, but "
                f"{describe_gap(system, gaps, closure.length)} at x = {x[worst]}. "
                "LoopReduction.shape returns closed shapes."
            )

    @staticmethod
    def _matrix(weight: Array, J: Array, bends: Array) -> Array:
        """Return the matrices of the Newton steps, (N, m + k, m + k)."""
        count, k, m = J.shape
        matrix = np.zeros((count, m + k, m + k))
        matrix[:, :m, :m] = np.diag(weight) + bends
        matrix[:, :m, m:], matrix[:, m:, :m] = np.swapaxes(J, 1, 2), J
        return matrix

    def _terms(self, y: Array, nu: Array) -> tuple[Array, Array, Array]:
        """Return φ (N, k), J (N, k, m) and ∂(Jᵀλ) (N, m, m)."""
        count, m, k = len(y), self.form.m, nu.shape[1]
        phi, bends = (np.array(value) for value in self._function.map(count)(y.T, nu.T))
        J = np.array(jacobian_function(self.system).map(count)(y.T)).T
        return (
            phi.T,
            np.swapaxes(J.reshape(count, m, k), 1, 2),
            bends.T.reshape(count, m, m),
        )

    @property
    def _function(self) -> ca.Function:
        """CasADi function of φ(x), and of the derivative of Jᵀλ, both at (x, λ)."""
        system = self.system

        def make() -> ca.Function:
            closure = system.closure
            assert closure is not None
            x, nu = ca.SX.sym("x", system.nx), ca.SX.sym("nu", closure.rank)
            phi = ca.vertcat(*constraint_values(system, bodies_of(system), ca.vertsplit(x)))
            bends = ca.jacobian(ca.gradient(ca.dot(phi, nu), x), x)
            options = {"cse": True}
            return ca.Function("closing", [x, nu], [ca.densify(phi), ca.densify(bends)], options)

        return once(system, AllJointsCode, make)


def along_all_joints(connection: Connection, gait: Gait) -> Connection:
    """Return the connection over all joints, if a gait of a robot with loops states all of them.

    Args:
        connection: Any connection.
        gait: Path of independent joints, or of all joints.
    Returns:
        The connection itself, unless the gait states all joints.
    Raises:
        InputError: The robot has balls, or a loop is open along the path.
        IntegrationError: The path passes a shape at which the loops' equations are dependent; the
            message names the loops and the shape.
    """
    code = connection.code
    if not isinstance(code, LoopConnectionCode) or gait.m == connection.m:
        return connection
    system = code.chart_system
    if gait.m != system.m:
        raise InputError(
            f"gait: expected {connection.m} independent joints ({', '.join(connection.joints)}), "
            f"or all {system.m} joints of {quoted(system.name)}, got {gait.m}"
        )
    if balls := [ball.name for ball in system.space.balls]:
        raise InputError(
            "gait: a path of all joints of a robot with loops cannot contain balls, and "
            f"{quoted(system.name)} has {', '.join(balls)}. State the independent joints."
        )
    joined = AllJointsCode(code.tree.form, code.tree, system)

    def shapes_at(t: Array) -> Array:
        x, xdot = gait.at(t)
        return joined.closed(x, xdot)[0]

    refuse_singular_shapes(system, np.linspace(0.0, gait.period, _KNOTS), shapes_at)
    return replace(connection, form=joined.form, code=joined)
