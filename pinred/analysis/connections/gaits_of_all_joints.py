"""Connections of robots with loops along paths that state all joints.

Such a path needs no chart, so it passes dead points of any joints.  Its shapes are replaced by the
nearest closed ones: y minimises ½ |y − x|² with φ(y) = 0, so

    W (y − x) + J(y)ᵀ λ = 0,   φ(y) = 0,   [W + ∂(Jᵀλ) Jᵀ; J 0] [ẏ; λ̇] = [W ẋ; 0],

where the diagonal matrix W divides metres by the size of the loops.  ẏ is the exact derivative of
y along the path, so the phase depends on the closed path alone.

At a dead point two branches of closed shapes meet, on which the independent joints have the same
values.  A smooth path of these joints that touches such values continues smoothly on the other
branch, as the rocker of a turning crank does.  The path is tracked in time through regular shapes,
and interpolated across each dead point, where the independent joints do not determine the others.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array, rows
from ...common.errors import InputError, SingularInertiaError
from ...common.memo import once
from ...common.names import quoted
from ...kernels.connection.connection_code import ConnectionCode, Locals, Velocities
from ...lie.rotations import TAU
from ...reduction.tree.body_frames import bodies_of
from ...reduction.tree.loop_constraints import constraint_values, jacobian_function
from ...simulation.closed_loops import refuse_singular_shapes
from ...system.loops.independent_joints import LoopChart
from ...system.loops.loop_assembly import describe_gap, loop_gaps, rate_units
from ...system.system import System
from ..phases.gait import Gait
from .connection import Connection
from .loop_connection import ClosedPath, LoopConnectionCode

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


_COARSE = 192  # number of times at which dead points are sought
_SUSPECT = 0.15  # smallest ratio of singular values that excludes a dead point between these times
_REGULAR = 4e-3  # smallest ratio of singular values at which a shape is determined by its joints
_SAMPLES = 1024  # number of times of the tracked path, for 64 harmonics
_STARTS = 128  # number of these times from which the path may be tracked
_HISTORY = 6  # number of past shapes from which the next one is extrapolated
_SIDE = 8  # number of shapes on each side of a dead point from which those between are interpolated
_WIDEST = 48  # largest number of shapes that are interpolated
_TOUCHED = 1e-8  # largest distance of the independent joints from a path through dead points [rad]
_SMALLEST = 1e-15  # smallest Fourier coefficient that is kept, relative to the largest
_RESOLVED = 1e-9  # largest Fourier coefficient beyond those that are kept, likewise


def along_joints(connection: Connection, gait: Gait) -> tuple[Connection, Gait]:
    """Return the connection and the gait with which a phase is computed.

    Args:
        connection: Any connection.
        gait: Path in its shape space, or of all joints of a robot with loops.
    Returns:
        Both of them, unless the robot has loops and the gait states all joints, or passes dead
        points of the independent ones: then a connection and a gait of all joints.
    Raises:
        InputError: A loop is open along a path of all joints.
        SingularInertiaError: The closed shapes do not return with the independent joints.
        IntegrationError: The path passes a shape at which the loops' equations are dependent.
    """
    code = connection.code
    if isinstance(code, LoopConnectionCode) and gait.m == connection.m:
        gait = through_dead_points(code, gait) or gait
    return along_all_joints(connection, gait), gait


def through_dead_points(code: LoopConnectionCode, gait: Gait) -> Gait | None:
    """Return a gait of all joints for a gait of the independent joints that passes dead points.

    The gait begins on the branch of the assembled shape.

    Args:
        code: Connection of a robot with loops, over independent joints.
        gait: Path of the independent joints.
    Returns:
        The gait of all joints; None if the gait does not touch a dead point, or is not one Fourier
        series.
    Raises:
        SingularInertiaError: The closed shapes do not return with the independent joints.
    """
    if not gait.is_smooth or code.chart_system.space.balls or not _meets(code.chart, gait):
        return None
    harmonics = len(getattr(gait.arcs[0], "cos", ()))
    count = _SAMPLES * (1 + harmonics // 64)
    t = np.arange(count + 1) * (gait.period / count)
    u = gait.at(t)[0]
    starts = ((k, _start(code.chart, u[k])) for k in range(0, count, count // _STARTS))
    first, start = next(((k, x) for k, x in starts if x is not None), (0, None))
    if start is None:
        return None
    # One cycle from the first regular shape; indices are cyclic, with turns added after the end.
    u, _ = gait.at(t + first * (gait.period / count))
    x, is_known = _tracked(code.chart, start, u)
    if x is None:
        return None
    turns = np.round((x[-1] - x[0]) / TAU)
    rise = TAU * turns
    if not np.abs(x[-1] - x[0] - rise).max() <= _TOUCHED:
        raise SingularInertiaError(
            f"the gait passes a dead point of {', '.join(code.chart.names)}, and the other joints "
            f"do not return: from x = {x[0]} to {x[-1]}. State a gait of all joints, or one that "
            "passes each dead point an even number of times."
        )
    x = _filled(x[:-1], is_known[:-1], rise)
    if x is None:
        return None
    closed, _ = AllJointsCode(code.tree.form, code.tree, code.chart_system).closed(x, 0.0 * x)
    at = code.chart_system.space.coordinates_of(code.chart.independent.tolist())
    if not np.abs(closed[:, at] - u[:-1]).max() <= _TOUCHED:
        return None
    closed[:, at] = u[:-1]
    return _as_gait(closed, turns, gait.period, -first / count)


def _meets(chart: LoopChart, gait: Gait) -> bool:
    """Return whether a gait comes near a dead point of its joints."""
    path = ClosedPath(chart)
    try:
        shapes = path.shapes(gait.samples(_COARSE)[0])
    except SingularInertiaError:
        return True
    return bool(path.regularity(shapes).min() < _SUSPECT)


def _start(chart: LoopChart, u: Array) -> Array | None:
    """Return the closed shape at independent coordinates (d,), or None near a dead point."""
    try:
        x = np.asarray(chart.shapes(u[None])[0])
    except SingularInertiaError:
        return None
    return x if chart.regularity(x) > _SUSPECT else None


def _tracked(chart: LoopChart, start: Array, u: Array) -> tuple[Array | None, NDArray[np.bool_]]:
    """Follow closed shapes along independent coordinates (N + 1, d) in time, from a start (nx,).

    Returns:
        Shapes (N + 1, nx), or None if they cannot be followed, and whether each is determined by
        its independent joints, (N + 1,).
    """
    count = len(u)
    is_known = np.ones(count, dtype=bool)
    x = np.empty((count, len(start)))
    x[0] = start
    for k in range(1, count):
        guess = _extrapolated(x[max(0, k - _HISTORY) : k])
        is_known[k] = k < _HISTORY or chart.regularity(guess) > _REGULAR
        x[k] = guess
        if is_known[k]:
            try:
                x[k] = chart.near(guess, u[k])
            except SingularInertiaError:
                return None, is_known
    return x, is_known


def _extrapolated(past: Array) -> Array:
    """Return the next value of equidistant values (K, nx), by the polynomial through them."""
    weights = np.ones(1)
    for _ in range(len(past)):  # (1 − shift)^K
        weights = np.append(weights, 0.0) - np.append(0.0, weights)
    return np.asarray(-weights[:0:-1] @ past)


def _filled(x: Array, is_known: NDArray[np.bool_], rise: Array) -> Array | None:
    """Interpolate shapes (N, nx) that are not known from those on both sides, cyclically."""
    count, x = len(x), x.copy()
    unknown = np.flatnonzero(~is_known)
    for group in np.split(unknown, np.flatnonzero(np.diff(unknown) > 1) + 1):
        if not len(group):
            continue
        first, last = int(group[0]), int(group[-1])
        stride = 1 + len(group) // 4
        steps = np.arange(_SIDE) * stride
        nodes = np.concatenate([first - 1 - steps[::-1], last + 1 + steps])
        if len(group) > _WIDEST or not is_known[nodes % count].all():
            return None
        values = x[nodes % count] + np.outer(nodes // count, rise)
        x[group] = _lagrange(nodes, group) @ values
    return x


def _lagrange(nodes: NDArray[np.intp], at: NDArray[np.intp]) -> Array:
    """Return the weights (N, K) of values at nodes (K,) in the polynomial at other places (N,)."""
    differences = np.subtract.outer(nodes, nodes) + np.eye(len(nodes))
    ratios = np.subtract.outer(at, nodes)[:, None, :] / differences
    ratios[:, np.eye(len(nodes), dtype=bool)] = 1.0
    return np.asarray(ratios.prod(axis=-1))


def _as_gait(x: Array, turns: Array, period: float, phase: float) -> Gait | None:
    """Return the Fourier series of shapes (N, nx) that start at a given phase."""
    count = len(x)
    s = np.arange(count) / count
    modes = np.fft.rfft(x - TAU * np.outer(s, turns), axis=0) / count
    size = np.abs(modes).max(axis=1)
    kept = np.flatnonzero(size > _SMALLEST * max(1.0, size.max()))
    harmonics = max(1, int(min(kept.max(initial=1), count // 4)))
    if size[harmonics + 1 :].max() > _RESOLVED * max(1.0, size.max()):
        return None
    series = Gait.fourier(
        modes[0].real,
        2.0 * modes[1 : harmonics + 1].real,
        -2.0 * modes[1 : harmonics + 1].imag,
        period=period,
        turns=turns,
    )
    return series.shifted(phase)
