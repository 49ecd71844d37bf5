"""Distinct critical points: equal ones have the same body positions up to known coverings.

Two points are equal if their coordinates agree, perhaps after full turns of joints, and also if a
covering maps one to the other. Points of different index are never equal.
Symmetries that are not coverings, such as mirror images, produce further critical points.

A symmetry maps each hinge to ±x or ±x + π, perhaps of another joint, and the direction n to ±P n.
It maps the attitude R of a ball to L R Q, where Q is a half turn of the child or a reflection.
P is a rotation by half a turn or a reflection at a plane. The joints are searched along the tree:
body by body, the image must have the mass distribution of the body after P. The amended potential
at random points then confirms the symmetry. A covering keeps the position of every body's mass.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import combinations, islice, product
from typing import TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ...common.arrays import Array, freeze
from ...lie.rotations import quaternion_from_matrix, quaternion_product, rotation
from ...system.coordinates import tree_space
from ...system.joints import axes_of
from ..stability.stability_verdict import second_variation
from .amended_potential import AmendedEnergy, Energies, newton_step, residuals, some
from .equilibrium_problem import Points, Problem, embedded, joined

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
        is_root = flat | (np.linalg.norm(newton_step(e), axis=1) <= _SAME)
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


_SAME_MASS = 1e-9  # largest difference of equal mass distributions, relative to the robot's size
_SYMMETRIC_ENERGY = 1e-11  # largest relative difference of the energies of symmetric points
_POINTS = 3  # number of random points at which the energies must agree
_BallMaps: TypeAlias = dict[str, tuple[str, Array, Array]]
_MOST = 256  # largest number of joint maps per turn of the base


@dataclass(frozen=True, eq=False)
class BallMap:
    """The map q → left ∘ q ∘ right of the attitude of a ball. Arrays are read-only.

    Attributes:
        source: Number of the ball whose attitude is taken, among the active balls.
        left: Quaternion, (4,).
        right: Quaternion, (4,).
    """

    source: int
    left: Array
    right: Array

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, eq=False)
class Symmetry:
    """The map x → sign · x[order] + shift, n → turn · n. Arrays are read-only.

    Attributes:
        order: For each of the s active hinges and slides, the one whose value it receives, (s,).
        sign: Signs of the joint values, (s,).
        shift: Offsets added to the joint values, (s,) [rad].
        turn: Orthogonal map of the direction, (3, 3).
        is_covering: Whether all masses keep their positions up to a motion of the base, so that
            the image is the same motion, perhaps reversed.
        balls: Maps of the active balls.
    """

    order: NDArray[np.intp]
    sign: Array
    shift: Array
    turn: Array
    is_covering: bool
    balls: tuple[BallMap, ...] = ()

    def __post_init__(self) -> None:
        freeze(self)

    def __call__(self, points: Points) -> Points:
        """Return the images of points.

        Args:
            points: Points, (N,).
        Returns:
            The images, (N,).
        """
        n = points.n @ self.turn.T if points.n.shape[1] else points.n
        space = points.space
        if space is None:
            return points.at(self.sign * points.x[:, self.order] + self.shift, n)
        x, scalars = points.x.copy(), space.scalar_x
        x[:, scalars] = self.sign * points.x[:, scalars[self.order]] + self.shift
        for joint, image in zip(space.balls, self.balls, strict=True):
            q = quaternion_product(image.left, points.x[:, space.balls[image.source].x])
            x[:, joint.x] = quaternion_product(q, image.right)
        return points.at(x, n)


def symmetries_of(energy: AmendedEnergy, J: float) -> tuple[Symmetry, ...]:
    """Return the symmetries of a problem except the identity.

    Args:
        energy: The amended potential.
        J: Momentum.
    Returns:
        The symmetries; symmetries of other forms than in the module's description are missed.
    """
    problem = energy.problem
    rng = np.random.default_rng(1)
    x = rng.uniform(0.4, 1.2, (_POINTS, len(problem.active)))
    n = rng.normal(size=(_POINTS, 3 * problem.directional))
    n = n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-300)
    space = problem.space
    if space.balls:
        x = space.integrate(space.neutral, x)
    if problem.surface is not None:
        x = problem.surface.random(x, rng)
    points = problem.points(x, n)
    e = energy(points, J)
    candidates = _without_copies(_candidates(problem, points.x[0]), points)
    if not candidates:
        return ()
    images = joined([candidate(points) for candidate in candidates])
    difference = energy(images, J).U.reshape(len(candidates), _POINTS) - e.U
    agrees = np.all(np.abs(difference) <= _SYMMETRIC_ENERGY * e.scale, axis=1)
    if problem.surface is not None:
        agrees &= problem.surface.is_closed(images.x).reshape(len(candidates), _POINTS).all(axis=1)
    return tuple(c for c, same in zip(candidates, agrees.tolist(), strict=True) if same)


def _without_copies(candidates: Iterable[Symmetry], points: Points) -> list[Symmetry]:
    """Remove the identity and repeated maps; among equal maps, a covering is kept."""
    angles = np.ones(points.x.shape[1], dtype=bool)
    if points.space is not None:
        angles[points.space.ball_x] = False
    images = [embedded(points, angles)]
    kept: list[Symmetry] = []
    for candidate in sorted(candidates, key=lambda c: not c.is_covering):
        image = embedded(candidate(points), angles)
        if all(np.abs(image - other).max(initial=0.0) > _SAME_MASS for other in images):
            images.append(image)
            kept.append(candidate)
    return kept


def _candidates(problem: Problem, active: Array) -> Iterator[Symmetry]:
    """Yield maps that move the masses by a half turn or a reflection at a generic shape."""
    tree, group = _Masses(problem), problem.system.group
    x = problem.shapes(active[None])[0]
    of_balls = set(problem.system.space.ball_v.tolist())
    scalars = [k for k in problem.active if k not in of_balls]
    of_active = {k: i for i, k in enumerate(scalars)}
    numbers = {joint.name: i for i, joint in enumerate(problem.space.balls)}
    for order in tree.orders():
        is_swapped = bool((order != np.arange(len(order))).any())
        for P in tree.turns():
            for sign, shift, source, by_ball in islice(tree.maps(x, P, order), _MOST):
                columns = [source[k] for k in scalars]
                if any(k not in of_active for k in columns):
                    continue
                proper = float(np.linalg.det(P)) > 0.0
                keeps = proper and not is_swapped and (
                    group.turns == 3
                    or bool(np.array_equal(P @ problem.axis, problem.axis) and group.turns)
                    or bool(np.array_equal(P, np.eye(3)))
                )  # fmt: skip
                for reverse in (1.0, -1.0) if problem.directional else (1.0,):
                    yield Symmetry(
                        order=np.array([of_active[k] for k in columns], dtype=np.intp),
                        sign=sign[scalars],
                        shift=shift[scalars],
                        turn=reverse * P,
                        is_covering=keeps and (reverse > 0.0 or problem.reversible),
                        balls=tuple(
                            BallMap(numbers[by_ball[name][0]], *by_ball[name][1:])
                            for name in numbers
                        ),
                    )


class _Masses:
    """The masses of a tree, and the joint maps that keep them."""

    def __init__(self, problem: Problem) -> None:
        system = problem.system
        model = system.sorted_model
        self._problem, self._system = problem, system
        self._space, self._tree = system.space, tree_space(model)
        self._parents = [0, 0, *(int(model.parents[i]) for i in range(2, model.njoints))]
        self._places = [model.jointPlacements[i] for i in range(model.njoints)]
        self._axes = [axes_of(model.joints[i])[:, 0] for i in range(2, model.njoints)]
        self._bodies = [(b.mass, b.lever, b.inertia) for b in model.inertias]
        self._children = [
            [k for k in range(2, model.njoints) if self._parents[k] == i]
            for i in range(model.njoints)
        ]
        about_com = system.group.linear == 3 or system.group.turns_about_com
        self._origin = self._bodies[1][1] if about_com and self._bodies[1][0] else np.zeros(3)
        arms = [place.translation for place in self._places[2:]]
        arms += [lever for _, lever, _ in self._bodies[1:]]
        self._size = max(float(np.linalg.norm(arms)), 1e-300)
        coupled, rates = system.coupled, [joint.v.start for joint in self._tree.joints]
        self._leads = [
            [k] if coupled is None else [lead for lead, _ in coupled.terms(k)] for k in rates
        ]

    def turns(self) -> list[Array]:
        """Return identity, half turns and reflections in the frames of base and first joints."""
        return self._turns_of_body(1)

    def _turns_of_body(self, i: int) -> list[Array]:
        """Return identity, half turns and reflections in the frames of a body and its joints."""
        mass, _, T = self._bodies[i]
        frames = [np.eye(3), *(self._places[k].rotation for k in self._children[i])]
        if mass:
            frames.append(np.linalg.eigh(T)[1])
        signs = [np.diag(s) for s in product((1.0, -1.0), repeat=3)]
        turns: list[Array] = []
        for frame, sign in product(frames, signs):
            P = frame @ sign @ frame.T
            P = np.where(np.abs(P - np.round(P)) < 1e-14, np.round(P), P) + 0.0
            if not any(np.abs(P - other).max() < 1e-12 for other in turns):
                turns.append(P)
        return turns

    def orders(self) -> list[NDArray[np.intp]]:
        """Return the identity, and exchanges of two equal limbs, as permutations of the bodies."""
        identity = np.arange(len(self._bodies))
        orders = [identity]
        for siblings in self._children[1:]:
            for a, b in combinations(siblings, 2):
                pairs = self._paired(a, b)
                if pairs:
                    order = identity.copy()
                    for i, j in pairs:
                        order[i], order[j] = j, i
                    orders.append(order)
        return orders

    def _paired(self, a: int, b: int) -> list[tuple[int, int]]:
        """Pair the bodies of two limbs; return an empty list if the limbs differ."""
        first, second = self._children[a], self._children[b]
        if self._bodies[a][0] != self._bodies[b][0] or len(first) != len(second):
            return []
        pairs = [(a, b)]
        for i, j in zip(first, second, strict=True):
            below = self._paired(i, j)
            if not below:
                return []
            pairs += below
        return pairs

    def maps(
        self, x: Array, P: Array, order: NDArray[np.intp]
    ) -> Iterator[tuple[Array, Array, Array, _BallMaps]]:
        """Yield signs, shifts and sources of the shape coordinates that move the masses by P.

        Args:
            x: A generic shape, (nx,).
            P: Orthogonal map of the base, (3, 3).
            order: For each body, the body that takes its position.
        Yields:
            Triples (sign, shift, source) of arrays (m,), and the maps of balls by name.
        """
        placed = [pin.SE3.Identity()] * len(self._bodies)
        values = self._system.joint_values(x)
        for i in range(2, len(placed)):
            placed[i] = self._placed(placed, i, values)
        targets = [self._moved(P, placed[i], i) for i in range(len(placed))]
        if not self._agrees(pin.SE3.Identity(), int(order[1]), targets[1]):
            return
        m = self._system.m
        state = np.ones(m), np.zeros(m), np.full(m, -1), _BallMaps()
        images = [pin.SE3.Identity()] * len(placed)
        self._P, self._turned = P, [place.rotation for place in placed]
        yield from self._extended(2, x, order, targets, images, state)

    def _extended(
        self,
        i: int,
        x: Array,
        order: NDArray[np.intp],
        targets: list[tuple[float, Array, Array]],
        images: list[pin.SE3],
        state: tuple[Array, Array, Array, _BallMaps],
    ) -> Iterator[tuple[Array, Array, Array, _BallMaps]]:
        """Yield the maps that extend a map of the bodies before body i."""
        if i == len(targets):
            yield state[0].copy(), state[1].copy(), state[2].copy(), dict(state[3])
            return
        j = int(order[i])
        if self._tree.joints[i - 2].kind.is_ball or self._tree.joints[j - 2].kind.is_ball:
            yield from self._extended_by_ball(i, x, order, targets, images, state)
            return
        sign, shift, sources, _ = state
        targets_of_joint, sources_of_joint = self._leads[j - 2], self._leads[i - 2]
        if len(targets_of_joint) != len(sources_of_joint):
            return
        pairs = list(zip(targets_of_joint, sources_of_joint, strict=True))
        if any(sources[target] not in (-1, source) for target, source in pairs):
            return
        new = [(target, source) for target, source in pairs if sources[target] < 0]
        for choices in product(*(self._choices(target) for target, _ in new)):
            for (target, source), (factor, offset) in zip(new, choices, strict=True):
                sign[target], shift[target], sources[target] = factor, offset, source
            image = self._image(x, sign, shift, sources)
            images[j] = self._placed(images, j, self._system.joint_values(image))
            if self._agrees(images[j], j, targets[i]):
                yield from self._extended(i + 1, x, order, targets, images, state)
        for target, _ in new:
            sign[target], shift[target], sources[target] = 1.0, 0.0, -1

    def _extended_by_ball(
        self,
        i: int,
        x: Array,
        order: NDArray[np.intp],
        targets: list[tuple[float, Array, Array]],
        images: list[pin.SE3],
        state: tuple[Array, Array, Array, _BallMaps],
    ) -> Iterator[tuple[Array, Array, Array, _BallMaps]]:
        """Yield the maps that extend a map by a ball; the image of body i has the attitude P R Q.

        The attitude relative to the parent becomes L R Q with a constant L.
        """
        j = int(order[i])
        source, target = self._tree.joints[i - 2], self._tree.joints[j - 2]
        if not (source.kind.is_ball and target.kind.is_ball):
            return
        P, by_ball = self._P, state[3]
        R = rotation(self._system.joint_values(x)[source.x])
        proper = float(np.linalg.det(P))
        parent = images[self._parents[j]] * self._places[j]
        for Q in self._turns_of_body(i):
            if float(np.linalg.det(Q)) * proper < 0.0:
                continue
            attitude = P @ self._turned[i] @ Q
            images[j] = pin.SE3(attitude, parent.translation)
            if not self._agrees(images[j], j, targets[i]):
                continue
            before = parent.rotation.T @ attitude @ Q.T @ R.T
            before, right = (quaternion_from_matrix(proper * factor) for factor in (before, Q))
            by_ball[target.name] = (source.name, before, right)
            yield from self._extended(i + 1, x, order, targets, images, state)
        by_ball.pop(target.name, None)

    def _image(self, x: Array, sign: Array, shift: Array, sources: Array) -> Array:
        """Return the image, (nx,), of the hinges and slides of a shape."""
        if not self._space.balls:
            return np.asarray(sign * x[sources] + shift)
        values, image = np.zeros(self._space.m), x.copy()
        values[self._space.scalar_v] = x[self._space.scalar_x]
        values = sign * values[sources] + shift
        image[self._space.scalar_x] = values[self._space.scalar_v]
        return image

    def _choices(self, k: int) -> list[tuple[float, float]]:
        """Return signs and shifts of a shape coordinate that are tried."""
        if k not in self._problem.active:
            return [(1.0, 0.0)]
        shifts = (0.0, np.pi) if k in self._problem.turning else (0.0,)
        return list(product((1.0, -1.0), shifts))

    def _placed(self, placed: list[pin.SE3], i: int, values: Array) -> pin.SE3:
        """Return the placement of body i for coordinates of all joints."""
        joint, parent = self._tree.joints[i - 2], placed[self._parents[i]] * self._places[i]
        if joint.kind.is_ball:
            return parent * pin.SE3(rotation(values[joint.x]), np.zeros(3))
        return parent * pin.exp6(self._axes[i - 2] * values[joint.x.start])

    def _moved(self, P: Array, place: pin.SE3, i: int) -> tuple[float, Array, Array]:
        """Return mass, centre and inertia of body i at a place, transformed by the isometry P."""
        mass, lever, T = self._bodies[i]
        R = P @ place.rotation
        return mass, self._origin + P @ (place.act(lever) - self._origin), R @ T @ R.T

    def _agrees(self, place: pin.SE3, i: int, target: tuple[float, Array, Array]) -> bool:
        mass, centre, T = self._moved(np.eye(3), place, i)
        if mass != target[0]:
            return False
        if mass == 0.0:
            return True
        far = float(np.abs(centre - target[1]).max()) > _SAME_MASS * self._size
        is_rotated = float(np.abs(T - target[2]).max()) > _SAME_MASS * max(
            float(np.abs(T).max()), 1e-300
        )
        return not (far or is_rotated)
