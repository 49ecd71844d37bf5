"""Distinct critical points: equal ones have the same body positions up to known coverings.

Two points are equal if their coordinates agree, perhaps after full turns of joints, and also if a
covering maps one to the other (`shape_symmetries`). Points of different index are never equal.
Symmetries that are not coverings, such as mirror images, produce further critical points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..stability.second_variation import second_variation
from .amended_energy import AmendedEnergy, Energies
from .points import Points, embedded, joined
from .search import newton_step, residuals, some
from .shape_symmetries import symmetries_of

_SAME = 1e-6  # largest distance of equal regular points [rad | m]
_SAME_FLAT = 1e-3  # largest distance of equal points with a flat direction [rad | m]
FLAT = 1e-7  # largest curvature of a flat direction, relative to the largest curvature
_NO_CURVATURE = 1e-13  # curvature of a constant energy up to round-off, relative to the energies
_SNAP = 1e-2  # largest distance of a degenerate point from its image, if it is its own image
_SAME_ENERGY = 1e-8  # largest relative difference of energies within one family
_ROUND_OFF = 1e-14  # angles [rad] and direction components below this are set to zero


@dataclass(eq=False)
class Orbit:
    """A critical point and its images under all symmetries.

    Attributes:
        images: The distinct images, as coordinates in the unreduced shape space.
        entry: For each image, the number of its entry: coverings of one entry are one motion.
        index: Number of negative curvatures.
        is_flat: Whether a curvature is zero.
        dimension: Dimension of the family of equilibria.
        U: Amended potential [J].
        hits: Number of random starts that converged to an image.
    """

    images: Points
    entry: NDArray[np.intp]
    index: int
    is_flat: bool
    dimension: int
    U: float
    hits: int

    @property
    def entries(self) -> int:
        """Number of distinct equilibria; one for a family."""
        return 1 if self.dimension else len(np.unique(self.entry))


class DistinctPoints:
    """The distinct critical points of a problem, in orbits under its symmetries."""

    def __init__(self, energy: AmendedEnergy, J: float) -> None:
        """Find the symmetries; the set of points is empty."""
        problem = energy.problem
        self.symmetries = symmetries_of(energy, J)
        turning = [k in problem.turning for k in problem.active]
        self.angles = np.zeros(problem.space.nx, dtype=bool)
        self.angles[problem.space.scalar_x] = np.array(turning, dtype=bool)[problem.space.scalar_v]
        self.orbits: list[Orbit] = []
        self._energy, self._J = energy, J
        self._coordinates = embedded(self._none(), self.angles)  # of all images of all orbits
        self._owners = np.zeros(0, dtype=np.intp)

    @property
    def entries(self) -> Points:
        """One point of each distinct equilibrium: the image with the smallest angles."""
        points = [self._representatives(orbit) for orbit in self.orbits]
        return joined(points) if points else self._none()

    def representatives(self, numbers: list[int]) -> Points:
        """Return one point of each given orbit.

        Args:
            numbers: Numbers of orbits, at least one.
        Returns:
            The points.
        """
        return joined([self.orbits[k].images[:1] for k in numbers])

    def add(self, points: Points, e: Energies, *, is_random: bool) -> list[int]:
        """Add critical points.

        Args:
            points: Critical points.
            e: Their energies.
            is_random: Whether random starts led to them, so that they count as hits.
        Returns:
            Numbers of the new orbits.
        """
        if not len(points):
            return []
        curvatures = np.linalg.eigvalsh(e.hessian)
        # The energy may be constant; its computed curvatures are then only round-off.
        floor = np.maximum(
            FLAT * np.abs(curvatures).max(axis=1, initial=0.0), _NO_CURVATURE * e.scale
        )
        flat_counts = (np.abs(curvatures) <= floor[:, None]).sum(axis=1)
        flat = flat_counts > 0
        index = (curvatures < -floor[:, None]).sum(axis=1)
        # For a regular point, the Newton step bounds the distance from the root.
        is_root = flat | (np.linalg.norm(newton_step(e, absolute=False), axis=1) <= _SAME)
        points = self._snapped(self._tidy(points), flat)
        previous = len(self.orbits)
        new: list[int] = []
        for k in np.flatnonzero(is_root).tolist():
            number = self._number(
                points[k : k + 1], some(e, [k]), int(flat_counts[k]), int(index[k])
            )
            self.orbits[number].hits += is_random
            if number >= previous + len(new):
                new.append(number)
        return new

    def is_same(self, a: Points, b: Points, within: float) -> bool:
        """Return whether two points are equal, or a covering maps one to the other.

        Args:
            a: A Points of length one.
            b: Another Points of length one.
            within: Largest distance of equal points [rad | m].
        Returns:
            True if a covering maps b to a.
        """
        copies = [b, *(s(b) for s in self.symmetries if s.is_covering)]
        return self._contains(copies, a, within)

    def is_same_family(self, a: Points, b: Points, J: float) -> bool:
        """Return whether two members of families have the same energy and index.

        Args:
            a: Member of a family, a Points of length one.
            b: Another member of a family.
            J: Momentum.
        Returns:
            True if both agree, so that the families count as one.
        """
        one, other = (self._energy(point, J) for point in (a, b))
        near = _SAME_ENERGY * float(one.scale[0])
        if abs(float(one.U[0] - other.U[0])) > near:
            return False
        indices = [second_variation(self._energy, point, J).index for point in (a, b)]
        return indices[0] == indices[1]

    def _number(self, point: Points, e: Energies, flat_count: int, index: int) -> int:
        """Return the number of a point's orbit, which is new if no known orbit contains it."""
        flat = flat_count > 0
        coordinates = embedded(point, self.angles)
        if len(self._owners):
            distance = np.abs(self._coordinates - coordinates).max(axis=1, initial=0.0)
            for k in np.flatnonzero(distance <= (_SAME_FLAT if flat else _SAME)).tolist():
                orbit = self.orbits[self._owners[k]]
                is_same_flat = orbit.is_flat == flat or distance[k] <= _SAME
                if is_same_flat and (flat or orbit.is_flat or orbit.index == index):
                    return int(self._owners[k])
        family = self._family(flat_count, index, e)
        if family is not None:
            return family
        dimension = second_variation(self._energy, point, self._J).dimension if flat else 0
        images, entry = self._images(point)
        self.orbits.append(Orbit(images, entry, index, flat, dimension, float(e.U[0]), 0))
        new = embedded(images, self.angles)
        owners = np.full(len(new), len(self.orbits) - 1)
        self._coordinates = np.concatenate([self._coordinates, new])
        self._owners = np.concatenate([self._owners, owners])
        return len(self.orbits) - 1

    def _family(self, dimension: int, index: int, e: Energies) -> int | None:
        """Return the known family of equal dimension, index and energy, or None."""
        near = _SAME_ENERGY * float(e.scale[0])
        for number, orbit in enumerate(self.orbits):
            is_alike = 0 < orbit.dimension == dimension and orbit.index == index
            if is_alike and abs(orbit.U - float(e.U[0])) <= near:
                return number
        return None

    def _images(self, point: Points) -> tuple[Points, NDArray[np.intp]]:
        """Return the distinct images of a point, and the number of the entry of each."""
        images = [point]
        for symmetry in self.symmetries:
            image = self._tidy(symmetry(point))
            if not self._contains(images, image):
                images.append(image)
        entry = np.full(len(images), -1, dtype=np.intp)
        for k, image in enumerate(images):
            if entry[k] >= 0:
                continue
            copies = [image, *(s(image) for s in self.symmetries if s.is_covering)]
            for j in range(k, len(images)):
                if self._contains(copies, images[j]):
                    entry[j] = k
        return joined(images), entry

    def _contains(self, points: list[Points], point: Points, within: float = _SAME) -> bool:
        coordinates = embedded(point, self.angles)
        return any(
            float(np.abs(embedded(other, self.angles) - coordinates).max(initial=0.0)) <= within
            for other in points
        )

    def _representatives(self, orbit: Orbit) -> Points:
        """Return the image with the smallest angles of each entry of an orbit."""
        chosen = []
        numbers = np.unique(orbit.entry) if not orbit.dimension else orbit.entry[:1]
        for number in numbers:
            copies = orbit.images[np.flatnonzero(orbit.entry == number)]
            values = copies.from_rest
            size = np.round(np.abs(values).sum(axis=1), 9)
            keys = np.round(np.concatenate([values, copies.n], axis=1), 9).T[::-1]
            best = np.lexsort((*(-keys), size))[0] if len(keys) else 0
            chosen.append(copies[best : best + 1])
        return joined(chosen)

    def _snapped(self, points: Points, flat: NDArray[np.bool_]) -> Points:
        """Move degenerate points close to a fixed point of a symmetry onto it."""
        # Newton's method converges slowly to degenerate points, and stops before it reaches them.
        x, n = points.x.copy(), points.n.copy()
        problem = self._energy.problem
        turning = np.array([k in problem.turning for k in problem.active], dtype=bool)
        for symmetry in self.symmetries if flat.any() else ():
            image = symmetry(points.at(x, n))
            across = points.at(x, n).shape_difference(image)
            across[:, turning] -= 2.0 * np.pi * np.round(across[:, turning] / (2.0 * np.pi))
            far = np.linalg.norm(np.concatenate([across, image.n - n], axis=1), axis=1)
            which = np.flatnonzero(flat & (far <= _SNAP) & (far > 0.0))
            if not which.size:
                continue
            n_middle = n[which] + 0.5 * (image.n - n)[which]
            if n.size:
                n_middle /= np.linalg.norm(n_middle, axis=1, keepdims=True)
            halfway = points.at(x, n)[which].shape_displaced(0.5 * across[which])
            if points.surface is not None:
                halfway = points.surface.closed(halfway)[0]
            middle = points.at(halfway, n_middle)
            before, after = (
                residuals(self._energy(p, self._J)) for p in (points.at(x, n)[which], middle)
            )
            better = after <= np.maximum(before, 1e-14)
            x[which[better]], n[which[better]] = middle.x[better], middle.n[better]
        return self._tidy(points.at(x, n))

    def _tidy(self, points: Points) -> Points:
        """Wrap periodic joints to (−π, π], choose one sign of quaternions, remove round-off."""
        x = points.x.copy()
        turning = x[:, self.angles]
        turning -= 2.0 * np.pi * np.ceil(turning / (2.0 * np.pi) - 0.5 - 1e-12)
        x[:, self.angles] = np.where(np.abs(turning) < _ROUND_OFF, 0.0, turning)
        for joint in points.space.balls if points.space is not None else ():
            x[x[:, joint.x.stop - 1] < 0.0, joint.x] *= -1.0
            x[:, joint.x] = np.where(np.abs(x[:, joint.x]) < _ROUND_OFF, 0.0, x[:, joint.x])
        return points.at(x, np.where(np.abs(points.n) < _ROUND_OFF, 0.0, points.n))

    def _none(self) -> Points:
        problem = self._energy.problem
        x, n = np.zeros((0, problem.space.nx)), np.zeros((0, 3 * problem.directional))
        return problem.points(x, n)
