"""Initial unknowns of an extremal, from a Fourier gait nearby."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...analysis.gaits.gait import Gait
from ...analysis.phases.path_basis import phase_slopes
from ...analysis.phases.phase import phase
from ...common.arrays import Array
from .extremal_problem import SEGMENTS, Displacement, ExtremalProblem

_SAMPLES = 256  # number of samples of the initial loop
_ROUND_OFF = 1e-15  # harmonics below this part of the largest one are omitted


class Start(NamedTuple):
    """An initial point of the iteration.

    Attributes:
        z: Unknowns, (n,).
        scale: Scale of the unknowns, (n,).
        units: Scale of the residuals, (n,).
    """

    z: Array
    scale: Array
    units: Array


def start_of(problem: ExtremalProblem, gait: Gait) -> Start:
    """Return initial unknowns of an extremal.

    The multipliers balance the gradients of length and displacement in the coefficients.

    Args:
        problem: The boundary value problem.
        gait: A Fourier gait near the extremal.
    Returns:
        The unknowns with their scales.
    """
    connection, group = problem.task.connection, problem.group
    slopes = phase_slopes(connection, gait)
    displacement, L = Displacement.of(problem.task.aim, slopes.pose), slopes.length
    allowed = displacement.allowed
    by_c = np.tensordot(allowed, slopes.twist, 1).reshape(len(allowed), -1)
    multipliers = L * np.linalg.lstsq(by_c.T, slopes.length_slope.ravel(), rcond=None)[0]
    J = group.spatial_momentum(slopes.pose, multipliers @ allowed)
    even = at_constant_speed(problem, gait)
    nodes = np.arange(SEGMENTS) / SEGMENTS
    x, u = even.at(nodes)
    sampled = phase(connection, even)
    poses = sampled.path[np.abs(sampled.times - nodes[:, None]).argmin(axis=1)]
    mu = np.einsum("nab,a->nb", group.Ad(poses), J)
    base = np.tile(group.identity(), (SEGMENTS, 1))
    p = problem.equations.momenta(x, u, base, mu)
    z = np.concatenate([np.hstack([x, p, mu]).ravel(), multipliers])
    return Start(z, *_scales(problem, even, L, displacement))


def at_constant_speed(problem: ExtremalProblem, gait: Gait) -> Gait:
    """Return the gait with constant speed in the metric and period 1, by interpolation."""
    t = np.arange(4 * _SAMPLES + 1) * (gait.period / (4 * _SAMPLES))
    speed = np.sqrt(problem.task.connection.horizontal(*gait.at(t))[1])
    travelled = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))])
    even = np.arange(_SAMPLES) * (travelled[-1] / _SAMPLES)
    return interpolated(gait.at(np.interp(even, travelled, t))[0], 1.0)


def interpolated(x: Array, period: float) -> Gait:
    """Return the Fourier gait through samples (N, m) at equidistant times from 0."""
    count = len(x)
    modes = np.fft.rfft(x, axis=0)[: (count + 1) // 2] / count
    sizes = np.abs(modes[1:]).max(axis=1)
    modes = modes[: 2 + int(np.flatnonzero(sizes > _ROUND_OFF * sizes.max())[-1])]
    return Gait.fourier(modes[0].real, 2.0 * modes[1:].real, -2.0 * modes[1:].imag, period=period)


def _scales(
    problem: ExtremalProblem, gait: Gait, length: float, moved: Displacement
) -> tuple[Array, Array]:
    """Return scales of unknowns and residuals, so that products have the unit of an action."""
    group, action = problem.group, length**2
    x, xdot = gait.samples(_SAMPLES)
    size = 0.5 * np.ptp(x, axis=0)
    size = np.maximum(size, 1e-3 * size.max())
    twists = np.abs(problem.task.connection.horizontal(x, xdot)[0]).mean(axis=0)
    travel = np.maximum(twists, 1e-3 * twists.max())
    k = group.linear
    paths = [travel[k:].max(initial=0.0), travel[:k].max(initial=0.0)]
    errors = np.array([paths[j >= group.turns] for j in range(len(moved.errors))])
    value = len(moved.gradient)
    states = np.tile(np.concatenate([size, action / size, action / travel]), SEGMENTS)
    scale = action if problem.task.most is None else length
    multipliers = np.full(value, action / abs(moved.value)) if value else np.zeros(0)
    return (
        np.concatenate([states, multipliers, action / errors]),
        np.concatenate([states, errors, np.full(value, scale)]),
    )
