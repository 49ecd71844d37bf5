"""Trial of one description: load, compare with other readers, simulate, compare with ABA.

Which descriptions should work is decided without pinred's readers.

A URDF should work if Pinocchio or MuJoCo opens it, if it is one open tree, and if its mass matrix
is positive definite at zero and at some random shapes. An MJCF file should work if MuJoCo compiles
it and if it contains an open tree of joints. An SDF file should work if Drake opens it and if
something moves.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ...common.errors import (
    ChoiceError,
    IntegrationError,
    LoadError,
    MissingPackageError,
    ModelError,
    PinredError,
    SymmetryError,
)
from ...common.installation import optional_package
from ...judge.compare import compare
from ...judge.verdict import Report, Verdict
from ...simulation.simulate import simulate
from ...system.independent_reader import second_reading
from ...system.load import load
from ...system.mjcf.compile import mujoco_package, warnings_kept
from ...system.read_sdf import drake_warnings
from ...system.robot_files import EVERYTHING, library_output, read_xml
from ...system.system import System
from .corpus_entry import Description, Entry
from .second_reader import Differences, differences

_SHAPES = 4
_REGULAR = 1e-13  # least eigenvalue of a regular mass matrix, scaled to a unit diagonal


def why_not_due(file: str, kind: str) -> str:
    """Return a short reason why a description is not required to work, or ""."""
    reason = _urdf(Path(file)) if kind == "urdf" else _sdf(file) if kind == "sdf" else _mjcf(file)
    return " ".join(reason.split())[:200]


def _urdf(path: Path) -> str:
    try:
        tree = read_xml(path)
    except LoadError as error:
        return str(error)
    links = [link.get("name") for link in tree.findall("link")]
    children = [child.get("link") for child in tree.findall("joint/child")]
    if len(set(children)) < len(children):
        return "closed loop"
    if len(links) - len(children) != 1:
        return "not one tree"
    with library_output(EVERYTHING) as output:
        fixed = _build(path, None)
        floating = _build(path, pin.JointModelFreeFlyer())
    if fixed is None or floating is None:
        return _by_mujoco(path, output[0].splitlines()[0] if output else "")
    has_fixed_base = fixed.inertias[0].mass == 0.0 and list(fixed.parents[1:]).count(0) == 1
    if not _is_regular(fixed if has_fixed_base else floating):
        return "mass matrix singular"
    return ""


def _by_mujoco(path: Path, message: str) -> str:
    """Return why a URDF that Pinocchio rejects is not required to work; "" if MuJoCo opens it.

    message: Pinocchio's error message.
    """
    try:
        mj = mujoco_package()
        with library_output(EVERYTHING), warnings_kept():
            spec = mj.MjSpec.from_file(str(path))
            for element in (*spec.geoms, *spec.meshes):
                spec.delete(element)
            spec.compile()
    except Exception:  # parsers raise various types, and MuJoCo may not be installed
        return f"Pinocchio does not open it: {message}"
    return ""


def _build(path: Path, root: pin.JointModel | None) -> pin.Model | None:
    try:
        if root is None:
            return pin.buildModelFromUrdf(str(path))
        return pin.buildModelFromUrdf(str(path), root)
    except Exception:  # parsers raise exceptions of various types
        return None


def _is_regular(model: pin.Model) -> bool:
    """Return whether the mass matrix is positive definite at zero and some random shapes."""
    data = model.createData()
    if model.nv == 0:
        return False
    model.lowerPositionLimit = np.full(model.nq, -1.0)
    model.upperPositionLimit = np.full(model.nq, 1.0)
    pin.seed(0)
    eigenvalues = []
    shapes = [pin.neutral(model), *(pin.randomConfiguration(model) for _ in range(_SHAPES))]
    for q in shapes:
        upper = np.triu(pin.crba(model, data, q))
        H = upper + np.triu(upper, 1).T
        sizes = np.sqrt(np.abs(np.diag(H)))
        if not (np.isfinite(H).all() and sizes.all()):
            return False
        eigenvalues.append(np.linalg.eigvalsh(H / np.outer(sizes, sizes))[0])
    return bool(min(eigenvalues) > _REGULAR)


def _mjcf(file: str) -> str:
    try:
        mj = mujoco_package()
    except ImportError:
        return "no mujoco"
    with library_output(EVERYTHING), warnings_kept():
        try:
            model = mj.MjModel.from_xml_path(file)
        except Exception as error:  # parsers raise exceptions of various types
            return f"MuJoCo does not compile it: {str(error).splitlines()[0]}"
    tops = _tops(model)
    if not tops:
        return "nothing moves"
    reasons = [_why_closed(mj, model, joints) for joints in tops]
    return "" if "" in reasons else reasons[0]


def _sdf(file: str) -> str:
    try:
        plants = optional_package("pydrake.multibody.plant", "the corpus needs Drake")
        parsing = optional_package("pydrake.multibody.parsing", "the corpus needs Drake")
    except MissingPackageError:
        return "no drake"
    plant = plants.MultibodyPlant(0.0)
    with library_output(EVERYTHING), drake_warnings():
        try:
            parsing.Parser(plant).AddModels(file)
            plant.Finalize()
        except Exception as error:  # Drake raises RuntimeError and other types.
            return f"Drake does not open it: {str(error).strip().splitlines()[0]}"
    return "" if plant.num_velocities() else "nothing moves"


def _tops(model: Any) -> list[list[int]]:
    """Return the joints of the subtree of each moving child of the world."""
    roots = model.body_rootid[model.jnt_bodyid]
    return [np.flatnonzero(roots == top).tolist() for top in np.unique(roots)]


def _why_closed(mj: Any, model: Any, joints: list[int]) -> str:
    """Return why joints do not form an open tree; "" if they do."""
    top = _root_of(model, int(model.jnt_bodyid[joints[0]]))
    if int(model.opt.disableflags) & int(mj.mjtDisableBit.mjDSBL_EQUALITY):
        return ""
    welds = {int(mj.mjtEq.mjEQ_CONNECT), int(mj.mjtEq.mjEQ_WELD)}
    for k in np.flatnonzero(model.eq_active0).tolist():
        if int(model.eq_type[k]) in welds and _welded_roots(mj, model, k) - {0} == {top}:
            return "closed loop"
    return ""


def _welded_roots(mj: Any, model: Any, k: int) -> set[int]:
    """Return the root bodies that a connect or weld constraint joins; 0 is the ground."""
    ends = [int(model.eq_obj1id[k]), int(model.eq_obj2id[k])]
    if int(model.eq_objtype[k]) == int(mj.mjtObj.mjOBJ_SITE):
        ends = [int(model.site_bodyid[end]) for end in ends]
    if any(model.body_mocapid[end] >= 0 for end in ends):
        return set()
    is_fixed = [int(model.body_weldid[end]) == 0 for end in ends]
    return {0 if fixed else _root_of(model, end) for fixed, end in zip(is_fixed, ends, strict=True)}


def _root_of(model: Any, body: int) -> int:
    """Return the child of the world whose subtree contains a body."""
    return int(model.body_rootid[body])


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
