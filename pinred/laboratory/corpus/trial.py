"""One description tried: loaded, judged against MuJoCo, simulated, judged against ABA."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
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
from ...judge.report import Report, Verdict
from ...simulation.simulate import simulate
from ...system.load import load
from ...system.mjcf.package import mujoco_package
from ...system.system import System
from .corpus_entry import Entry
from .description_files import Description
from .scope import why_not_due
from .second_reader import Differences, differences

_MASS = 1e-12  # of the mass matrix's largest entry
_FORCES = 1e-11  # of what they are sums of
_PLACES = 1e-10  # of the robot's reach
_SHORTER = 0.1  # of a motion whose growth says that its end cannot be judged
_CHOICES = 5  # that are tried
_WEIGHTLESS = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Wanted:
    """How descriptions are tried.  duration: of the motion [s]."""

    duration: float = 0.5


def tried(what: Description, wanted: Wanted) -> Entry:
    """Return what comes of a description, whatever is raised."""
    began = time.perf_counter()
    entry = Entry(file=what.file, kind=what.kind, outcome="passed")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            entry = _tried(what, wanted, entry)
    except Exception as error:  # a defect: it is what the table is for
        entry = replace(
            entry, outcome="error", reason=f"{type(error).__name__}: {_line(error)}",
            about="exception that is not pinred's",
        )  # fmt: skip
    if what.kind != "name":
        why = why_not_due(what.file, what.kind)
        entry = replace(entry, due=not why, why_not=why)
    if what.included and entry.outcome == "refused" and not entry.due:
        entry = replace(entry, outcome="fragment")
    return replace(entry, wall=time.perf_counter() - began)


def _tried(what: Description, wanted: Wanted, entry: Entry) -> Entry:
    began = time.perf_counter()
    try:
        system, options = _loaded(what.file, {})
    except PinredError as error:
        # Gravity may be all that is against it, as on rotors without weight.
        try:
            system, options = _loaded(what.file, {"gravity": _WEIGHTLESS})
        except PinredError:
            return _refused(entry, error)
        entry = replace(entry, outcome="without gravity", reason=_line(error))
    entry = replace(
        entry, load=time.perf_counter() - began, group=system.group.name, joints=system.m,
        choice=", ".join(f"{k}={v}" for k, v in options.items() if k != "gravity"),
    )  # fmt: skip
    entry = _read_twice(what, system, options.get("root"), entry)
    began = time.perf_counter()
    try:
        try:
            report, spent = _judged(system, wanted.duration)
        except SymmetryError:
            system = load(what.file, **{**options, "gravity": _WEIGHTLESS})
            began = time.perf_counter()
            report, spent = _judged(system, wanted.duration)
            entry = replace(entry, outcome=_worse(entry, "without gravity"))
    except IntegrationError as error:
        return replace(
            entry, outcome=_worse(entry, "stopped"), reason=entry.reason or _line(error),
            about=entry.about or "the motion cannot be followed",
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
        entry, simulate=spent, duration=report.duration, aba=max(relative),
        allowed=allowed,
    )  # fmt: skip
    if report.verdict is Verdict.FAILED:
        wrong = [
            f"{name} {value:.2g}, allowed {bound:.2g}"
            for name, (value, bound) in report.checks.items()
            if not value <= bound
        ]
        reason = "; ".join([*filter(None, [entry.reason]), *wrong])
        entry = replace(entry, outcome="FAILED", reason=reason, about=entry.about or "ABA")
    return entry


def _worse(entry: Entry, outcome: Any) -> Any:
    """Return the outcome, unless MuJoCo has already found a difference."""
    return entry.outcome if entry.outcome == "FAILED" else outcome


def _loaded(file: str, options: Mapping[str, Any]) -> tuple[System, dict[str, Any]]:
    """Return the system of a file and the options that it took, where it leaves a choice.

    options: of load, to begin with.
    """
    try:
        return load(file, **options), dict(options)
    except ChoiceError as error:
        if error.option in options:
            raise
        first: PinredError = error
        for n, choice in enumerate(error.choices[:_CHOICES]):
            try:
                return _loaded(file, {**options, error.option: choice})
            except ModelError as refusal:
                first = refusal if n == 0 else first
        raise first from None


def _read_twice(what: Description, system: System, root: str | None, entry: Entry) -> Entry:
    """Return the entry with what MuJoCo says of the same file."""
    if what.kind == "name":
        return replace(entry, second="a name")
    try:
        mujoco_package()
        found: Differences = differences(
            system, what.file, what.kind, root, weightless=entry.outcome == "without gravity"
        )
    except (LoadError, MissingPackageError) as error:
        return replace(entry, second=_line(error))
    entry = replace(entry, mass=found.mass, forces=found.forces)
    bounds = {"places": _PLACES, "mass": _MASS, "forces": _FORCES}
    wrong = [
        f"{name} {getattr(found, name):.2g}, allowed {bound:.2g}"
        for name, bound in bounds.items()
        if not getattr(found, name) <= bound
    ]
    if wrong:
        reason = f"MuJoCo reads it otherwise: {'; '.join(wrong)}"
        return replace(entry, outcome="FAILED", reason=reason, about="MuJoCo reads it otherwise")
    return entry


def _judged(system: System, duration: float) -> tuple[Report, float]:
    """Return the comparison of a random motion with ABA, and the seconds of the simulation.

    Where its perturbations grow too much for the end to be judged, a shorter motion is.
    """
    began = time.perf_counter()
    traj = simulate(system, duration=duration, seed=0)
    spent = time.perf_counter() - began
    report = compare(traj)
    if report.verdict is Verdict.CANNOT_TELL:
        report = compare(simulate(system, duration=_SHORTER * duration, seed=0))
    return report, spent


def _refused(entry: Entry, error: PinredError) -> Entry:
    return replace(entry, outcome="refused", reason=_line(error), about=about(error))


_KINDS = (  # words in a refusal, and its kind
    ("follows", "coupling that cannot be"),
    ("closes a loop", "closed loop"),
    ("closed loop", "closed loop"),
    ("a loop", "closed loop"),
    ("ball joint", "ball joint inside"),
    ("mass matrix is singular", "singular everywhere"),
    ("no mass", "singular everywhere"),
    ("No such file", "files missing"),
    ("Error opening file", "files missing"),
    ("resource not found", "files missing"),
    ("nothing to move", "nothing moves"),
)


def about(error: PinredError) -> str:
    """Return the kind of a refusal, in few words."""
    text = str(error)
    for words, kind in _KINDS:
        if words in text:
            return kind
    return {"LoadError": "not read", "ModelError": "not reduced"}.get(
        type(error).__name__, type(error).__name__
    )


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:400]
