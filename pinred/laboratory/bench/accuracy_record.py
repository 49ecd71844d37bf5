"""Work–precision results of one problem: run times, errors, and time ratios at equal error.

A record of results is one csv file whose rows are self-contained. The rows of a scene are written
together. An interrupted benchmark keeps all completed scenes and can continue with the next scene.
Every row names its run. Reading keeps runs separate, so that ratios never compare times of
different runs.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.errors import InputError, LoadError
from ...common.files import read_plain_file, write_table
from ...common.names import quoted_path
from .timing import Table, cell

ERRORS = tuple(float(f"1e-{k}") for k in range(4, 14))


@checks_arguments
@dataclass(frozen=True)
class Point:
    """Result of one method at one tolerance, at the final time of a problem.

    Attributes:
        method: Name of the method.
        tolerance: Relative tolerance; for fixed steps, their length relative to the duration.
        wall: Median wall time of a run [s].
        build: Time of preparation [s].
        evaluations: Evaluations of the vector field; steps for Taylor methods.
        shape: Largest |Δx| [rad | m].
        rotation: Norm of the rotational part of log(g⁻¹ĝ) of the base [rad].
        position: Norm of the translational part of log(g⁻¹ĝ) [m].
        energy: Relative drift of energy, see `compute_drift`.
        momentum: Relative drift of momentum.
        failure: Reason for a failure of the method, whose numbers are then NaN; "" otherwise.
    """

    method: str
    tolerance: float
    wall: float = np.nan
    build: float = np.nan
    evaluations: float = np.nan
    shape: float = np.nan
    rotation: float = np.nan
    position: float = np.nan
    energy: float = np.nan
    momentum: float = np.nan
    failure: str = ""

    @property
    def error(self) -> float:
        """Largest of shape, rotation and position error [rad | m]; NaN if any is NaN."""
        return float(np.max([self.shape, self.rotation, self.position]))


@checks_arguments
@dataclass(frozen=True)
class WorkPrecision:
    """Run times and errors of methods on one problem, measured in one run.

    Attributes:
        problem: Name of the problem.
        joints: Number of joints m.
        duration: Duration of the motion [s].
        reference_error: Estimated error of the reference [rad | m]; smaller errors cannot be
            resolved.
        about: Mapping from each method to a description of its timed work.
        points: Results of all methods and tolerances.
        description: Description of the problem.
        reference: Description of the reference solution.
        missing: Mapping from each missing method to the reason why it could not run.
        run: Name of the run; times of different runs must not be compared.
    """

    problem: str
    joints: int
    duration: float
    reference_error: float
    about: Mapping[str, str]
    points: tuple[Point, ...]
    description: str = ""
    reference: str = ""
    missing: Mapping[str, str] = field(default_factory=dict)
    run: str = ""

    def of(self, method: str) -> list[Point]:
        """Return the successful points of a method.

        Args:
            method: Name of the method.
        Returns:
            Its points without failure.
        Raises:
            InputError: Unknown method.
        """
        if method not in self.about:
            raise InputError(f"no method '{method}'; the methods are {', '.join(self.about)}")
        return [p for p in self.points if p.method == method and not p.failure]

    def wall_at(self, method: str, error: float) -> float:
        """Interpolate the wall time of a method at an error.

        The logarithms of error and time are interpolated between Pareto-optimal points. Above the
        largest measured error the time of the fastest point is returned.

        Args:
            method: Name of the method.
            error: Error [rad | m].
        Returns:
            Wall time [s]; NaN if the method does not reach the error.
        """
        front: list[tuple[float, float]] = []  # (log error, log wall) of Pareto-optimal points
        best = np.inf
        for p in sorted(self.of(method), key=lambda p: (p.error, p.wall)):
            if p.wall < best:
                best = p.wall
                front.append((np.log(max(p.error, self.reference_error)), np.log(p.wall)))
        if not front or np.log(error) < front[0][0]:
            return float("nan")
        errors, walls = zip(*front, strict=True)
        return float(np.exp(np.interp(np.log(error), errors, walls)))

    def only(self, methods: Iterable[str]) -> WorkPrecision:
        """Return the results of some methods only.

        Args:
            methods: Names of the methods.
        Returns:
            Their results.
        """
        points = {name: self.of(name) for name in methods}
        return replace(
            self,
            about={name: self.about[name] for name in points},
            points=tuple(point for name in points for point in points[name]),
        )

    def fastest_of_tools(self, error: float) -> list[str]:
        """Return the default method of pinred, and the fastest method of each other tool.

        The tool is the method's name up to its first hyphen. `pinred` is a complete call of
        `simulate`; if it was not measured, the fastest method of pinred replaces it.

        Args:
            error: Error at which times are compared [rad | m].
        Returns:
            Names of methods.
        """
        tools: dict[str, list[str]] = {}
        for name in self.about:
            tools.setdefault(name.partition("-")[0], []).append(name)
        if "pinred" in self.about:
            tools["pinred"] = ["pinred"]

        def wall(name: str) -> float:
            wall_time = self.wall_at(name, error)
            return np.inf if np.isnan(wall_time) else wall_time

        return [min(names, key=wall) for names in tools.values()]

    def ratio_at(self, peer: str, error: float, method: str = "pinred") -> float:
        """Return the ratio of a peer's wall time to a method's wall time at equal error.

        Args:
            peer: Name of the peer's method.
            error: Error [rad | m].
            method: Name of the method to compare with.
        Returns:
            The ratio; NaN if either method does not reach the error.
        """
        return self.wall_at(peer, error) / self.wall_at(method, error)

    def _repr_html_(self) -> str:
        from ...common.html import card, line, table

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
            (f"{error:.0e}", *(cell(self._wall_in_ms(name, error)) for name in self.about))
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

    def __str__(self) -> str:
        joints = f"{self.joints} joint{'s' * (self.joints != 1)}"
        lines = [
            f"{self.problem} ({self.description}): {joints}, {self.duration:g} s; the reference is "
            f"known to {self.reference_error:.0e}" + (f": {self.reference}" * bool(self.reference)),
            *(f"  {name}: {text}" for name, text in self.about.items()),
            *(f"  {line}" for line in dict.fromkeys(self.missing.values())),
        ]
        points = tuple(SimpleNamespace(**vars(point)) for point in self.points)
        tables = [
            Table(NAME, points, {"wall": "s", "build": "s"}),
            self._at_equal_errors("wall time [ms]", self._wall_in_ms, self.about),
        ]
        peers = [name for name in self.about if not name.startswith("pinred")]
        for method in (name for name in self.about if name.startswith("pinred") and peers):
            title = f"how many times faster {method} is"
            ratio = partial(self.ratio_at, method=method)
            tables.append(self._at_equal_errors(title, ratio, peers))
        return "\n\n".join(["\n".join(lines), *map(str, tables)])

    def _wall_in_ms(self, method: str, error: float) -> float:
        return 1e3 * self.wall_at(method, error)

    @staticmethod
    def _at_equal_errors(
        title: str, value: Callable[[str, float], float], names: Iterable[str]
    ) -> Table:
        """Return a table with a row for each name and a column for each error."""
        rows = [
            SimpleNamespace(error=name, **{f"{error:.0e}": value(name, error) for error in ERRORS})
            for name in names
        ]
        return Table(NAME, tuple(rows), title=f"{title} at equal error")


NAME = "accuracy.csv"
_MOST_BYTES = 10**8
_POINT = tuple(field.name for field in fields(Point))
_ABOUT = (
    *("effort", "run", "problem", "description", "joints", "duration"),
    *("reference_error", "reference"),
)
COLUMNS = (*_ABOUT, "about", *_POINT, "error")


@checks_arguments
def write_record(path: Path, effort: str, results: Iterable[WorkPrecision]) -> None:
    """Write results to a csv file; on failure an existing file is kept.

    Args:
        path: The file.
        effort: Name of the time budget (Effort) of the measurement.
        results: Results of `bench_accuracy`.
    Raises:
        OutputError: The file cannot be written.
    """
    records: list[dict[str, object]] = []
    for result in results:
        head = {name: getattr(result, name) for name in _ABOUT[1:]} | {"effort": effort}
        for point in result.points:
            about = result.about[point.method]
            records.append({**head, **vars(point), "about": about, "error": point.error})
        records += [
            {**head, "method": method, "failure": line} for method, line in result.missing.items()
        ]
    write_table(path, COLUMNS, records)


@checks_arguments
def read_record(path: Path, effort: str | None = None) -> list[WorkPrecision]:
    """Read the results from a csv file, in the order of the file.

    Args:
        path: The file.
        effort: Required effort of the measurement; None accepts any effort.
    Returns:
        The results.
    Raises:
        LoadError: The file cannot be read, or is not a record of `bench accuracy`.
        InputError: The file was measured with another effort.
    """
    name, content = quoted_path(path), read_plain_file(path, _MOST_BYTES)
    if content is None:
        raise LoadError(f"cannot read table {name}: there is no such file")
    try:
        rows = list(csv.DictReader(io.StringIO(content.decode(), newline="")))
    except (UnicodeDecodeError, csv.Error) as error:
        raise LoadError(f"cannot read table {name}: {error}") from None
    groups: dict[tuple[str, str], list[dict[str, str]]] = {}
    try:
        for row in rows:
            groups.setdefault((row["problem"], row["run"]), []).append(row)
        other_efforts = {row["effort"] for row in rows} - {effort}
        results = [_result_of_rows(group) for group in groups.values()]
    except (KeyError, ValueError, TypeError) as error:
        reason = f"it has no column {error}" if isinstance(error, KeyError) else error
        raise LoadError(
            f"{name} is not accuracy.csv of `pinred bench accuracy`: {reason}"
        ) from None
    if effort is not None and other_efforts:
        raise InputError(
            f"{name} was measured as '{min(other_efforts)}', not '{effort}': "
            "choose another folder, or the same options"
        )
    return results


def _result_of_rows(rows: list[dict[str, str]]) -> WorkPrecision:
    head = rows[0]
    measured = [row for row in rows if row["tolerance"]]
    return WorkPrecision(
        problem=head["problem"],
        description=head["description"],
        joints=int(head["joints"]),
        duration=float(head["duration"]),
        reference_error=float(head["reference_error"]),
        reference=head["reference"],
        about={row["method"]: row["about"] for row in measured},
        points=tuple(_point_of_row(row) for row in measured),
        missing={row["method"]: row["failure"] for row in rows if not row["tolerance"]},
        run=head["run"],
    )


def _point_of_row(row: dict[str, str]) -> Point:
    numbers = {name: float(row[name]) for name in _POINT if name not in ("method", "failure")}
    if not math.isfinite(numbers["tolerance"]):
        raise ValueError(f"a tolerance of {row['tolerance']}")
    return Point(method=row["method"], failure=row["failure"], **numbers)
