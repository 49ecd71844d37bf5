"""Run time against error: each method at each tolerance, judged by ABA on the full state."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError, IntegrationError, PinredError
from ..full_state import FullMotion
from .methods import METHODS, Method, Prepared
from .problems import Problem, Reference, default_problems
from .timing import ROUNDS, alternating, repeated

ERRORS = tuple(float(f"1e-{k}") for k in range(4, 13))


@dataclass(frozen=True)
class Point:
    """One method at one tolerance, at the end of a problem.

    wall: s of a run.  build: s before the first.  evaluations: of the vector field, or steps
    of a Taylor method.  shape: largest |Δx| [rad | m]; rotation [rad] and position [m] of the
    base: norms of the parts of log(g⁻¹ĝ).  failure: why it did not come to its end; then the
    numbers are NaN.
    """

    method: str
    tolerance: float
    wall: float = np.nan
    build: float = np.nan
    evaluations: float = np.nan
    shape: float = np.nan
    rotation: float = np.nan
    position: float = np.nan
    failure: str = ""

    @property
    def error(self) -> float:
        """The largest of the three errors [rad | m]; NaN stays."""
        return float(np.max([self.shape, self.rotation, self.position]))


@dataclass(frozen=True)
class WorkPrecision:
    """What accuracy costs on one problem.

    reference_error: how far the two references are apart [rad | m]; smaller errors of a
    point say nothing.  about: method to what is timed of it.  missing: a line on each method
    that could not run here.
    """

    problem: str
    joints: int
    duration: float
    reference_error: float
    about: Mapping[str, str]
    points: tuple[Point, ...]
    missing: tuple[str, ...] = ()

    def of(self, method: str) -> list[Point]:
        """Return the points of a method that came to their end.  Raises InputError."""
        if method not in self.about:
            raise InputError(f"no method '{method}'; they are {', '.join(self.about)}")
        return [p for p in self.points if p.method == method and not p.failure]

    def wall_at(self, method: str, error: float) -> float:
        """Return the seconds a method takes for an error [rad | m], NaN if it never gets there.

        Between measured points, of which only those count that no other beats in both time
        and error, the logarithms are interpolated.  Above the largest error measured it is
        the time of the fastest point.
        """
        front: list[tuple[float, float]] = []  # (log error, log wall), errors falling
        best = np.inf
        for p in sorted(self.of(method), key=lambda p: (p.error, p.wall)):
            if p.wall < best:
                best = p.wall
                front.append((np.log(max(p.error, self.reference_error)), np.log(p.wall)))
        if not front or np.log(error) < front[0][0]:
            return float("nan")
        errors, walls = zip(*front, strict=True)
        return float(np.exp(np.interp(np.log(error), errors, walls)))

    def ratio_at(self, peer: str, error: float, method: str = "pinred") -> float:
        """Return how many times longer a peer takes than a method at equal error."""
        return self.wall_at(peer, error) / self.wall_at(method, error)

    def __str__(self) -> str:
        lines = [
            f"{self.problem}: {self.joints} joint{'s' * (self.joints > 1)}, {self.duration:g} s; "
            f"the end against ABA on the full state (two references agree to "
            f"{self.reference_error:.0e})",
            *(f"  {name}: {text}" for name, text in self.about.items()),
            *(f"  {line}" for line in self.missing),
            "",
            f"{'method':<17} {'tolerance':>9} {'wall [ms]':>10} {'evaluations':>11} "
            f"{'shape':>8} {'rotation':>8} {'position':>8} {'build [s]':>9}",
            *(_row(p) for p in self.points),
            "",
            "wall time [ms] at equal error",
            f"{'error':<7}" + "".join(f"{name:>18}" for name in self.about),
            *(
                f"{error:<7.0e}" + "".join(_cell(1e3 * self.wall_at(n, error)) for n in self.about)
                for error in ERRORS
            ),
        ]
        peers = [name for name in self.about if not name.startswith("pinred")]
        for own in (name for name in self.about if name.startswith("pinred")):
            if peers:
                lines += ["", f"how many times faster {own} is", f"{'error':<7}"]
                lines[-1] += "".join(f"{name:>18}" for name in peers)
                for error in ERRORS:
                    cells = (_cell(self.ratio_at(peer, error, own)) for peer in peers)
                    lines.append(f"{error:<7.0e}" + "".join(cells))
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        from ..html_parts import card, line, table

        head = ["method", "tolerance", "error [rad | m]", "wall [ms]", "evaluations", ""]
        rows = [
            (
                p.method,
                f"{p.tolerance:.0e}",
                f"{p.error:.1e}",
                1e3 * p.wall,
                p.evaluations,
                p.failure,
            )
            for p in self.points
        ]
        equal = [
            (f"{error:.0e}", *(_cell(1e3 * self.wall_at(n, error)).strip() for n in self.about))
            for error in ERRORS
        ]
        return card(
            self.problem,
            f"{self.joints} joints, {self.duration:g} s, the end against ABA on the full state; "
            f"two references agree to {self.reference_error:.0e}",
            *(line(f"{name}: {text}") for name, text in self.about.items()),
            *map(line, self.missing),
            table("wall time [ms] at equal error", ["error", *self.about], equal),
            table("measured", head, rows),
        )


def _row(p: Point) -> str:
    head = f"{p.method:<17} {p.tolerance:>9.0e} "
    if p.failure:
        return f"{head}failed: {p.failure}"
    return head + (
        f"{1e3 * p.wall:>10.4f} {p.evaluations:>11.0f} {p.shape:>8.1e} {p.rotation:>8.1e} "
        f"{p.position:>8.1e} {p.build:>9.2f}"
    )


def _cell(value: float) -> str:
    return f"{'—' if np.isnan(value) else format(value, '.3g'):>18}"


def bench_accuracy(
    problems: Sequence[Problem] | None = None,
    *,
    methods: Sequence[Method] = METHODS,
    tolerances: Sequence[float] | None = None,
    rounds: int = ROUNDS,
    progress: Callable[[float], None] | None = None,
) -> list[WorkPrecision]:
    """Return what accuracy costs on each problem, by each method.

    problems: those of `default_problems` if None.  tolerances: each method's own if None.
    rounds: of which the median counts.  progress: called with the part done, 0 to 1.
    """
    given = default_problems()[0] if problems is None else list(problems)
    done = progress or (lambda _: None)
    found = []
    for k, problem in enumerate(given):

        def part(inner: float, k: int = k) -> None:
            done((k + inner) / len(given))

        found.append(_bench_problem(problem, methods, tolerances, rounds, part))
    return found


def _bench_problem(
    problem: Problem,
    methods: Sequence[Method],
    tolerances: Sequence[float] | None,
    rounds: int,
    progress: Callable[[float], None],
) -> WorkPrecision:
    able = [method for method in methods if not method.missing(problem)]
    wanted = [(m, tol) for m in able for tol in tolerances or m.tolerances]
    reference = problem.reference()
    points: list[Point] = []
    running: list[tuple[int, Prepared]] = []
    for k, (method, tolerance) in enumerate(wanted):
        try:
            prepared = method.prepare(problem, tolerance)
            points.append(_judged(problem, reference, method.name, tolerance, prepared))
            running.append((k, prepared))
        except PinredError as error:
            points.append(Point(method.name, tolerance, failure=str(error)))
        progress(0.5 * (k + 1) / len(wanted))
    times = alternating(
        [repeated(prepared.run) for _, prepared in running],
        rounds=rounds,
        progress=lambda part: progress(0.5 + 0.5 * part),
    )
    for j, (k, _) in enumerate(running):
        points[k] = replace(points[k], wall=float(np.median(times[:, j])))
    return WorkPrecision(
        problem=f"{problem.name} ({problem.about})",
        joints=problem.system.m,
        duration=problem.start.duration,
        reference_error=reference.error,
        about={method.name: method.about for method in able},
        points=tuple(points),
        missing=tuple(line for method in methods if (line := method.missing(problem))),
    )


def _judged(
    problem: Problem, reference: Reference, method: str, tolerance: float, prepared: Prepared
) -> Point:
    """Return the point of a first run, without its time.  Raises IntegrationError."""
    end = prepared.end(prepared.run())
    apart = problem.full.distance(reference.end, FullMotion(x=end.x[None], q=end.q[None]))
    point = Point(
        method=method,
        tolerance=tolerance,
        build=prepared.build,
        evaluations=end.evaluations,
        shape=float(apart.shape[0]),
        rotation=float(apart.rotation[0]),
        position=float(apart.position[0]),
    )
    if not np.isfinite(point.error):
        raise IntegrationError("the end is not finite")
    return point
