"""branches(): relative equilibria followed over the momentum, through folds and pitchforks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ...common.arrays import Array, as_floats, freeze
from ...common.errors import InputError
from ...forces.force import Force
from ...forces.signals import Signal
from ...scene.option_checks import check_seed
from ...system.system import System, checked_system
from ..equilibria.amended_energy import AmendedEnergy, Points
from ..equilibria.find import checked_starts, equilibrium_at, search_points
from ..equilibria.problem import Problem, problem_of
from ..equilibria.relative_equilibrium import RelativeEquilibrium
from ..equilibria.same_shape import place_of
from ..equilibria.search import critical_points
from ..stability.second_variation import second_variation
from .bifurcations import Bifurcation, bifurcations_between, extended_residual
from .curve import Curve, CurvePoint

STEP = 0.05  # rad, the longest along a curve
_LEAST = 1e-6  # rad, the shortest
_BEND = 0.98  # cosine of the angle between tangents, from which on a step is short enough
_MOST = 4000  # steps of one curve
_MOST_CURVES = 200
_UNIT = 0.3  # part of the range of momenta that counts as 1 rad
_OFF = 0.02  # rad, the first step on a curve that branches off
_STARTS = 300
_ROUND_OFF = 1e-12  # rad | m; less is printed as none


@dataclass(frozen=True, eq=False)
class BranchPoint:
    """A relative equilibrium on a branch; arrays are read-only.

    branch: number of its branch.  momentum: J.  x: (m,) shape.  direction: as of
    RelativeEquilibrium.  amended_potential: [J].  index: negative curvatures of the amended
    potential: even ones may be stable, odd ones never are, zero is.  residual: relative.
    """

    branch: int
    momentum: float
    x: Array
    direction: Array
    amended_potential: float
    index: int
    residual: float
    problem: Problem = field(repr=False)

    def __post_init__(self) -> None:
        freeze(self)

    def equilibrium(self) -> RelativeEquilibrium:
        """Return the relative equilibrium with its stability, modes and scenes."""
        active = self.x[list(self.problem.active)]
        return equilibrium_at(
            self.problem, Points(active[None], self.direction[None]), self.momentum
        )


@dataclass(frozen=True, eq=False)
class Branches:
    """Branches of relative equilibria over a range of momenta.

    points: along one branch after the other.  folds: where a branch turns back in momentum;
    residual: how far, in momentum, the extended system's own solution is, relative to the range.
    pitchforks, crossings: where another branch begins, symmetric or not.
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
        """Return the points of a branch, in order.  Raises InputError for one there is not."""
        if not 0 <= k < self.count:
            raise InputError(f"there are {self.count} branches, counted from 0; got {k}")
        return tuple(point for point in self.points if point.branch == k)

    def __str__(self) -> str:
        low, high = self.momentum
        lines = [
            f"{self.system.name}: {self.count} branches of relative equilibria found for momenta "
            f"{low:g} to {high:g}, {len(self.points)} points"
        ]
        for k in range(self.count):
            some = self.branch(k)
            J, V = [p.momentum for p in some], [p.amended_potential for p in some]
            indices = sorted({p.index for p in some})
            lines.append(
                f"  {k}: momentum {min(J):.6g} … {max(J):.6g}, amended V {min(V):.6g} … "
                f"{max(V):.6g} J, index {', '.join(map(str, indices))}"
            )
        for name in ("folds", "pitchforks", "crossings"):
            for p in getattr(self, name):
                shape = ", ".join(
                    f"{0.0 if abs(value) < _ROUND_OFF else value:.6g}" for value in p.x
                )
                lines.append(f"  {name[:-1]} at momentum {p.momentum:.10g}: ({shape})")
        return "\n".join(lines)


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

    momentum: (low, high), two momenta, of which others start halfway, too.  step: the longest along
    a branch [rad].  The rest as of `relative_equilibria`; what is found there is followed both
    ways, and so is what branches off.  Folds are confirmed by an extended system and by halving
    the step.
    Raises InputError for what makes no sense, SymmetryError if gravity breaks the symmetry.
    """
    problem = problem_of(
        checked_system(system, "branches"), cyclic=cyclic, springs=springs, forces=forces,
        prescribed=prescribed, passive=passive,
    )  # fmt: skip
    low, high = _range(problem, momentum)
    if not problem.unknowns:
        raise InputError(
            f"nothing can change in a relative equilibrium of '{problem.system.name}': all of its "
            "joints are cyclic or held"
        )
    if not (np.isfinite(step) and step > 0.0):
        raise InputError(f"step must be finite and above zero, got {step!r}")
    starts, seed = checked_starts(starts), check_seed(seed)
    follower = _Follower(problem, low, high, step)
    levels = (low, 0.5 * (low + high), high)
    for J in levels:
        points, _, _ = search_points(problem, J, starts, seed)
        for k in range(len(points)):
            follower.add(points[k : k + 1], J)
    follower.follow_all()
    return follower.result()


class _Follower:
    """The curves that have been followed, and the points where others are to begin."""

    def __init__(self, problem: Problem, low: float, high: float, step: float) -> None:
        self._problem, self._low, self._high, self._step = problem, low, high, step
        self._energy = AmendedEnergy(problem)
        self._curve = Curve(self._energy, _UNIT * (high - low))
        self._starts: list[tuple[Points, float, Array | None]] = []
        self._curves: list[list[CurvePoint]] = []
        self._found: list[tuple[int, Bifurcation]] = []

    def add(self, point: Points, J: float, along: Array | None = None) -> None:
        self._starts.append((point, J, along))

    def follow_all(self) -> None:
        while self._starts and len(self._curves) < _MOST_CURVES:
            point, J, along = self._starts.pop(0)
            if self._known(point, J):
                continue
            first = self._curve.start(point, J, along)
            searched = along is not None or not self._in_family(point, J)
            number = len(self._curves)
            self._curves.append([first])
            ways = [self._walk(first, sign, number, searched) for sign in (1.0, -1.0)]
            self._curves[number] = [*ways[1][::-1], first, *ways[0]]

    def result(self) -> Branches:
        kinds: dict[str, list[BranchPoint]] = {"fold": [], "pitchfork": [], "crossing": []}
        for number, each in self._found:
            residual = each.residual
            if each.kind == "fold":
                residual = max(residual, extended_residual(self._curve, each.at))
            kinds[each.kind].append(self._point(number, each.at, residual))
        points = [self._point(k, at) for k, some in enumerate(self._curves) for at in some]
        return Branches(
            self._problem.system,
            (self._low, self._high),
            tuple(points),
            tuple(kinds["fold"]),
            tuple(kinds["pitchfork"]),
            tuple(kinds["crossing"]),
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

    def _walk(
        self, first: CurvePoint, sign: float, number: int, searched: bool
    ) -> list[CurvePoint]:
        """Follow a curve one way, to the end of the range or back to where it began."""
        out: list[CurvePoint] = []
        here, h = _turned(first, sign), 0.2 * self._step
        while len(out) < _MOST:
            there = self._curve.step(here, h)
            if there is None or there.tangent @ here.tangent < _BEND:
                h *= 0.5
                if h < _LEAST:
                    break
                continue
            if not self._low <= there.J <= self._high:
                end = self._at_end(here, there)
                if end is not None:
                    out.append(end)
                break
            if searched and there.index != here.index:
                between = bifurcations_between(self._curve, here, there, h)
                for found in between:
                    self._take(found, number)
                through = [each for each in between if each.kind == "pitchfork"]
                if through and here.tangent[-1] * there.tangent[-1] < 0.0:
                    out.append(through[0].at)  # behind it lies the mirror image
                    break
            out.append(there)
            if len(out) > 3 and self._close(first, there, 1.2 * h) and sign > 0.0:
                break
            here, h = there, min(1.3 * h, self._step)
        return out

    def _at_end(self, here: CurvePoint, there: CurvePoint) -> CurvePoint | None:
        """Return the point at the end of the range that lies between two."""
        J = self._low if self._low > there.J else self._high
        if here.J == J:
            return None
        part = (J - here.J) / (there.J - here.J)
        guess = Points(
            (here.x + part * (there.x - here.x))[None], (here.n + part * (there.n - here.n))[None]
        )
        if guess.n.size:
            guess = Points(guess.x, guess.n / np.linalg.norm(guess.n))
        point, _ = critical_points(self._energy, guess, J)
        if not len(point) or np.linalg.norm(point.x[0] - here.x) > 2.0 * self._step:
            return None
        return self._curve.start(point, J, here.tangent)

    def _take(self, found: Bifurcation, number: int) -> None:
        """Keep a bifurcation that is new, and have what branches off followed."""
        unit = self._curve.unit
        for _, other in self._found:
            near = abs(other.at.J - found.at.J) < 1e-5 * unit
            if near and other.kind == found.kind and self._same(other.at.points, found.at.points):
                return
        self._found.append((number, found))
        if found.kind == "fold":
            return
        for sign in (1.0, -1.0):
            plane = self._curve.ambient(found.at, sign * found.null)
            beside = self._curve.step(found.at, _OFF, plane)
            if beside is not None and self._low <= beside.J <= self._high:
                self.add(beside.points, beside.J, plane)

    def _known(self, point: Points, J: float) -> bool:
        """Return whether one of the curves followed so far goes through a point."""
        near = 2.0 * self._step
        for some in self._curves:
            momenta = np.array([at.J for at in some])
            for a in np.flatnonzero((momenta[:-1] - J) * (momenta[1:] - J) <= 0.0).tolist():
                for at in (some[a], some[a + 1]):
                    guess, _ = critical_points(self._energy, at.points, J)
                    moved = np.linalg.norm(guess.x - at.x) if len(guess) else np.inf
                    if moved <= near and self._same(guess, point):
                        return True
            ends = [at for at in (some[0], some[-1]) if abs(at.J - J) <= 1e-9 * self._curve.unit]
            if any(self._same(at.points, point) for at in ends):
                return True
        return False

    def _same(self, a: Points, b: Points) -> bool:
        places = [place_of(self._problem, self._problem.shapes(p.x)[0], p.n[0]) for p in (a, b)]
        return places[0].same(places[1], reversible=self._problem.reversible)

    def _close(self, first: CurvePoint, there: CurvePoint, h: float) -> bool:
        gone = np.concatenate([there.x - first.x, there.n - first.n])
        momentum = abs(there.J - first.J) / self._curve.unit
        return bool(np.linalg.norm(gone) < h and momentum < h)

    def _in_family(self, point: Points, J: float) -> bool:
        return second_variation(self._energy, point, J).dimension > 0


def _turned(at: CurvePoint, sign: float) -> CurvePoint:
    return CurvePoint(at.x, at.n, at.J, sign * at.tangent, at.values, at.residual)


def _range(problem: Problem, momentum: ArrayLike) -> tuple[float, float]:
    """Return least and greatest momentum.  Raises InputError."""
    ends = as_floats(momentum, "momentum")
    if ends.shape != (2,) or not np.isfinite(ends).all() or not ends[0] < ends[1]:
        raise InputError(f"momentum must be (low, high), both finite, low first, got {momentum!r}")
    low, high = (float(end) for end in ends)
    if (problem.directional and low < 0.0) or (problem.kind == "free" and low == 0.0):
        raise InputError(f"momentum is |J|, which is above zero on a branch, got {low:g}")
    return low, high
