"""Initial states: by name, by a seed, and completed with momenta.

A table {joint: value} states joint values by name, in any order.

The value of a hinge or slide is a number.  The attitude of a ball is a rotation vector of three
numbers [rad] or a quaternion (x, y, z, w); its rate is the angular velocity of the child relative
to the parent, in the child's axes.  The same table serves Python, the command line and files.

The option `seed` requests random initial states.  With closed loops, the initial state is the
nearest state that keeps all loops closed.

This module also reports suspicious angles: too large to be accurate, or perhaps in degrees.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..common.arrays import Array, FrozenArrays, as_floats, is_finite, read_only
from ..common.errors import InputError, LoopWarning, ShapeError
from ..common.memo import once
from ..common.names import joint_index, listed, quoted
from ..lie.rotations import quaternion_exp
from ..reduction.pointwise_reduction import PointwiseReduction
from ..system.coordinates import InitialState, PlacedJoint
from ..system.loops.loop_assembly import CLOSED, assemble, describe_gap, loop_gaps, project_rates
from ..system.system import System

if TYPE_CHECKING:
    from ..forces.force_model import ForceModel

_RATES = "xdot0"  # option whose values are rates; all other options are shapes


def order_by_joint(value: Any, system: System, what: str) -> Any:
    """Convert values by joint name to one array in the order of the shape.

    Args:
        value: {joint: number}, or {joint: (N,) numbers} for N members; entries of balls have a
            last axis of three or four.  Axes of balls may be named on their own, such as
            "neck.x".  Any value that is not a mapping is returned unchanged.
        system: System with the joints.
        what: Name of the option: "xdot0" for rates, any other name for shapes.
    Returns:
        (nx,) or (N, nx) for shapes, (m,) or (N, m) for rates; joints that are not named are at
        rest.
    Raises:
        InputError: A joint does not exist or is a follower, or a quaternion is zero.
        ShapeError: The lengths differ, or the value of a ball has a wrong number of entries.
    """
    if not isinstance(value, Mapping):
        return value
    space, of_shape = system.space, what != _RATES
    labels = space.x_names if of_shape else space.names
    balls = {joint.name: joint for joint in space.balls}
    columns: dict[tuple[int, int], Array] = {}
    for name, entry in value.items():
        system.refuse_follower(name, what)
        numbers = as_floats(entry, f"{what}['{name}']")
        if name in balls:
            columns[_place(balls[name], of_shape)] = _of_ball(numbers, balls[name], what)
            continue
        if name not in labels:
            # Ball joints are valid names as well.
            joint_index(name, [joint.name for joint in space.joints], what)
        k = labels.index(name)
        columns[k, k + 1] = numbers[..., None]
    _refuse_parts(balls, columns, what)
    leading = {column.shape[:-1] for column in columns.values()} - {()}
    if len(leading) > 1 or any(len(shape) > 1 for shape in leading):
        raise ShapeError(
            f"{what} must have a number for each joint, or as many for each as there are "
            f"members, got shapes {', '.join(map(str, sorted(leading)))}"
        )
    array = np.zeros((*(leading.pop() if leading else ()), len(labels)))
    if of_shape:
        array[:] = space.neutral
    for (first, last), column in columns.items():
        array[..., first:last] = column
    return read_only(array)


def _place(joint: PlacedJoint, of_shape: bool) -> tuple[int, int]:
    """Return the first entry of a joint and the entry after its last."""
    entries = joint.x if of_shape else joint.v
    return entries.start, entries.stop


def _of_ball(numbers: Array, joint: PlacedJoint, what: str) -> Array:
    """Return the quaternion, (..., 4), or the rates, (..., 3), of a ball."""
    widths: Sequence[int] = (3,) if what == _RATES else (3, 4)
    if numbers.ndim == 0 or numbers.shape[-1] not in widths:
        expected = "a rotation vector of 3 numbers or a quaternion (x, y, z, w)"
        if what == _RATES:
            expected = "an angular velocity of 3 numbers, in the axes of the child"
        raise ShapeError(
            f"{what}['{joint.name}'] is a ball joint: expected {expected}, got shape "
            f"{numbers.shape}"
        )
    if not np.isfinite(numbers).all():
        raise ShapeError(f"{what}['{joint.name}'] must be finite, got {numbers}")
    if what == _RATES:
        return numbers
    if numbers.shape[-1] == 3:
        return quaternion_exp(numbers)
    length = np.linalg.norm(numbers, axis=-1, keepdims=True)
    if not (length > 0.0).all():
        raise InputError(
            f"{what}['{joint.name}']: the quaternion of a ball joint must not be zero; "
            "the joint at rest is (0, 0, 0, 1)"
        )
    return np.asarray(numbers / length)


def _refuse_parts(
    balls: Mapping[str, PlacedJoint], columns: Mapping[tuple[int, int], Array], what: str
) -> None:
    """Reject a table that sets the same entries twice or only some entries of a quaternion."""
    for name, joint in balls.items():
        joint_columns = first, last = _place(joint, what != _RATES)
        single_columns = [p for p in columns if p != joint_columns and first <= p[0] < last]
        if single_columns and (joint_columns in columns or what != _RATES):
            raise InputError(
                f"{what}: set joint '{name}' as a whole, as {what}={{'{name}': …}}, not by its "
                "entries"
            )


DURATION = 2.0  # duration of a scene if neither the scene nor the robot states one [s]


@dataclass(frozen=True)
class _Spread:
    """Ranges of displacements from rest, (m,) each, and scales of rates (m,) and twists (r,)."""

    low: Array
    high: Array
    rates: Array
    twists: Array


def random_state(system: System, seed: int) -> InitialState:
    """Return a random state of moderate size, within the joint limits and without symmetry."""
    spread = once(system, _Spread, lambda: _spread(system))
    rng = np.random.default_rng(seed)
    return InitialState(
        x=system.space.integrate(system.space.neutral, rng.uniform(spread.low, spread.high)),
        xdot=rng.normal(size=system.m) * spread.rates,
        xi=rng.normal(size=system.r) * spread.twists,
        duration=DURATION,
    )


def _spread(system: System) -> _Spread:
    joints = [system.model.joints[i] for i in system.joints]
    reach = np.array([0.1 if unit == "m" else 0.6 for unit in system.units])
    low, high = -reach, reach.copy()
    limits = system.model.lowerPositionLimit, system.model.upperPositionLimit
    for k, joint in enumerate(joints):
        least, most = (limit[joint.idx_q] for limit in limits)
        if joint.nq == 1 and least < most:
            middle = max(least, min(0.0, most))
            low[k], high[k] = max(least, middle - reach[k]), min(most, middle + reach[k])
    _narrow(system, low, high)
    twists = np.where(np.arange(system.r) < system.group.linear, 0.1, 0.6)
    return _Spread(*map(read_only, (low, high, reach, twists)))


def _narrow(system: System, low: Array, high: Array) -> None:
    """Narrow shape ranges, (m,) each, in place so that mimic joints stay within their limits."""
    coupled, model = system.coupled, system.sorted_model
    if coupled is None:
        return
    for i, placed in enumerate(system.tree.joints, start=2):
        joint, j, b = model.joints[i], placed.v.start, coupled.offset[placed.x.start]
        terms = coupled.terms(j)
        if j in coupled.leads or joint.nq != 1:
            continue
        limits = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
        # The other leaders of a joint that follows several stay at the middle of their ranges.
        middle = coupled.G[j] @ (low + high) / 2.0
        for k, ratio in terms:
            constant = b + middle - ratio * (low[k] + high[k]) / 2.0 if len(terms) > 1 else b
            with np.errstate(over="ignore"):  # Joints without limits have huge ones in Pinocchio.
                least, most = sorted((limit - constant) / ratio for limit in limits)
            if max(low[k], least) < min(high[k], most):
                low[k], high[k] = max(low[k], least), min(high[k], most)


_RESOLUTION = 1e-6  # largest spacing of floats at an accepted angle [rad]
_LARGEST_SAFE = 2.0**32  # angle at which the spacing of floats is below _RESOLUTION [rad]
_TURN = 2.0 * math.pi  # angle of a full turn [rad]


@dataclass(frozen=True)
class GivenStates:
    """Initial states of N runs, with either body twists or body momenta.

    Attributes:
        pose: Poses of the base, (N, size).
        x: Shapes, (N, nx) [rad | m | 1].
        xdot: Shape rates, (N, m) [rad/s | m/s].
        xi: Body twists, (N, r) [m/s; rad/s]; None if `mu` is stated.
        mu: Body momenta, (N, r) [N·s; N·m·s]; None if `xi` is stated.
    """

    pose: Array
    x: Array
    xdot: Array
    xi: Array | None
    mu: Array | None

    @property
    def motion(self) -> Array:
        """The body twists or body momenta, whichever is stated, (N, r)."""
        motion = self.xi if self.mu is None else self.mu
        assert motion is not None
        return motion

    def __getitem__(self, index: object) -> GivenStates:
        columns: dict[str, Any] = {
            name: None if column is None else column[index] for name, column in vars(self).items()
        }
        return GivenStates(**columns)


@dataclass(frozen=True)
class Start(FrozenArrays):
    """A complete initial state; arrays are read-only.

    Attributes:
        pose: Pose of the base, (size,).
        x: Shape, (nx,) [rad | m | 1].
        xdot: Shape rate, (m,) [rad/s | m/s].
        xi: Body twist, (r,) [m/s; rad/s].
        mu: Body momentum, (r,) [N·s; N·m·s].
        mass_matrix: Mass matrix H(x), (n, n), base rows first.
        com: Centre of mass in the frame of the root body at x, (3,) [m].
    """

    pose: Array
    x: Array
    xdot: Array
    xi: Array
    mu: Array
    mass_matrix: Array
    com: Array


def start_of(system: System, given: GivenStates) -> Start:
    """Complete the first of several initial states with Pinocchio's mass matrix.

    Returns:
        The initial state.
    Raises:
        SingularInertiaError: The mass matrix is singular.
        InputError: A momentum or twist overflows.
    """
    r, state = system.r, given[0]
    split = system.workspace(
        PointwiseReduction, lambda: PointwiseReduction(system.open_tree())
    ).split(state.x)
    H = split.mass_matrix
    xi, mu = state.xi, state.mu
    with np.errstate(over="ignore", invalid="ignore"):  # finite_start reports an overflow.
        if xi is None and mu is not None:
            xi = np.asarray(np.linalg.solve(H[:r, :r], mu - H[:r, r:] @ state.xdot))
        if mu is None and xi is not None:
            mu = H[:r] @ np.concatenate([xi, state.xdot])
    finite_start(xi, mu)
    return Start(state.pose, state.x, state.xdot, np.asarray(xi), np.asarray(mu), H, split.com)


def finite_start(*arrays: Array | None) -> None:
    """Raise InputError unless all arrays computed from an initial state are finite."""
    if not all(array is not None and is_finite(array) for array in arrays):
        raise InputError("the initial momentum or twist overflows; reduce rates or momentum")


def refuse_vague(x: Array, system: System) -> None:
    """Reject angles of a shape (nx,) at which adjacent floats differ by more than 1e-6 rad.

    Raises:
        InputError: An angle is too large.
    """
    if max(map(abs, x.tolist()), default=0.0) <= _LARGEST_SAFE:
        return
    for name, angle in _angles(x, system):
        if np.spacing(abs(angle)) > _RESOLUTION:
            raise InputError(
                f"x0: the angle of joint {quoted(name)}, {angle:g} rad, is only accurate to "
                f"{np.spacing(abs(angle)):.1g} rad, so its sine is meaningless. Reduce it to one "
                "turn."
            )


def large_angles(x: Array, system: System) -> str:
    """Return a sentence about angles of a shape (nx,) above one turn; empty without such angles."""
    large = [(name, angle) for name, angle in _angles(x, system) if abs(angle) > _TURN]
    if not large:
        return ""
    name, angle = max(large, key=lambda named: abs(named[1]))
    more = f" (and {len(large) - 1} more)" if len(large) > 1 else ""
    return (
        f"joint {quoted(name)} begins at {angle:g} rad, {abs(angle) / _TURN:.3g} turns{more}; "
        f"in degrees that would be {math.radians(angle):.4g} rad"
    )


def _angles(x: Array, system: System) -> list[tuple[str, float]]:
    """Return names and angles of the revolute joints of a shape (nx,)."""
    entries = zip(system.x_names, x.tolist(), system.space.x_units, strict=True)
    return [(name, value) for name, value, unit in entries if unit == "rad"]


_NOTICEABLE = 1e-6  # change of an initial state that is reported [relative]
_ROUND_OFF = 1e-12  # change of a rate that is never reported [rad/s | m/s]


@dataclass(frozen=True)
class HeldJoints:
    """How the user stated joint values.

    Attributes:
        stated: Whether the user stated any value.
        names: Joints that were stated by name and keep their values; empty if all were stated.
    """

    stated: bool
    names: tuple[str, ...]


def held_joints(x0: Any, xdot0: Any) -> tuple[HeldJoints, HeldJoints]:
    """Return which joints keep their values and their rates when loops are closed."""
    by_name = [
        tuple(map(str, values)) if isinstance(values, Mapping) else () for values in (x0, xdot0)
    ]
    return HeldJoints(x0 is not None, by_name[0]), HeldJoints(xdot0 is not None, by_name[1])


def closed_state(
    system: System,
    x: Array,
    xdot: Array,
    held: tuple[HeldJoints, HeldJoints],
    report: tuple[bool, bool],
    model: ForceModel | None,
) -> tuple[Array, Array]:
    """Return the nearest shape (nx,) and rates (m,) that keep all loops closed.

    Args:
        system: The system, with loops.
        x: Shape, (nx,), with planned values of prescribed joints.
        xdot: Shape rate, (m,), with planned values of prescribed joints.
        held: How the user stated values and rates of joints.
        report: Whether to report noticeable changes of values, and of rates, in any case.
        model: Forces and prescribed joints; None if there are none.
    """
    driven = () if model is None else model.joints
    x = closed_shape(system, x, held[0], report=report[0], driven=driven)
    return x, closed_rates(system, x, xdot, held[1], report=report[1], driven=driven)


def closed_shape(
    system: System,
    x: Array,
    held: HeldJoints,
    *,
    report: bool = False,
    driven: Collection[int] = (),
    nearby: bool = False,
) -> Array:
    """Return the shape nearest to x, (nx,), by least squares, that closes all loops.

    Args:
        system: The system, with loops.
        x: Shape, (nx,) [rad | m].
        held: Joints that keep their values if the loops can close by motion of the others.
        report: Whether to report a noticeable change although `held` states no value.
        driven: Indices of the rates of prescribed joints, which keep their values.
        nearby: Whether joints start from x although `held` states no value.
    Returns:
        The closed shape, (nx,).
    Raises:
        InputError: The loops do not close near this shape; the message names a loop and its gap.
    """
    assert system.closure is not None
    length = system.closure.length
    gaps = loop_gaps(system, x, length)
    if gaps.max() <= CLOSED:
        return x
    may_move = _may_move(system, driven)
    free = np.logical_and(_free(system, held), may_move)
    start = x
    if held.names or (driven and not (held.stated or nearby)):
        # The other joints start from a closed shape instead of zero.
        start = x.copy()
        for joint in system.space.joints:
            if free[joint.v].all():
                start[joint.x] = system.closure.x[joint.x]
        closed, remaining = assemble(system, start, length, free)
        if remaining.max() <= CLOSED:
            return closed
    closed, remaining = assemble(system, start, length, may_move)
    if remaining.max() > CLOSED and driven:
        names = listed([system.space.names[k] for k in driven], 6)
        raise InputError(
            f"prescribed: the loops of '{system.name}' do not close with the prescribed positions "
            f"of {names} at time 0: {describe_gap(system, remaining, length)} at the nearest shape "
            "that was found. Start the motion at a closed shape, or give x0 of the other joints."
        )
    if remaining.max() > CLOSED and not (held.stated or report):
        return system.closure.x  # a random shape need not be near a closed one
    if remaining.max() > CLOSED:
        raise InputError(
            f"x0: the loops of '{system.name}' do not close near this shape: "
            f"{describe_gap(system, remaining, length)} at the nearest shape that was found. "
            "Start nearer to a closed shape; System.closure.x is one."
        )
    if (held.stated or report) and gaps.max() > _NOTICEABLE:
        name = quoted(system.loops[int(np.argmax(gaps))].name)
        _warn(
            system,
            f"x0 leaves loop {name} open by {gaps.max() * length:.3g} m",
            system.space.difference(x, closed),
        )
    return closed


def closed_rates(
    system: System,
    x: Array,
    xdot: Array,
    held: HeldJoints,
    *,
    report: bool = False,
    driven: Collection[int] = (),
) -> Array:
    """Return the rates nearest to ẋ, (m,), in the kinetic metric, that keep all loops closed.

    Args:
        system: The system, with loops.
        x: Closed shape, (nx,) [rad | m].
        xdot: Shape rate, (m,) [rad/s | m/s].
        held: Joints that keep their rates if the loops allow it.
        report: Whether to report a noticeable change although `held` states no value.
        driven: Indices of the rates of prescribed joints, which keep their values.
    Returns:
        The rates, (m,).
    Raises:
        InputError: The prescribed joints leave no rates of the others that keep the loops closed.
    """
    tree = system.open_tree()
    reduction = tree.workspace(PointwiseReduction, lambda: PointwiseReduction(tree))
    may_move = _may_move(system, driven)
    metric = reduction.split(x).reduced_metric
    free = np.logical_and(_free(system, held), may_move)
    rates = None if free.all() else project_rates(system, x, xdot, metric, free)
    if rates is not None:
        return rates
    rates = project_rates(system, x, xdot, metric, may_move if driven else None)
    if rates is None:
        names = listed([system.space.names[k] for k in driven], 6)
        raise InputError(
            f"prescribed: the motions of {names} contradict the loops of '{system.name}' near "
            f"x = {x}: other joints cannot follow. Prescribe at most {system.shape_dim} joints, "
            "which determine the others."
        )
    change = np.abs(rates - xdot).max()
    if (held.stated or report) and change > max(_NOTICEABLE * np.abs(xdot).max(), _ROUND_OFF):
        _warn(system, "xdot0 opens a loop", rates - xdot)
    return rates


def _free(system: System, held: HeldJoints) -> Array:
    """Return which shape rates are not held, (m,)."""
    free = np.ones(system.m, dtype=bool)
    for joint in system.space.joints:
        free[joint.v] = joint.name not in held.names
    return free


def _may_move(system: System, driven: Collection[int]) -> Array:
    """Return which shape rates are not prescribed, (m,)."""
    free = np.ones(system.m, dtype=bool)
    free[list(driven)] = False
    return free


def _warn(system: System, what: str, change: Array) -> None:
    k = int(np.argmax(np.abs(change)))
    unit = system.units[k]
    warnings.warn(
        f"{what}. The nearest state that keeps the loops of '{system.name}' closed is used; it "
        f"changes joint {quoted(system.space.names[k])} by {change[k]:.3g} {unit} (or {unit}/s). "
        "To keep chosen joints, state only those, by name.",
        LoopWarning,
        stacklevel=2,
    )
