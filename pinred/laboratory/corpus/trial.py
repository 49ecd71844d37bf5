"""Trial of one description: load, compare with other readers, simulate, compare with ABA."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ...common.errors import (
    ChoiceError,
    IntegrationError,
    LoadError,
    MissingPackageError,
    ModelError,
    PinredError,
    SymmetryError,
)
from ...judge.compare import compare
from ...judge.verdict import Report, Verdict
from ...simulation.simulate import simulate
from ...system.independent_reader import second_reading
from ...system.load import load
from ...system.mjcf.package import mujoco_package
from ...system.system import System
from .corpus_entry import Entry
from .description_files import Description
from .scope import why_not_due
from .second_reader import Differences, differences

_MASS = 1e-12  # largest passing error of the mass matrix, relative to its largest entry
_FORCES = 1e-11  # largest passing error of forces, relative to the magnitudes of their terms
_PLACES = 1e-10  # largest passing error of positions, relative to the robot's reach
_SHORTER = 0.1  # factor on the duration of the motion after the verdict CANNOT TELL
_CHOICES = 5  # largest number of choices tried per file
_WEIGHTLESS = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class TrialOptions:
    """Options of trials.

    Attributes:
        duration: Duration of the motion [s].
    """

    duration: float = 0.5


def run_trial(description: Description, options: TrialOptions) -> Entry:
    """Try a description, and convert any exception to an outcome."""
    began = time.perf_counter()
    entry = Entry(file=description.file, kind=description.kind, outcome="passed")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            entry = _try_description(description, options, entry)
    except Exception as error:  # any other exception is a defect of pinred that the table must show
        entry = replace(
            entry, outcome="error", reason=f"{type(error).__name__}: {_line(error)}",
            about="exception that is not pinred's",
        )  # fmt: skip
    if description.kind != "name":
        why = why_not_due(description.file, description.kind)
        entry = replace(entry, due=not why, why_not=why)
    if description.included and entry.outcome == "refused" and not entry.due:
        entry = replace(entry, outcome="fragment")
    return replace(entry, wall=time.perf_counter() - began)


def _try_description(description: Description, options: TrialOptions, entry: Entry) -> Entry:
    began = time.perf_counter()
    try:
        system, choices = _load_with_choices(description.file, {})
    except PinredError as error:
        # Gravity may be the only obstacle, for example on massless rotors.
        try:
            system, choices = _load_with_choices(description.file, {"gravity": _WEIGHTLESS})
        except PinredError:
            return _refused(entry, error)
        entry = replace(entry, outcome="without gravity", reason=_line(error))
    entry = replace(
        entry, load=time.perf_counter() - began, group=system.group.name, joints=system.m,
        choice=", ".join(f"{k}={v}" for k, v in choices.items() if k != "gravity"),
    )  # fmt: skip
    entry = _compare_with_mujoco(description, system, choices.get("root"), entry)
    entry = _compare_readings(description, choices.get("root"), entry)
    began = time.perf_counter()
    try:
        try:
            report, wall = _compare_with_aba(system, options.duration)
        except SymmetryError:
            system = load(description.file, **{**choices, "gravity": _WEIGHTLESS})
            began = time.perf_counter()
            report, wall = _compare_with_aba(system, options.duration)
            entry = replace(entry, outcome=_worse(entry, "without gravity"))
    except IntegrationError as error:
        return replace(
            entry, outcome=_worse(entry, "stopped"), reason=entry.reason or _line(error),
            about=entry.about or "the motion cannot be integrated",
            simulate=time.perf_counter() - began,
        )  # fmt: skip
    except PinredError as error:
        return replace(
            _refused(entry, error), outcome="FAILED", simulate=time.perf_counter() - began
        )
    allowed = float(report.rotation_bounds[max(report.told - 1, 0)])
    relative = [
        value / bound * allowed if bound else value
        for name, (value, bound) in report.checks.items()
        if name.split()[0] in ("shape", "rotation", "position")
    ]
    entry = replace(
        entry, simulate=wall, duration=report.duration, aba=max(relative),
        allowed=allowed,
    )  # fmt: skip
    if report.verdict is Verdict.FAILED:
        failures = [
            f"{name} {value:.2g}, allowed {bound:.2g}"
            for name, (value, bound) in report.checks.items()
            if not value <= bound
        ]
        reason = "; ".join([*filter(None, [entry.reason]), *failures])
        entry = replace(entry, outcome="FAILED", reason=reason, about=entry.about or "ABA")
    return entry


def _worse(entry: Entry, outcome: Any) -> Any:
    """Return the outcome, unless a comparison with another reader has already failed."""
    return entry.outcome if entry.outcome == "FAILED" else outcome


def _load_with_choices(file: str, options: Mapping[str, Any]) -> tuple[System, dict[str, Any]]:
    """Load a file, trying choices if it is ambiguous; return the system and the load options."""
    try:
        return load(file, **options), dict(options)
    except ChoiceError as error:
        if error.option in options:
            raise
        first: PinredError = error
        for n, choice in enumerate(error.choices[:_CHOICES]):
            try:
                return _load_with_choices(file, {**options, error.option: choice})
            except ModelError as refusal:
                first = refusal if n == 0 else first
        raise first from None


def _compare_with_mujoco(
    description: Description, system: System, root: str | None, entry: Entry
) -> Entry:
    """Compare the system with MuJoCo's reading of the file; return the updated entry."""
    if description.kind in ("name", "sdf"):
        return replace(entry, second="a name" if description.kind == "name" else "an SDF file")
    try:
        mujoco_package()
        errors: Differences = differences(
            system,
            description.file,
            description.kind,
            root,
            weightless=entry.outcome == "without gravity",
        )
    except (LoadError, MissingPackageError) as error:
        return replace(entry, second=_line(error))
    entry = replace(entry, mass=errors.mass, forces=errors.forces)
    bounds = {"places": _PLACES, "mass": _MASS, "forces": _FORCES}
    failures = [
        f"{name} {getattr(errors, name):.2g}, allowed {bound:.2g}"
        for name, bound in bounds.items()
        if not getattr(errors, name) <= bound
    ]
    if failures:
        reason = f"MuJoCo reads it differently: {'; '.join(failures)}"
        return replace(entry, outcome="FAILED", reason=reason, about="MuJoCo reads it differently")
    return entry


def _compare_readings(description: Description, root: str | None, entry: Entry) -> Entry:
    """Compare with the reading of an independent reader; return the updated entry."""
    if description.kind == "name":
        return entry
    reading = second_reading(Path(description.file), root=root)
    if reading is None:
        return entry
    if reading.unread:
        return replace(entry, unread=reading.unread)
    entry = replace(entry, reader=reading.reader)
    if reading.differences:
        about = f"{reading.reader} reads it differently"
        own = f"{about}: {'; '.join(reading.differences)}"
        reason = f"{own}; {entry.reason}" if entry.outcome == "FAILED" else own
        return replace(entry, outcome="FAILED", reason=reason[:400], about=about)
    return entry


def _compare_with_aba(system: System, duration: float) -> tuple[Report, float]:
    """Compare a random motion with ABA.

    If the verdict is CANNOT TELL, a shorter motion is compared.

    Returns:
        The report, and the wall time of the simulation [s].
    """
    began = time.perf_counter()
    traj = simulate(system, duration=duration, seed=0)
    wall = time.perf_counter() - began
    report = compare(traj)
    if report.verdict is Verdict.CANNOT_TELL:
        report = compare(simulate(system, duration=_SHORTER * duration, seed=0))
    return report, wall


def _refused(entry: Entry, error: PinredError) -> Entry:
    return replace(entry, outcome="refused", reason=_line(error), about=about(error))


_CATEGORIES = (  # words in an error message, and the category that they indicate
    ("follows", "impossible coupling"),
    ("closes a loop", "closed loop"),
    ("closed loop", "closed loop"),
    ("a loop", "closed loop"),
    ("mass matrix is singular", "singular everywhere"),
    ("no mass", "singular everywhere"),
    ("No such file", "files missing"),
    ("Error opening file", "files missing"),
    ("resource not found", "files missing"),
    ("nothing to move", "nothing moves"),
)


def about(error: PinredError) -> str:
    """Return the category of an error, in a few words."""
    text = str(error)
    for words, category in _CATEGORIES:
        if words in text:
            return category
    return {"LoadError": "not read", "ModelError": "not reduced"}.get(
        type(error).__name__, type(error).__name__
    )


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:400]
