"""Poincaré sections: where motions pierce a surface in their state space."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from ...common.arrays import Array, as_floats
from ...common.errors import InputError
from ...simulation.recording import Recording
from ...simulation.trajectory import Trajectory
from ..motion_source import MotionSource
from .crossings import crossings
from .fine_path import fine_path, shape_path
from .motion_labels import labels
from .style import dots, figure, legend, styled
from .time_series import require_joints


@styled
def poincare(
    motions: MotionSource | Sequence[MotionSource],
    *,
    joints: Sequence[str | int] | None = None,
    value: float | None = None,
    direction: int = 1,
) -> Figure:
    """Draw shape against rate of one joint at each crossing of another, each motion by its mark.

    joints: the one that crosses and the one that is drawn, the first two if None.  value:
    where it crosses [rad | m], the middle of its motion if None; of a turning joint, whole turns
    more or less count as well.
    direction: 1 where its rate is positive, −1 where it is negative, 0 both.
    Of a file, the motion between two report times is the cubic that shapes and rates give.
    Raises InputError for fewer than two joints, motions of several robots, or if no motion
    crosses.
    """
    every = [motions] if isinstance(motions, (Trajectory, Recording)) else list(motions)
    if not every:
        raise InputError("a Poincaré section takes one or more motions, got none")
    names = labels(every[0])
    if any(labels(each) != names for each in every):
        raise InputError("a Poincaré section takes motions of one robot only")
    require_joints(names, 2, "a Poincaré section")
    pair = names.indices(joints if joints is not None else (0, 1))
    if len(pair) != 2:
        raise InputError(f"joints must be two for a Poincaré section, got {len(pair)}")
    crossed, shown = pair
    if direction not in (-1, 0, 1):
        raise InputError(f"direction must be 1, -1 or 0 for both, got {direction!r}")
    unit = names.units[crossed]
    if value is None:
        x = fine_path(every[0]).x[:, crossed]
        value = 0.5 * float(x.min() + x.max())
    where = float(as_floats(value, "value"))
    if not np.isfinite(where):
        raise InputError(f"value must be finite, got {value}")
    points = [
        section(each, crossed, where, direction, turns=unit == "rad", shown=shown) for each in every
    ]
    if not any(len(part) for part in points):
        raise InputError(
            f"'{names.joints[crossed]}' does not cross {where:g} {unit} in this direction; "
            "choose another value or a longer motion"
        )
    sense = {1: ", upwards", -1: ", downwards", 0: ""}[direction]
    made = figure(
        f"{names.robot}: Poincaré section at {names.joints[crossed]} = {where:.4g} {unit}{sense}",
        height=4.2,
    )
    axes = made.subplots()
    size = 5.0 if max(map(len, points)) < 100 else 2.5
    for k, part in enumerate(points):
        axes.plot(
            part[:, 0], part[:, 1], linestyle="none", markersize=size, markeredgewidth=0.0,
            label=f"motion {k + 1}: {len(part)} crossings", **dots(k),
        )  # fmt: skip
    axes.set_xlabel(f"{names.joints[shown]} [{names.units[shown]}]")
    axes.set_ylabel(f"rate of {names.joints[shown]} [{names.units[shown]}/s]")
    legend(axes)
    return made


def section(
    motion: MotionSource, joint: int, value: float, direction: int, *, turns: bool, shown: int
) -> Array:
    """Return (shape, rate) of a joint at the crossings of another, in order of time, (K, 2).

    turns: whether whole turns more or less than `value` count.
    """
    path = shape_path(motion)

    def height(t: Array) -> Array:
        apart = path(t)[0][:, joint] - value
        return np.sin(0.5 * apart) if turns else apart

    t = crossings(motion, height)
    if not t.size:
        return np.empty((0, 2))
    x, xdot = path(t)
    points = np.stack([x[:, shown], xdot[:, shown]], axis=1)
    return points if not direction else points[np.sign(xdot[:, joint]) == direction]
