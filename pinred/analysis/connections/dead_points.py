"""Gaits of independent joints through their dead points, as gaits of all joints.

At a dead point two branches of closed shapes meet, on which the independent joints have the same
values.  A smooth path of these joints that touches such values continues smoothly on the other
branch, as the rocker of a turning crank does.  The path is tracked in time through regular shapes,
and interpolated across each dead point, where the independent joints do not determine the others.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from ...common.errors import SingularInertiaError
from ...system.loops.independent_joints import LoopChart
from ..gaits.arcs import TAU
from ..gaits.gait import Gait
from .connection import Connection
from .gaits_of_all_joints import AllJointsCode, along_all_joints
from .loop_connection import ClosedPath, LoopConnectionCode

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
