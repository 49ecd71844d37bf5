"""Workspace of a free-floating arm: distances of the hand from the centre of mass.

At zero momentum the centre of mass is at rest, and the distance of the hand from it depends on the
shape alone. A distance is path-dependent if some shape with that distance is dynamically singular:
whether the hand can cross this distance depends on the path that the hand takes. Source: E.
Papadopoulos, S. Dubowsky, "Dynamic singularities in free-floating space manipulators", J. Dyn.
Sys., Meas., Control 115 (1993).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, FrozenArrays

_SHAPES_PER_LINE = 41
_DESCENTS = 6  # number of samples from which each extreme distance is minimised
_GAP = 4.0  # largest gap within one range, in mean distances between samples


@checks_arguments
@dataclass(frozen=True)
class Workspace(FrozenArrays):
    """Distances of the hand from the centre of mass at zero momentum. Arrays are read-only.

    Attributes:
        reach: Least and greatest distance that the hand reaches, (2,) [m].
        dependent: Path-dependent ranges, (K, 2) [m], which contain singular shapes.
        independent: Path-independent ranges, (L, 2) [m].
    """

    reach: Array
    dependent: Array
    independent: Array


def workspace_of(
    radius: Callable[[Array], Array],
    slope: Callable[[Array], Array],
    determinants: Callable[[Array], Array],
    bounds: Array,
    samples: int,
    seed: int,
) -> Workspace:
    """Compute the workspace within joint limits.

    Args:
        radius: Distances (N,) [m] at shapes (N, m).
        slope: Derivative (m,) of the distance at a shape (m,).
        determinants: Determinants (N,) at shapes (N, m).
        bounds: Joint limits, (m, 2) [rad | m].
        samples: Grid values of each of one or two joints, or number of lines for more joints.
        seed: Seed of the random lines.
    Returns:
        The workspace.
    """
    from scipy.optimize import minimize

    paths = _grid(bounds, samples) if len(bounds) < 3 else _lines(bounds, samples, seed)
    shapes = paths.reshape(-1, len(bounds))
    r, det = (f(shapes).reshape(paths.shape[:-1]) for f in (radius, determinants))
    cross = np.sign(det[:, :-1]) != np.sign(det[:, 1:])
    det_a, det_b = det[:, :-1][cross], det[:, 1:][cross]
    r_a, r_b = r[:, :-1][cross], r[:, 1:][cross]
    singular = np.sort(r_a + det_a / (det_a - det_b) * (r_b - r_a))

    def extreme(sign: float, starts: Array) -> float:
        """Minimise sign · radius from each of the shapes; return the extreme distance."""
        minima = [
            minimize(
                lambda x: (sign * float(radius(x[None])[0]), sign * slope(x)), start, jac=True,
                method="L-BFGS-B", bounds=bounds,
            ).fun
            for start in starts
        ]  # fmt: skip
        return float(sign * min(minima))

    ordered = shapes[np.argsort(r.ravel())]
    reach = np.array([extreme(1.0, ordered[:_DESCENTS]), extreme(-1.0, ordered[-_DESCENTS:])])
    gap = _GAP * float(np.ptp(reach)) / samples
    dependent = _ranges(singular, gap)
    edges = [reach[0], *dependent.ravel(), reach[1]]
    independent = [
        (det_a, det_b)
        for det_a, det_b in zip(edges[::2], edges[1::2], strict=True)
        if det_b - det_a > gap
    ]
    return Workspace(reach, dependent, np.array(independent).reshape(-1, 2))


def _grid(bounds: Array, samples: int) -> Array:
    """Return the grid lines along every joint as P sampled paths, (P, samples, m)."""
    axes = [np.linspace(low, high, samples) for low, high in bounds]
    shapes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return shapes[None] if len(bounds) == 1 else np.concatenate([shapes, np.swapaxes(shapes, 0, 1)])


def _lines(bounds: Array, samples: int, seed: int) -> Array:
    """Return straight paths between random shapes in the box, (samples, 41, m)."""
    rng = np.random.default_rng(seed)
    low, high = bounds.T
    start, end = low + (high - low) * rng.uniform(size=(2, samples, len(bounds)))
    fraction = np.linspace(0.0, 1.0, _SHAPES_PER_LINE)[:, None]
    return np.asarray(start[:, None] + fraction * (end - start)[:, None])


def _ranges(values: Array, gap: float) -> Array:
    """Split sorted values into ranges, (K, 2), where neighbours differ by more than `gap`."""
    if not len(values):
        return np.zeros((0, 2))
    cuts = np.flatnonzero(np.diff(values) > gap)
    starts, ends = np.append(0, cuts + 1), np.append(cuts, len(values) - 1)
    return np.stack([values[starts], values[ends]], axis=1)
