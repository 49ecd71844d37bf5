"""The angular momentum in the body frame, which moves on a sphere."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from ...analysis.full_reduction import Reduction
from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.errors import InputError
from ...lie.groups import GROUPS, group_named
from ...system.state_fields import with_base
from ...system.system import System
from ..motion_source import MotionSource
from .fine_path import Path, fine_path, state_at
from .motion_labels import labels, robot_of
from .shape_plane import mark_start
from .style import RED, figure, styled

_NONE = 1e-12  # largest momentum that counts as zero, relative to moment of inertia times 1 rad/s
_CONSTANT = 1e-6  # largest relative change of |L| that counts as constant
_CURVES = 4  # number of energy level curves on each side of the separatrix
_POINTS = 181  # number of points of a level curve


@checks_arguments
@styled
def sphere(motion: MotionSource, *, when: float = 0.0) -> Figure:
    """Draw the path of the angular momentum in the body frame on its sphere.

    The momentum refers to the pivot (SO3) or to the centre of mass (SE3). Thin curves are
    levels of the energy ½ Lᵀ I⁻¹ L with locked joints; a rigid body stays on one of them. If the
    robot of a recording is not available, no levels are drawn.

    Args:
        motion: Trajectory, or a recording read from a file.
        when: Time at which the joints are locked [s]; a recording uses its nearest time.
    Returns:
        The figure.
    Raises:
        InputError: Another group, or zero momentum.
        LoadError: SE3 needs the robot of a recording, which cannot be loaded.
    """
    names = labels(motion)
    L = angular_momentum(motion, fine_path(motion))
    size = float(np.linalg.norm(L[0]))
    inertia = None
    if (system := robot_of(motion)) is not None:
        frozen_at = state_at(motion, when)
        inertia = _frozen_inertia(system, frozen_at.x)
    least = _NONE * (1.0 if inertia is None else float(np.trace(inertia)))
    if size <= least:
        raise InputError(f"'{names.robot}' has zero angular momentum, which cannot be drawn")
    steady = np.ptp(np.linalg.norm(L, axis=1)) <= _CONSTANT * size
    about = "pivot" if group_named(names.group).is_pivot else "centre of mass"
    drawing = figure(
        f"{names.robot}: angular momentum about the {about}, in the body's frame\n"
        + (f"|L| = {size:.4g} N·m·s" if steady else f"|L| changes from {size:.4g} N·m·s (sphere)"),
        height=5.4,
    )
    axes: Any = drawing.add_subplot(projection="3d", computed_zorder=False)
    angles = _view(L)
    view = _direction(*angles)
    axes.set_proj_type("ortho")
    axes.view_init(*angles)
    _ball(axes, size, view)
    if inertia is not None:
        frozen = "" if not names.joints else f", shape of t = {float(frozen_at.t):g} s"
        curves = level_curves(inertia, size)
        for k, curve in enumerate(curves):
            _draw(axes, curve, view, f"levels of the energy{frozen}" if k == 0 else "",
                  color="#777777", linewidth=0.8)  # fmt: skip
    _draw(axes, L, view, "path", color=RED, linewidth=2.2)
    mark_start(axes, *L.T)
    reach = 1.05 * max(size, float(np.abs(L).max()))
    _draw_axes(axes, reach)
    drawing.legend(loc="outside lower left", ncols=3, frameon=False)
    return drawing


def angular_momentum(motion: MotionSource, path: Path) -> Array:
    """Compute the angular momentum in the body frame along a path of a motion.

    Args:
        motion: The motion.
        path: States of the motion, at T times.
    Returns:
        (T, 3) angular momentum [N·m·s].
    Raises:
        InputError: The symmetry group is neither SO3 nor SE3.
        LoadError: SE3 needs the robot of a recording, which cannot be loaded.
    """
    group = group_named(labels(motion).group)
    if group.turns < 3:
        names = " and ".join(g.name for g in GROUPS.values() if g.turns == 3)
        raise InputError(f"the body momentum moves on a sphere for {names}, not for {group}")
    mu = with_base(path, labels(motion).robot).body_momentum
    if group.is_pivot:
        return mu
    return group.about(Reduction(motion.system).grid(path.x).com, mu)


def level_curves(inertia: Array, size: float) -> list[Array]:
    """Return curves of equal energy ½ Lᵀ I⁻¹ L on the sphere |L| = size, each (P, 3).

    Let a < b < c be the eigenvalues of I⁻¹ and 2h the level for |L| = 1. In principal axes, a curve
    about the first axis projects to the ellipse L2² (b − a) + L3² (c − a) = 2h − a, and similarly
    about the third axis. The first two curves are the separatrix.
    """
    values, axes = np.linalg.eigh(np.linalg.inv(inertia))
    a, b, c = values
    gap = 1e-9 * c
    levels: list[tuple[float, int]] = []
    if b - a > gap and c - b > gap:
        levels.append((b, 0))
    fractions = (np.arange(_CURVES) + 0.5) / _CURVES
    if b - a > gap:
        levels += [(a + f**2 * (b - a), 0) for f in fractions]
    if c - b > gap:
        levels += [(c - f**2 * (c - b), 2) for f in fractions]
    s = np.linspace(0.0, 2.0 * np.pi, _POINTS)
    curves = []
    for level, about in levels:
        first, second = (k for k in range(3) if k != about)
        L = np.zeros((_POINTS, 3))
        for k, wave in ((first, np.cos(s)), (second, np.sin(s))):
            L[:, k] = np.sqrt((level - values[about]) / (values[k] - values[about])) * wave
        L[:, about] = np.sqrt(np.maximum(1.0 - np.sum(L**2, axis=1), 0.0))
        for sign in (1.0, -1.0):
            curve = L.copy()
            curve[:, about] *= sign
            curves.append(np.asarray(size * curve @ axes.T))
    return curves


def _frozen_inertia(system: System, x: Array) -> Array:
    """Compute the inertia (3, 3) of the robot with joints locked at x, see `sphere`."""
    I = Reduction(system).locked_inertia(x)
    return I if len(I) == 3 else np.asarray(np.linalg.inv(np.linalg.inv(I)[3:, 3:]))


def _view(L: Array) -> tuple[float, float]:
    """Return the elevation and azimuth [deg] of a view that shows the path and all three axes."""
    mean = np.mean(L, axis=0)
    if np.linalg.norm(mean) < 0.2 * np.linalg.norm(L[0]):
        mean = L[0]
    up = np.degrees(np.arcsin(np.clip(mean[2] / np.linalg.norm(mean), -1.0, 1.0)))
    azimuth = 30.0 + 90.0 * np.round((np.degrees(np.arctan2(mean[1], mean[0])) - 30.0) / 90.0)
    return float(np.copysign(np.clip(abs(up), 25.0, 50.0), up)), float(azimuth)


def _direction(elevation: float, azimuth: float) -> Array:
    up, turn = np.radians([elevation, azimuth])
    return np.array([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)])


def _draw(axes: Any, curve: Array, view: Array, label: str, **look: Any) -> None:
    """Draw a curve on the sphere, pale and dotted on its far side."""
    front = curve @ view >= 0.0
    near, far = curve.copy(), curve.copy()
    near[~front] = np.nan
    far[front] = np.nan
    if front.any() or label:
        axes.plot(*near.T, label=label or "_near", zorder=4, **look)
    if not front.all():
        axes.plot(*far.T, label="_far", zorder=2, **{**look, "linestyle": ":", "alpha": 0.45})


def _ball(axes: Any, size: float, view: Array) -> None:
    """Draw the sphere as a disc, its parallel projection."""
    s = np.linspace(0.0, 2.0 * np.pi, _POINTS)
    _, _, across = np.linalg.svd(view[None])
    rim = size * (np.cos(s)[:, None] * across[1] + np.sin(s)[:, None] * across[2])
    disc = Poly3DCollection([rim], facecolor="#EAF3F9", edgecolor="#8FB8D3", linewidth=0.8)
    disc.set_zorder(1)
    axes.add_collection3d(disc)


def _draw_axes(axes: Any, reach: float) -> None:
    """Set limits, labels and units of the three axes."""
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), zlim=(-reach, reach))
    axes.set_box_aspect((1, 1, 1))
    axes.set(xlabel="L1 [N·m·s]", ylabel="L2 [N·m·s]", zlabel="L3 [N·m·s]")
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color("white")
        axis.set_major_locator(MaxNLocator(4, symmetric=True))
