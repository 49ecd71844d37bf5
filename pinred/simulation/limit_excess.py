"""Limits of joints in the robot's file, and where a motion exceeds them.

No simulation enforces these limits.  Balls have none.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..common.arrays import Array
from ..common.memo import is_first, once
from ..common.names import listed
from ..scene.input_formats import list_forces
from ..system.passive import StatedLimit, limits_of
from ..system.system import nominal

if TYPE_CHECKING:
    from ..system.state_fields import ShapeState, State
    from ..system.system import System
    from .motion import Motion
    from .plan import Plan

_INSIDE = 3  # number of points within each step at which positions and rates are compared
_MOST_TIMES = 20_000  # largest number of times at which positions and rates are compared
_MOST_EFFORTS = 500  # largest number of times at which efforts are computed
_QUICK_EFFORTS = 6  # the same number in the check after each simulation
_ROUND_OFF = 1e-9  # excess, relative to the limit, that counts as round-off


@dataclass(frozen=True)
class LimitUse:
    """How a motion uses a limit of the robot's file.

    Attributes:
        limit: The limit.
        unit: Unit of the values.
        least: Least value in the motion.
        greatest: Greatest value in the motion.
        excess: Largest excess beyond the limit; 0 if the motion keeps it.
        t: Time of the largest excess, or of the value nearest to the limit [s].
    """

    limit: StatedLimit
    unit: str
    least: float
    greatest: float
    excess: float
    t: float


@dataclass(frozen=True)
class LimitTable:
    """The limits of the robot's file, with the extremes of a motion.

    Values are compared at the report times, at the ends of steps and at three points within each
    step; efforts at 500 of these times at most.

    Attributes:
        rows: One entry for each limit.
    """

    rows: tuple[LimitUse, ...]

    @property
    def exceeded(self) -> tuple[LimitUse, ...]:
        """The limits that the motion exceeds, the largest relative excess first."""
        beyond = [use for use in self.rows if use.excess > 0.0]
        return tuple(sorted(beyond, key=lambda use: -_relative(use)))

    def __iter__(self) -> Iterator[LimitUse]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        head = ("joint", "kind", "lower", "upper", "least", "greatest", "excess", "at t [s]")
        lines = [head, *map(_cells, self.rows)]
        widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
        return "\n".join(
            "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
            for line in lines
        )

    def _repr_html_(self) -> str:
        from ..common.html import card, table

        heads = ["joint", "kind", "lower", "upper", "least", "greatest", "excess", "at t [s]"]
        cells = [_cells(use) for use in self.rows]
        return card("limits of the file", f"{len(self.exceeded)} exceeded", table("", heads, cells))


def limit_table(plan: Plan, motion: Motion) -> LimitTable:
    """Compare a motion with the limits of its robot's file.

    Args:
        plan: The plan of the scene.
        motion: The motion.
    Returns:
        The limits, with the extremes of the motion.
    """
    ends = np.concatenate([[0.0], motion.knots])
    ends = ends[ends <= plan.scene.end]
    fractions = np.linspace(0.0, 1.0, _INSIDE + 2)[:-1]
    inside = (ends[:-1, None] + np.diff(ends)[:, None] * fractions).ravel()
    t = _some(np.unique(np.concatenate([inside, ends, plan.scene.report_times])), _MOST_TIMES)
    times = _some(t, _MOST_EFFORTS)
    is_bounded = any(limit.kind == "effort" for limit in limits_of(plan.system))
    efforts = _efforts(plan, motion, times) if is_bounded else {}
    return LimitTable(tuple(_uses(plan.system, motion.states(t), times, efforts)))


def excess_notice(plan: Plan, motion: Motion, states: ShapeState | State) -> str:
    """Return a sentence on limits of the file that a motion exceeds at report times, or "".

    Dense output between them costs more than a short motion, so only `limit_table` evaluates it.
    A robot's sentence on the same limits is returned once.  Efforts are computed for the first
    motion of a set of forces only, because they cost more than the motion.

    Args:
        plan: The plan of the scene.
        motion: The motion.
        states: Its states at the report times, which are compared.
    Returns:
        The sentence.
    """
    system = plan.system
    bounds = once(system, _Bounds, lambda: _bounds_of(system))
    if not bounds.are_stated:
        return ""
    few, efforts = states.t[:0], dict[str, Array]()
    forces = plan.forces
    if forces is not None and bounds.efforts and is_first(forces, LimitTable):
        few = _some(states.t, _QUICK_EFFORTS)
        efforts = _efforts(plan, motion, few)
    columns = _columns_beyond(bounds, states)
    # Without efforts and followers, the entries beyond bounds decide which limits are named.
    if not (efforts or bounds.of_followers) and (
        b"\x01" not in columns or not is_first(nominal(system), (_Bounds, columns))
    ):
        return ""
    uses = LimitTable(tuple(_uses(system, states, few, efforts))).exceeded
    names = frozenset((use.limit.joint, use.limit.kind) for use in uses)
    if not names or not is_first(nominal(system), (LimitUse, names)):
        return ""
    words = [
        f"{use.limit.kind} of {use.limit.joint} by {use.excess:.3g} {use.unit} at t = {use.t:.3g} s"
        for use in uses
    ]
    return (
        f"'{system.name}' goes beyond the limits of its file, of which only stops='file' enforces "
        f"those of positions: {listed(words, 3)}, at report times (traj.limits looks between "
        "them, too)"
    )


class _Bounds(NamedTuple):
    """The limits of a robot's file as bounds of the fields of a state.

    Attributes:
        are_stated: Whether the file states a limit.
        x: Lowest and highest shapes, less and more by round-off, (2, nx) [rad | m | 1].
        xdot: The same of shape rates, (2, m) [rad/s | m/s].
        efforts: Whether a limit of an effort is stated.
        of_followers: Whether a follower, which is no entry of the state, has a limit.
    """

    are_stated: bool
    x: Array
    xdot: Array
    efforts: bool
    of_followers: bool


def _bounds_of(system: System) -> _Bounds:
    x, xdot = (np.tile([[-np.inf], [np.inf]], size) for size in (system.nx, system.m))
    joints, limits = {joint.name: joint for joint in system.space.joints}, limits_of(system)
    for limit in limits:
        joint = joints.get(limit.joint)
        if joint is not None and limit.kind == "position":
            x[:, joint.x] = [[limit.lower], [limit.upper]]
        elif joint is not None and limit.kind == "rate":
            xdot[:, joint.v] = [[limit.lower], [limit.upper]]
    for low, high in (x, xdot):
        low -= _ROUND_OFF * np.maximum(np.abs(low), 1e-3)
        high += _ROUND_OFF * np.maximum(np.abs(high), 1e-3)
    efforts = any(limit.kind == "effort" for limit in limits)
    of_followers = any(limit.joint not in joints for limit in limits)
    return _Bounds(bool(limits), x, xdot, efforts, of_followers)


def _columns_beyond(bounds: _Bounds, states: ShapeState | State) -> bytes:
    """Return which entries of x and ẋ exceed their bounds, a byte 0 or 1 for each."""
    (low, high), (slow, fast) = bounds.x, bounds.xdot
    x: Array = ((states.x < low) | (states.x > high)).any(axis=0)
    xdot: Array = ((states.xdot < slow) | (states.xdot > fast)).any(axis=0)
    return x.tobytes() + xdot.tobytes()


def _uses(
    system: System, states: ShapeState | State, t_effort: Array, efforts: Mapping[str, Array]
) -> Iterator[LimitUse]:
    """Yield the use of each limit by states (T,), and by efforts at times t_effort."""
    t, limits = states.t, limits_of(system)
    if not limits:
        return
    position, rate = dict[str, Array](), dict[str, Array]()
    model = system.sorted_model
    q = system.sorted_q(system.group.identity(), states.x)
    v = system.sorted_v(np.zeros((len(t), system.r)), states.xdot)
    for name in {limit.joint for limit in limits}:
        joint = model.joints[model.getJointId(name)]
        position[name], rate[name] = q[:, joint.idx_q], v[:, joint.idx_v]
    units = dict(zip(system.shape_names, system.units, strict=True))
    for limit in limits:
        angle = units.get(limit.joint, "rad") == "rad"
        values, times = {
            "position": (position.get(limit.joint), t),
            "rate": (rate.get(limit.joint), t),
            "effort": (efforts.get(limit.joint), t_effort),
        }[limit.kind]
        if values is None:
            continue
        beyond = np.maximum(values - limit.upper, limit.lower - values)
        k = int(np.argmax(beyond))
        bound = limit.upper if values[k] >= limit.upper else limit.lower
        excess = float(beyond[k]) if beyond[k] > _ROUND_OFF * max(abs(bound), 1e-3) else 0.0
        unit = {
            "position": "rad" if angle else "m",
            "rate": "rad/s" if angle else "m/s",
            "effort": "N·m" if angle else "N",
        }[limit.kind]
        extremes = float(values.min()), float(values.max())
        yield LimitUse(limit, unit, *extremes, excess, float(times[k]))


def _efforts(plan: Plan, motion: Motion, t: Array) -> dict[str, Array]:
    """Return what drives the joints at times (T,), {joint: (T,)} [N·m | N].

    Prescribed joints need their driving torques.  Other joints are driven by the forces of the
    scene without springs, dampers and friction, which no motor exerts.
    """
    forces = plan.forces
    if forces is None:
        return {}
    from ..forces.force_model_cache import cached_force_model
    from ..forces.kinds import Damper, Friction, Spring
    from .balances import driving_torques

    scene, space, efforts = plan.scene, plan.system.space, dict[str, Array]()
    samples, numbers = motion.samples(t)
    own_forces = list_forces(scene.forces)
    passive = [force for force in own_forces if isinstance(force, (Spring, Damper, Friction))]
    if len(passive) < len(own_forces) or scene.controls:
        torque = forces.acting(samples.force_inputs(t, numbers)).torque
        if passive or scene.springs or scene.own_forces:
            model = cached_force_model(
                scene.system, scene.springs, [*passive, *scene.own_forces], {}, scene.varied
            ).with_values(scene.parameters)
            own_numbers = np.tile(model.numbers_from(0.0, scene.end), (len(t), 1))
            torque = torque - model.acting(samples.force_inputs(t, own_numbers)).torque
        for joint in space.joints:
            column = torque[:, joint.v]
            if joint.kind.m == 1 and column.any():
                efforts[joint.name] = column[:, 0]
    driven = driving_torques(plan, t, samples, numbers)
    for k, column in zip(plan.driven, driven.T, strict=True):
        efforts[plan.system.shape_names[k]] = column
    return efforts


def _some(t: Array, most: int) -> Array:
    """Return at most `most` of the times, with the first and the last."""
    if len(t) <= most:
        return t
    return np.asarray(t[np.unique(np.linspace(0, len(t) - 1, most).round().astype(int))])


def _relative(use: LimitUse) -> float:
    limit = use.limit
    bound = limit.upper if use.greatest - limit.upper >= limit.lower - use.least else limit.lower
    return use.excess / max(abs(bound), 1e-300)


def _cells(use: LimitUse) -> Sequence[str]:
    limit = use.limit
    values = (limit.lower, limit.upper, use.least, use.greatest, use.excess)
    numbers = [f"{value:.4g}" for value in values]
    return limit.joint, f"{limit.kind} [{use.unit}]", *numbers, f"{use.t:.4g}"
