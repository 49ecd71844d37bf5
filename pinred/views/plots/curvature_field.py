"""The curvature of the mechanical connection over two joints (rotation of a small loop)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from ...analysis.full_reduction import Reduction
from ...common.arrays import Array, vector
from ...common.errors import InputError
from ...lie.group import Group
from ...simulation.recording import Recording
from ...simulation.trajectory import Trajectory
from ...system.system import System, checked_system
from ..motion_source import MotionSource
from .fine_path import fine_path
from .motion_labels import labels_of
from .shape_plane import (
    NONE,
    Limits,
    around,
    checked_path,
    draw_path,
    fill,
    name_axes,
    outline,
    plane,
    reach,
    title_at,
)
from .style import figure, styled
from .time_series import require_joints

Source: TypeAlias = System | Reduction | MotionSource


@styled
def curvature(
    source: Source,
    *,
    joints: Sequence[str | int] | None = None,
    component: str | int | None = None,
    limits: Limits | None = None,
    at: ArrayLike | None = None,
    path: ArrayLike | None = None,
) -> Figure:
    """Draw a component of the curvature B_αβ over the joints α and β, with its zero contour.

    Args:
        source: A System, a Reduction, or a motion, whose path is drawn.
        joints: Names or indices of two joints; the first two if None.
        component: v1 … ω3 (or w3), or an index in the body twist; the largest rotation if None.
        limits: (low, high) of each joint [rad | m]; around the path, or their range if None.
        at: Shape of the other joints, (m,) [rad | m]; the initial shape, or zero if None.
        path: Shapes to draw, (T, m) [rad | m]; those of the motion if None.
    Returns:
        The figure.
    Raises:
        InputError: Fewer than two joints, or an invalid option.
        LoadError: The robot of a recording cannot be loaded.
    """
    system = _system(source)
    names = labels_of(system)
    require_joints(names, 2, "a plot of the curvature")
    pair = names.indices(joints if joints is not None else (0, 1))
    if len(pair) != 2:
        raise InputError(f"joints must be two for a plot of the curvature, got {len(pair)}")
    drawn: Array | None = None
    if path is not None:
        drawn = checked_path(path, system.m)
    elif isinstance(source, (Trajectory, Recording)):
        drawn = fine_path(source).x
    start = np.zeros(system.m) if drawn is None else drawn[0]
    frozen = start if at is None else vector(at, system.m, "at", system.shape_names)
    units = [names.units[k] for k in pair]
    if limits is None:
        limits = reach(system, pair) if drawn is None else around(drawn[:, pair], units)
    shapes = plane(pair, limits, frozen)
    B = Reduction(system).grid(shapes.shapes).curvature[..., pair[0], pair[1]]
    index = component_of(system.group, component, B)
    values = B[..., index]
    flat = float(np.abs(values).max()) < NONE
    label = system.group.twist_names[index]
    a, b = (names.joints[k] for k in pair)
    frozen_joints = title_at(names, pair, frozen)
    drawing = figure(
        f"{names.robot}: curvature B({a}, {b}), component {label}"
        + (", is zero everywhere" if flat else "")
        + (f"\n{frozen_joints}" if frozen_joints else ""),
        height=4.4,
    )
    axes = drawing.subplots()
    filled = fill(axes, shapes.axes, values)
    outline(axes, shapes.axes, values, filled)
    if drawn is not None:
        draw_path(axes, drawn[:, pair[0]], drawn[:, pair[1]])
    what = f"B, component {label} [{_unit(label, units)}]"
    name_axes(axes, filled, (a, b), units, limits, what)
    return drawing


def _system(source: Source) -> System:
    if isinstance(source, (Trajectory, Recording, Reduction)):
        return source.system
    return checked_system(source, "a plot of the curvature (a Reduction or a motion does, too)")


def component_of(group: Group, component: str | int | None, B: Array) -> int:
    """Return the index of a component of the body twist; the largest rotation of B if None."""
    names, linear = group.twist_names, group.linear
    if component is None:
        size = np.abs(B).reshape(-1, len(names)).max(axis=0)
        first = linear if linear < len(names) else 0
        return first + int(np.argmax(size[first:]))
    if isinstance(component, str):
        name = component.replace("w", "ω")
        if name in names:
            return names.index(name)
    elif not isinstance(component, bool) and 0 <= component < len(names):
        return int(component)
    raise InputError(
        f"no component {component!r} in a twist of {group.name}; the components are "
        + ", ".join(names).replace("ω", "w")
    )


def _unit(label: str, units: Sequence[str]) -> str:
    numerator = "m" if label.startswith("v") else "rad"
    a, b = units
    return f"{numerator}/{a}²" if a == b else f"{numerator}/({a}·{b})"
