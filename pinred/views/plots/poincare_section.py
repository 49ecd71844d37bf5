"""Poincaré sections: crossings of a surface in state space."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.figure import Figure

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, as_floats
from ...common.errors import InputError
from ...simulation.recording import Recording
from ...simulation.trajectory import Trajectory
from ..motion_source import MotionSource
from .fine_path import charted_path, fine_times, shape_path
from .motion_labels import labels, robot_of
from .style import dots, figure, legend, styled

_HALVINGS = 64  # number of bisections, enough to resolve adjacent floating-point numbers


@checks_arguments
@styled
def poincare(
    motions: MotionSource | Sequence[MotionSource],
    *,
    joints: Sequence[str | int] | None = None,
    value: float | None = None,
    direction: int = 1,
) -> Figure:
    """Draw the rate of one joint against its value, whenever another joint crosses a value.

    A recording is interpolated by cubic splines between its times.  Balls have unwrapped rotation
    vectors and their derivatives.

    Args:
        motions: A motion, or several motions of one robot; each gets a separate marker.
        joints: Names or indices of the crossing joint and the drawn joint; the first two if None.
        value: Value of the crossing joint [rad | m], modulo 2π for hinges; the middle of its range
            if None.
        direction: Sign of the rate at the crossing: 1, −1, or 0 for both.
    Returns:
        The figure.
    Raises:
        InputError: Fewer than two joints, motions of several robots, or no crossing.
    """
    sources = [motions] if isinstance(motions, (Trajectory, Recording)) else list(motions)
    if not sources:
        raise InputError("a Poincaré section takes one or more motions, got none")
    names = labels(sources[0])
    if any(labels(motion) != names for motion in sources):
        raise InputError("a Poincaré section takes motions of one robot only")
    crossed, shown = names.pair(joints, "a Poincaré section")
    if direction not in (-1, 0, 1):
        raise InputError(f"direction must be 1, -1 or 0 for both, got {direction!r}")
    unit = names.units[crossed]
    if value is None:
        x = charted_path(sources[0]).x[:, crossed]
        value = 0.5 * float(x.min() + x.max())
    where = float(as_floats(value, "value"))
    if not np.isfinite(where):
        raise InputError(f"value must be finite, got {value}")
    turns = unit == "rad" and not _of_ball(sources[0], crossed)
    points = [
        section(motion, crossed, where, direction, turns=turns, shown=shown) for motion in sources
    ]
    if not any(len(crossed_at) for crossed_at in points):
        raise InputError(
            f"'{names.joints[crossed]}' does not cross {where:g} {unit} in this direction; "
            "choose another value or a longer motion"
        )
    sense = {1: ", upwards", -1: ", downwards", 0: ""}[direction]
    drawing = figure(
        f"{names.robot}: Poincaré section at {names.joints[crossed]} = {where:.4g} {unit}{sense}",
        height=4.2,
    )
    axes = drawing.subplots()
    size = 5.0 if max(map(len, points)) < 100 else 2.5
    for k, crossed_at in enumerate(points):
        axes.plot(
            *crossed_at.T, linestyle="none", markersize=size, markeredgewidth=0.0,
            label=f"motion {k + 1}: {len(crossed_at)} crossings", **dots(k),
        )  # fmt: skip
    rate = f"rate of {names.joints[shown]} [{names.units[shown]}/s]"
    axes.set(xlabel=names.with_unit(shown), ylabel=rate)
    legend(axes)
    return drawing


def _of_ball(motion: MotionSource, joint: int) -> bool:
    """Return whether a coordinate is an entry of the rotation vector of a ball."""
    system = robot_of(motion)
    return system is not None and joint in system.space.ball_v


def section(
    motion: MotionSource, joint: int, value: float, direction: int, *, turns: bool, shown: int
) -> Array:
    """Compute the value and rate of a joint at the crossings of another joint.

    Args:
        motion: The motion.
        joint: Index of the crossing joint.
        value: Value at the crossing [rad | m].
        direction: Sign of the rate at the crossing: 1, −1, or 0 for both.
        turns: Whether values that differ by full rotations count as crossings.
        shown: Index of the other joint.
    Returns:
        (K, 2) value and rate of the other joint, in order of time.
    """
    path = shape_path(motion)

    def height(t: Array) -> Array:
        distance = path(t)[0][:, joint] - value
        return np.sin(0.5 * distance) if turns else distance

    t = crossings(motion, height)
    if not t.size:
        return np.empty((0, 2))
    x, xdot = path(t)
    points = np.stack([x[:, shown], xdot[:, shown]], axis=1)
    return points if not direction else points[np.sign(xdot[:, joint]) == direction]


def crossings(motion: MotionSource, function: Callable[[Array], Array]) -> Array:
    """Find the times at which a continuous function changes its sign, by bisection.

    Two crossings within an eighth of an integration step, or of a report interval, are missed.

    Args:
        motion: The motion, whose steps are searched.
        function: Function from times (T,) to values (T,).
    Returns:
        Times of the crossings, (K,) [s].
    """
    t = fine_times(motion)
    # An exact zero is assigned the sign of the previous value, so that its crossing counts once.
    signs = np.sign(function(t))
    for k in np.flatnonzero(signs == 0.0):
        signs[k] = signs[k - 1] if k else 0.0
    change = signs[:-1] * signs[1:] < 0.0
    low, high, sign = t[:-1][change], t[1:][change], signs[:-1][change]
    if not low.size:
        return low
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        before = np.sign(function(middle)) == sign
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    return np.asarray(high)
