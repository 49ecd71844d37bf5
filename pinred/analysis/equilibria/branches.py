"""branches(): follow relative equilibria as the momentum varies, through folds and pitchforks.

Bifurcations of relative equilibria: points of a curve where a Hessian eigenvalue vanishes.

F(z, J) = 0 is the equation of the curve, see `curve`; "curvatures" are the eigenvalues of ∂F/∂z.
At a bifurcation, ∂F/∂z has a null vector v. If v·∂F/∂J ≠ 0, the curve reverses in momentum: the
point is a fold. Otherwise a second curve crosses it. The crossing is a pitchfork if the third
derivative along v vanishes, as a mirror symmetry implies. A fold must solve the extended system

    F(z, J) = 0,   ∂F/∂z v = 0,   |v| = 1

and must appear again with half the step. Otherwise it is an artefact of long steps.
Source: R. Seydel, "Practical bifurcation and stability analysis", 2010, ch. 5.

The curve is computed by pseudo-arclength continuation. With F = ∂U/∂z at z = (x, n) and momentum J,
a point of the curve and its unit tangent t solve

    F(z, J) = 0,     [∂F/∂z, ∂F/∂J] t = 0.

Newton's method computes the next point: the intersection of the curve with the plane normal to t
at distance h. Lengths are in radians; one unit of momentum counts as one radian.
Source: H. B. Keller, "Numerical solution of bifurcation and nonlinear eigenvalue problems", 1977.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays, as_floats, whole
from ...common.errors import InputError
from ...common.waiting import Wait
from ...forces.force import Force
from ...forces.signals import Signal
from ...system.coordinates import ShapeSpace
from ...system.system import System, checked_system
from ..stability.stability_verdict import second_variation, weights
from .amended_potential import AmendedEnergy, Energies, critical_points, residuals
from .distinct_points import DistinctPoints
from .equilibrium_problem import Points, Problem, problem_of, tangents
from .find_equilibria import ROUNDS, Search, equilibrium_at
from .relative_equilibrium import RelativeEquilibrium

_FOLD = 1e-6  # least |v·∂F/∂J| that counts as a fold, relative to |∂F/∂J|
_EVEN = 1e-4  # largest third derivative of a pitchfork, relative to the curvatures
_SAME_FOLD = 1e-7  # largest relative change of a fold's momentum with half the step
_STEP = 1e-3  # step of the finite differences along the null vector [rad]


@dataclass(frozen=True)
class Bifurcation:
    """A point of a curve where a curvature (an eigenvalue of the Hessian) is zero.

    Attributes:
        kind: "fold", "pitchfork" or "crossing".
        at: Point of the curve.
        null: Null vector v of ∂F/∂z, (u,).
        residual: Relative residual of F = 0 and ∂F/∂z v = 0.
    """

    kind: Literal["fold", "pitchfork", "crossing"]
    at: CurvePoint
    null: Array
    residual: float


def bifurcations_between(curve: Curve, a: CurvePoint, b: CurvePoint, h: float) -> list[Bifurcation]:
    """Return the bifurcations between two points of a curve.

    Args:
        curve: The curve.
        a: Point before the step.
        b: Point after the step.
        h: Length of the step [rad].
    Returns:
        Bifurcations, sorted by distance from a.
    """
    bifurcations = []
    for k in range(min(a.index, b.index), max(a.index, b.index)):
        zero = locate_zero(curve, a, h, k)
        if zero is None:
            continue
        bifurcation = classify(curve, zero)
        if bifurcation is not None and (
            bifurcation.kind != "fold" or _is_confirmed(curve, a, h, k, zero)
        ):
            bifurcations.append(bifurcation)
    return sorted(bifurcations, key=lambda item: _distance(item.at, a))


def _distance(one: CurvePoint, other: CurvePoint) -> float:
    return float(np.linalg.norm(other.points.shape_difference(one.points)))


def locate_zero(curve: Curve, a: CurvePoint, h: float, k: int) -> CurvePoint | None:
    """Locate the zero of the k-th curvature within one step of the curve.

    Args:
        curve: The curve.
        a: Point before the step.
        h: Length of the step [rad].
        k: Index of the curvature.
    Returns:
        The point, or None if the curvature does not change sign or the curve cannot be followed.
    """
    low, high = 0.0, h
    end = curve.step(a, h)
    if end is None or a.values[k] * end.values[k] > 0.0:
        return None
    f_low, f_high = float(a.values[k]), float(end.values[k])
    best = end if abs(f_high) < abs(f_low) else a
    for n in range(80):
        # Take secant steps, with a bisection at every third iteration so that the bracket shrinks.
        s = 0.5 * (low + high) if n % 3 == 2 else (low * f_high - high * f_low) / (f_high - f_low)
        if not low < s < high:
            s = 0.5 * (low + high)
        point = curve.step(a, s)
        if point is None:
            return None
        value = float(point.values[k])
        if abs(value) <= abs(float(best.values[k])):
            best = point
        if value == 0.0 or high - low <= 1e-15 * max(h, 1.0):
            break
        if value * f_low < 0.0:
            high, f_high = s, value
        else:
            low, f_low = s, value
    return best


def classify(curve: Curve, at: CurvePoint) -> Bifurcation | None:
    """Classify a point with a zero curvature; return None if no curvature vanishes."""
    v, F_J = curve.null_vector(at), curve.slope_by_momentum(at)
    e = curve.energy(at.points, at.J)
    size = _size(e)
    residual = max(float(np.abs(e.hessian[0] @ v).max()) / size, at.residual)
    if residual > 1e-7:
        return None
    # On symmetric shapes ∂F/∂J may vanish, so the bound also scales with the curvatures.
    if abs(v @ F_J) > _FOLD * max(float(np.linalg.norm(F_J)), size / curve.unit):
        return Bifurcation("fold", at, v, residual)
    curvatures = []
    for sign in (1.0, -1.0):
        neighbour = at.points.moved(sign * _STEP * v[None])
        energies = curve.energy(neighbour, at.J)
        direction = _transported(curve, at, neighbour, v)
        curvatures.append(float(direction @ energies.hessian[0] @ direction))
    third_derivative = (curvatures[0] - curvatures[1]) / (2.0 * _STEP)
    kind: Literal["pitchfork", "crossing"] = (
        "pitchfork" if abs(third_derivative) <= _EVEN * size else "crossing"
    )
    return Bifurcation(kind, at, v, residual)


def _size(e: Energies) -> float:
    """Return the magnitude of the curvatures, relative to which a curvature counts as zero."""
    return max(float(np.abs(e.hessian).max()), float(e.scale[0]), 1e-300)


def _transported(curve: Curve, at: CurvePoint, there: Points, v: Array) -> Array:
    """Convert a direction (u,) to the tangent coordinates at another point.

    Args:
        curve: The curve.
        at: Point where v is defined.
        there: The other point.
        v: Direction, (u,).
    Returns:
        The same direction in the tangent coordinates at the other point, (u,).
    """
    ambient = curve.ambient(at.n[None], np.append(v, 0.0))
    return curve.local(there.n, ambient)[:-1]


def _is_confirmed(curve: Curve, a: CurvePoint, h: float, k: int, fold: CurvePoint) -> bool:
    """Return whether a fold solves the extended system and appears again with half the step.

    Args:
        curve: The curve.
        a: Point before the step that contains the fold.
        h: Length of the step [rad].
        k: Index of the curvature that vanishes.
        fold: The fold.
    Returns:
        False if the fold is an artefact of the step.
    """
    if not extended_residual(curve, fold) <= 1e-9:
        return False
    point: CurvePoint | None = a
    for _ in range(4):  # Two half steps may span less of a bent curve than one full step.
        assert point is not None
        next_point = curve.step(point, 0.5 * h)
        if next_point is None:
            return False
        if point.values[k] * next_point.values[k] <= 0.0:
            zero = locate_zero(curve, point, 0.5 * h, k)
            return zero is not None and abs(zero.J - fold.J) <= _SAME_FOLD * max(
                abs(fold.J), curve.unit
            )
        point = next_point
    return False


def extended_residual(curve: Curve, fold: CurvePoint) -> float:
    """Compute the distance between a fold and the solution of the extended system.

    Newton's method starts close to the fold.

    Args:
        curve: The curve.
        fold: The fold.
    Returns:
        Difference in momentum, relative to the curve's unit; infinite without convergence.
    """
    from scipy.optimize import root

    energy, u = curve.energy, curve.energy.problem.unknowns
    v = curve.null_vector(fold)
    scale = _size(energy(fold.points, fold.J))

    def extended(unknown: Array) -> Array:
        step, J, w = unknown[:u], fold.J + unknown[u] * curve.unit, unknown[u + 1 :]
        point = fold.points.moved(step[None])
        energies = energy(point, J)
        direction = _transported(curve, fold, point, w)
        return np.concatenate(
            [energies.gradient[0] / scale, energies.hessian[0] @ direction / scale, [w @ w - 1.0]]
        )

    start = np.concatenate([1e-3 * v, [1e-4], v])
    solution = root(extended, start, method="hybr", options={"xtol": 1e-14, "maxfev": 400 * u})
    if not np.abs(solution.fun).max() <= 1e-10 or not np.linalg.norm(solution.x[:u]) <= 0.1:
        return np.inf
    return (
        float(abs(solution.x[u]))
        if abs(solution.x[u]) > 1e-9
        else float(np.abs(solution.fun).max())
    )


STEP = 0.05  # longest step along a curve [rad]
_SHORTEST = 1e-6  # shortest step along a curve [rad]
_BEND = 0.98  # least cosine of the angle between successive tangents
_MAX_STEPS = 4000  # largest number of steps of one curve
_MAX_CURVES = 200
_UNIT = 0.3  # fraction of the range of momenta that counts as 1 rad
_SWITCH = 0.02  # first step on a branching curve [rad]
_STARTS = 300  # number of starting points of each search
_SAME = 1e-5  # largest distance of equal points of a branch [rad | m]
_ROUND_OFF = 1e-12  # values below this bound are printed as zero [rad | m]


@checks_arguments
@dataclass(frozen=True, eq=False)
class BranchPoint(FrozenArrays):
    """A relative equilibrium on a branch. Arrays are read-only.

    Attributes:
        branch: Index of its branch.
        momentum: Momentum J [N s | N m s].
        x: Shape, (nx,) [rad | m | 1].
        direction: Direction in the body as in RelativeEquilibrium, (3,) or (0,).
        amended_potential: Amended potential [J].
        index: Number of negative curvatures of the amended potential. Index 0 is stable; an odd
            index is unstable; an even index may be either.
        residual: Relative residual; for a fold, see Branches.
        problem: Problem that the equilibrium solves.
    """

    branch: int
    momentum: float
    x: Array
    direction: Array
    amended_potential: float
    index: int
    residual: float
    problem: Problem = field(repr=False)

    def equilibrium(self) -> RelativeEquilibrium:
        """Compute the relative equilibrium with its stability, modes and scenes.

        Returns:
            The equilibrium.
        """
        point = self.problem.points(self.x[None, self.problem.active_x], self.direction[None])
        return equilibrium_at(self.problem, point, self.momentum)


@checks_arguments
@dataclass(frozen=True, eq=False)
class Branches:
    """Branches of relative equilibria over a range of momenta.

    Attributes:
        system: The system.
        momentum: Range of momenta (low, high) [N s | N m s].
        points: Points of all branches, one branch after the other.
        folds: Points where a branch reverses in momentum. Their residual includes the distance to
            the solution of the extended system, relative to the range of momenta.
        pitchforks: Points where a symmetric pair of branches begins.
        crossings: Points where two branches cross without symmetry.
    """

    system: System
    momentum: tuple[float, float]
    points: tuple[BranchPoint, ...]
    folds: tuple[BranchPoint, ...]
    pitchforks: tuple[BranchPoint, ...]
    crossings: tuple[BranchPoint, ...]

    @property
    def count(self) -> int:
        """Number of branches."""
        return 1 + max((point.branch for point in self.points), default=-1)

    def branch(self, k: int) -> tuple[BranchPoint, ...]:
        """Return the points of one branch, in order.

        Args:
            k: Index of the branch.
        Returns:
            The points.
        Raises:
            InputError: k is not the index of a branch.
        """
        if not 0 <= k < self.count:
            raise InputError(f"k: expected the index of a branch below {self.count}, got {k}")
        return tuple(point for point in self.points if point.branch == k)

    def __str__(self) -> str:
        low, high = self.momentum
        lines = [
            f"{self.system.name}: {self.count} branches of relative equilibria found for momenta "
            f"{low:g} to {high:g}, {len(self.points)} points"
        ]
        for k in range(self.count):
            points = self.branch(k)
            J, V = [p.momentum for p in points], [p.amended_potential for p in points]
            indices = sorted({p.index for p in points})
            lines.append(
                f"  {k}: momentum {min(J):.6g} … {max(J):.6g}, amended V {min(V):.6g} … "
                f"{max(V):.6g} J, index {', '.join(map(str, indices))}"
            )
        for name in ("folds", "pitchforks", "crossings"):
            for p in getattr(self, name):
                values = self.system.space.chart(p.x[None])[0]
                shape = ", ".join(
                    f"{0.0 if abs(value) < _ROUND_OFF else value:.6g}" for value in values
                )
                lines.append(f"  {name[:-1]} at momentum {p.momentum:.10g}: ({shape})")
        return "\n".join(lines)


@checks_arguments
@Wait("follows branches of relative equilibria")
def branches(
    system: System,
    *,
    momentum: ArrayLike,
    cyclic: Mapping[str, float] | None = None,
    starts: int = _STARTS,
    seed: int = 0,
    step: float = STEP,
    springs: Mapping[str, tuple[float, float]] | None = None,
    forces: Sequence[Force] | Force = (),
    prescribed: Mapping[str, Signal | float | str] | None = None,
    passive: bool = False,
) -> Branches:
    """Follow relative equilibria over a range of momenta, through folds and pitchforks.

    Searches at the lowest, middle and highest momentum give the starting points. Each curve is
    followed in both directions, and so is each curve that branches off. Folds are confirmed by an
    extended system and by halving the step.

    Args:
        system: The system.
        momentum: Range (low, high) [N s | N m s].
        cyclic: Momenta of cyclic joints by name [N m s | N s].
        starts: Number of starting points of each search.
        seed: Seed of the random starting points.
        step: Longest step along a branch [rad].
        springs: Spring stiffness and rest value by joint name.
        forces: Forces that keep the symmetry and do not depend on time.
        prescribed: Prescribed joints: a value, signal or expression by name.
        passive: Whether springs and friction of the robot file act.
    Returns:
        The branches with their bifurcations.
    Raises:
        InputError: An argument is invalid, or nothing can change in a relative equilibrium.
        SymmetryError: Gravity breaks the symmetry.
    """
    problem = problem_of(
        checked_system(
            system, "branches", remedy="Search at single momenta with relative_equilibria."
        ),
        cyclic=cyclic, springs=springs, forces=forces, prescribed=prescribed, passive=passive,
    )  # fmt: skip
    low, high = _momentum_range(problem, momentum)
    if not problem.unknowns:
        raise InputError(
            f"system: '{problem.system.name}' has no branches of relative equilibria, because "
            "all its joints are cyclic or prescribed"
        )
    if not (np.isfinite(step) and step > 0.0):
        raise InputError(f"step must be finite and above zero, got {step!r}")
    starts, seed = whole(starts, "starts"), whole(seed, "seed", 0)
    follower = _Follower(problem, low, high, step)
    levels = (low, 0.5 * (low + high), high)
    for J in levels:
        points = Search(problem, J, starts, seed, limit=ROUNDS * starts).points()
        for k in range(len(points)):
            follower.add(points[k : k + 1], J)
    follower.follow_all()
    return follower.result()


class _Follower:
    """The curves computed so far, and the queue of points from which further curves start."""

    def __init__(self, problem: Problem, low: float, high: float, step: float) -> None:
        self._problem, self._low, self._high, self._step = problem, low, high, step
        self._energy = AmendedEnergy(problem)
        self._curve = Curve(self._energy, _UNIT * (high - low))
        self._distinct = DistinctPoints(self._energy, high)
        self._starts: list[tuple[Points, float, Array | None]] = []
        self._curves: list[list[CurvePoint]] = []
        self._bifurcations: list[tuple[int, Bifurcation]] = []

    def add(self, point: Points, J: float, along: Array | None = None) -> None:
        """Queue a critical point from which a curve starts.

        Args:
            point: Critical point, a Points of length one.
            J: Momentum.
            along: Direction of the curve, (k,); None: larger momentum.
        """
        self._starts.append((point, J, along))

    def follow_all(self) -> None:
        """Follow the queued curves and the curves that branch off them."""
        while self._starts and len(self._curves) < _MAX_CURVES:
            point, J, tangent = self._starts.pop(0)
            if self._is_on_curve(point, J):
                continue
            first = self._curve.start(point, J, tangent)
            detect = tangent is not None or second_variation(self._energy, point, J).dimension == 0
            number = len(self._curves)
            self._curves.append([first])
            halves = [self._walk(first, sign, number, detect) for sign in (1.0, -1.0)]
            self._curves[number] = [*halves[1][::-1], first, *halves[0]]

    def result(self) -> Branches:
        """Return all branches and bifurcations."""
        points_by_kind: dict[str, list[BranchPoint]] = {"fold": [], "pitchfork": [], "crossing": []}
        for number, item in self._bifurcations:
            residual = item.residual
            if item.kind == "fold":
                residual = max(residual, extended_residual(self._curve, item.at))
            points_by_kind[item.kind].append(self._point(number, item.at, residual))
        points = [self._point(k, at) for k, curve in enumerate(self._curves) for at in curve]
        return Branches(
            self._problem.system,
            (self._low, self._high),
            tuple(points),
            tuple(points_by_kind["fold"]),
            tuple(points_by_kind["pitchfork"]),
            tuple(points_by_kind["crossing"]),
        )

    def _point(self, branch: int, at: CurvePoint, residual: float | None = None) -> BranchPoint:
        return BranchPoint(
            branch=branch,
            momentum=at.J,
            x=self._problem.shapes(at.x[None])[0],
            direction=at.n.copy(),
            amended_potential=float(self._energy(at.points, at.J).U[0]),
            index=at.index,
            residual=at.residual if residual is None else residual,
            problem=self._problem,
        )

    def _walk(self, first: CurvePoint, sign: float, number: int, detect: bool) -> list[CurvePoint]:
        """Follow a curve in one direction, to the end of the range or back to its first point.

        Args:
            first: First point.
            sign: Direction along its tangent, ±1.
            number: Index of the branch.
            detect: Whether to detect bifurcations.
        Returns:
            The points after the first.
        """
        points: list[CurvePoint] = []
        point, h = replace(first, tangent=sign * first.tangent), 0.2 * self._step
        while len(points) < _MAX_STEPS:
            next_point = self._curve.step(point, h)
            if next_point is None or next_point.tangent @ point.tangent < _BEND:
                h *= 0.5
                if h < _SHORTEST:
                    break
                continue
            if not self._low <= next_point.J <= self._high:
                end = self._end_of_range(point, next_point)
                if end is not None:
                    points.append(end)
                break
            if detect and next_point.index != point.index:
                bifurcations = bifurcations_between(self._curve, point, next_point, h)
                for bifurcation in bifurcations:
                    self._record(bifurcation, number)
                pitchforks = [item for item in bifurcations if item.kind == "pitchfork"]
                if pitchforks and point.tangent[-1] * next_point.tangent[-1] < 0.0:
                    points.append(
                        pitchforks[0].at
                    )  # Beyond the pitchfork the curve repeats mirrored.
                    break
            points.append(next_point)
            if len(points) > 3 and self._is_close(first, next_point, 1.2 * h) and sign > 0.0:
                break
            point, h = next_point, min(1.3 * h, self._step)
        return points

    def _end_of_range(self, here: CurvePoint, there: CurvePoint) -> CurvePoint | None:
        """Return the point at the end of the momentum range between two points of a curve."""
        J = self._low if self._low > there.J else self._high
        if here.J == J:
            return None
        fraction = (J - here.J) / (there.J - here.J)
        near = here.points
        displacement = fraction * near.shape_difference(there.points)
        guess = near.at(near.shape_displaced(displacement), near.n + fraction * (there.n - near.n))
        if guess.n.size:
            guess = guess.at(guess.x, guess.n / np.linalg.norm(guess.n))
        point, _ = critical_points(self._energy, guess, J)
        if not len(point) or np.linalg.norm(near.shape_difference(point)) > 2.0 * self._step:
            return None
        return self._curve.start(point, J, here.tangent)

    def _record(self, bifurcation: Bifurcation, number: int) -> None:
        """Record a new bifurcation, and queue the curves that branch off there."""
        unit = self._curve.unit
        for _, other in self._bifurcations:
            has_same_momentum = abs(other.at.J - bifurcation.at.J) < 1e-5 * unit
            if (
                has_same_momentum
                and other.kind == bifurcation.kind
                and self._is_same(other.at.points, bifurcation.at.points)
            ):
                return
        self._bifurcations.append((number, bifurcation))
        if bifurcation.kind == "fold":
            return
        for sign in (1.0, -1.0):
            plane = self._curve.ambient(
                bifurcation.at.n[None], np.append(sign * bifurcation.null, 0.0)
            )
            neighbour = self._curve.step(bifurcation.at, _SWITCH, plane)
            if neighbour is not None and self._low <= neighbour.J <= self._high:
                self.add(neighbour.points, neighbour.J, plane)

    def _is_on_curve(self, point: Points, J: float) -> bool:
        """Return whether a computed curve contains a critical point."""
        max_distance = 2.0 * self._step
        is_family = second_variation(self._energy, point, J).dimension > 0
        for curve in self._curves:
            momenta = np.array([at.J for at in curve])
            for a in np.flatnonzero((momenta[:-1] - J) * (momenta[1:] - J) <= 0.0).tolist():
                for at in (curve[a], curve[a + 1]):
                    guess, _ = critical_points(self._energy, at.points, J)
                    distance = np.inf
                    if len(guess):
                        distance = float(np.linalg.norm(at.points.shape_difference(guess)))
                    if distance > max_distance:
                        continue
                    if self._is_same(guess, point) or (
                        is_family and self._distinct.is_same_family(guess, point, J)
                    ):
                        return True
            ends = [at for at in (curve[0], curve[-1]) if abs(at.J - J) <= 1e-9 * self._curve.unit]
            if any(self._is_same(at.points, point) for at in ends):
                return True
        return False

    def _is_same(self, a: Points, b: Points) -> bool:
        """Return whether two points are the same equilibrium, perhaps after a covering."""
        return self._distinct.is_same(a, b, _SAME)

    def _is_close(self, first: CurvePoint, there: CurvePoint, h: float) -> bool:
        difference = first.points.difference(there.points)
        momentum = abs(there.J - first.J) / self._curve.unit
        return bool(np.linalg.norm(difference) < h and momentum < h)


def _momentum_range(problem: Problem, momentum: ArrayLike) -> tuple[float, float]:
    """Return the lowest and highest momentum of a valid range.

    Args:
        problem: Problem of the relative equilibria.
        momentum: Argument of `branches`.
    Returns:
        Lowest and highest momentum, (low, high).
    Raises:
        InputError: The range is not two finite momenta in order, or not positive where J is |J|.
    """
    ends = as_floats(momentum, "momentum")
    if ends.shape != (2,) or not np.isfinite(ends).all() or not ends[0] < ends[1]:
        raise InputError(f"momentum must be (low, high), finite and increasing, got {momentum!r}")
    low, high = (float(end) for end in ends)
    if (problem.directional and low < 0.0) or (problem.kind == "free" and low == 0.0):
        raise InputError(f"momentum: expected magnitudes |J| above zero, got {low:g}")
    return low, high


FLAT = 1e-7  # curvature below which a direction is flat, relative to the largest curvature
_MAX_ITERATIONS = 8  # largest number of Newton iterations
_CONVERGED = 1e-7  # largest Newton step at convergence; its square is below round-off


@dataclass(frozen=True)
class CurvePoint(FrozenArrays):
    """A point of the curve. Arrays are read-only.

    Attributes:
        x: Coordinates of the active joints, (k,) [rad | m | 1].
        n: Direction, (3,), or (0,) if there is none.
        J: Momentum.
        tangent: Unit tangent in (x, n, J), (ma + 4,) or (ma + 1,), along the frame of the shape and
            with J in the curve's unit.
        values: Curvatures as in SecondVariation, (u,) [1/s²], sorted.
        residual: Relative residual of F = 0.
        space: Manifold of the active joints; None if they are hinges and slides.
    """

    x: Array
    n: Array
    J: float
    tangent: Array
    values: Array
    residual: float
    space: ShapeSpace | None = None

    @property
    def points(self) -> Points:
        """The point as a Points of length one."""
        return Points(self.x[None], self.n[None], self.space)

    @property
    def index(self) -> int:
        """Number of negative curvatures."""
        return int((self.values < -FLAT * np.abs(self.values).max(initial=0.0)).sum())


class Curve:
    """Continuation of the curves of critical points of one problem.

    Attributes:
        energy: Amended potential U as a function of z = (x, n) and J.
        unit: Momentum that counts as 1 rad in arc lengths [N s | N m s].
    """

    def __init__(self, energy: AmendedEnergy, unit: float) -> None:
        """Store the amended potential and the unit of momentum."""
        self.energy, self.unit = energy, unit

    def start(self, point: Points, J: float, along: Array | None = None) -> CurvePoint:
        """Return the curve point at a critical point.

        Args:
            point: Critical point, a Points of length one.
            J: Momentum.
            along: Direction closest to the tangent, (k,); None: larger momentum.
        Returns:
            The point, with its tangent.
        """
        energies = self.energy(point, J)
        size = point.dimension + point.n.shape[1]
        if along is None:
            along = np.zeros(size + 1)
            along[-1] = 1.0
        return self._point(point, J, energies, along)

    def step(self, here: CurvePoint, h: float, plane: Array | None = None) -> CurvePoint | None:
        """Compute the next point of the curve.

        Args:
            here: Current point.
            h: Step [rad].
            plane: Direction of the step, (k,), instead of the tangent.
        Returns:
            The point, or None if Newton's method does not converge.
        """
        direction = here.tangent if plane is None else plane
        point = here.points.moved(h * self.local(here.n[None], direction)[None, :-1])
        J = here.J + h * direction[-1] * self.unit
        for _ in range(_MAX_ITERATIONS):
            energies = self.energy(point, J)
            if not np.isfinite(residuals(energies))[0]:
                return None
            normal = self.local(point.n, direction)
            defect = self._difference(here, point, J) @ direction - h
            matrix = np.vstack([self._derivative(energies), normal])
            residual = np.append(energies.gradient[0], defect)
            change = -np.linalg.lstsq(matrix, residual, rcond=1e-13)[0]
            point = point.moved(change[None, :-1])
            J += change[-1] * self.unit
            if np.linalg.norm(change) <= _CONVERGED:
                break
        energies = self.energy(point, J)
        if (
            not residuals(energies)[0] <= 1e-10
            or np.linalg.norm(self._difference(here, point, J)) > 2.0 * h
        ):
            return None
        return self._point(point, float(J), energies, direction)

    def slope_by_momentum(self, here: CurvePoint) -> Array:
        """Return the derivative of the gradient F with respect to the momentum, ∂F/∂J, (u,)."""
        return np.asarray(self.energy(here.points, here.J).by_momentum[0])

    def null_vector(self, here: CurvePoint) -> Array:
        """Return the unit direction (u,) of least absolute curvature."""
        hessian = self.energy(here.points, here.J).hessian[0]
        W = weights(self.energy.problem, here.points)
        values, vectors = np.linalg.eigh(W @ hessian @ W)
        v = W @ vectors[:, int(np.argmin(np.abs(values)))]
        return np.asarray(v / np.linalg.norm(v))

    @staticmethod
    def ambient(n: Array, local: Array) -> Array:
        """Convert tangent coordinates (u + 1,) of the sphere at n (1, 3) to a direction (k,)."""
        if not n.size:
            return local
        return np.concatenate([local[:-3], tangents(n)[0] @ local[-3:-1], local[-1:]])

    def _point(self, point: Points, J: float, e: Energies, along: Array) -> CurvePoint:
        """Return the curve point at a solution, with the unit tangent closest to a direction.

        Args:
            point: Critical point, a Points of length one.
            J: Momentum.
            e: Energies at the point.
            along: Direction, (k,).
        Returns:
            The point.
        """
        W = weights(self.energy.problem, point)
        values = np.linalg.eigvalsh(W @ e.hessian[0] @ W)
        direction = self.local(point.n, along)
        _, singular, vectors = np.linalg.svd(self._derivative(e))
        # In a family or at a crossing, several null directions exist; keep the previous tangent.
        rank = len(vectors) - 1
        if singular.size:
            rank = min(rank, int((singular > 1e-9 * singular[0]).sum()))
        null = vectors[rank:]
        t = null.T @ (null @ direction)
        length = float(np.linalg.norm(t))
        t = null[-1] if length < 1e-9 else t / length
        return CurvePoint(
            point.x[0].copy(), point.n[0].copy(), J, self.ambient(point.n, t), values,
            float(residuals(e)[0]), point.space,
        )  # fmt: skip

    def _derivative(self, e: Energies) -> Array:
        """Return the Jacobian [∂F/∂z, ∂F/∂J] of the curve's equations, (u, u + 1)."""
        return np.hstack([e.hessian[0], self.unit * e.by_momentum[0][:, None]])

    def local(self, n: Array, along: Array) -> Array:
        """Convert a direction (k,) to tangent coordinates (u + 1,) of the sphere at n (1, 3)."""
        if not n.size:
            return along
        T = tangents(n.reshape(1, 3))[0]
        return np.concatenate([along[:-4], T.T @ along[-4:-1], along[-1:]])

    def _difference(self, here: CurvePoint, point: Points, J: float) -> Array:
        """Return the difference in (x, n, J) of a point from a curve point, (k,).

        Args:
            here: Curve point.
            point: Other point, a Points of length one.
            J: Momentum of the other point.
        Returns:
            Difference in (x, n, J), with J in the curve's unit, (k,) [rad].
        """
        difference = here.points.difference(point)[0]
        return np.append(difference, (J - here.J) / self.unit)
