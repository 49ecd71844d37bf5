"""Trial of one description: load, compare with other readers, simulate, compare with ABA.

Which descriptions should work is decided without pinred's readers.

A URDF should work if Pinocchio or MuJoCo opens it, if it is one open tree, and if its mass matrix
is positive definite at zero and at some random shapes. An MJCF file should work if MuJoCo compiles
it and if it contains an open tree of joints. An SDF file should work if Drake opens it and if
something moves.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...common.errors import (
    ChoiceError,
    IntegrationError,
    LoadError,
    MissingPackageError,
    ModelError,
    PinredError,
    SymmetryError,
    optional_package,
)
from ...judge.compare import compare
from ...judge.verdict import Report, Verdict
from ...reduction.pointwise_reduction import symmetric
from ...simulation.simulate import simulate
from ...system.find_robot_files import EVERYTHING, library_output, read_text, read_xml
from ...system.independent_reader import second_reading
from ...system.load import load
from ...system.mjcf.compile import compiled, mujoco_package, warnings_kept
from ...system.mjcf.read import gravity_of
from ...system.mjcf.world import robot_in
from ...system.read_sdf import drake_warnings
from ...system.system import System

Kind: TypeAlias = Literal["urdf", "mjcf", "sdf", "name"]
Outcome: TypeAlias = Literal[
    "passed", "without gravity", "refused", "stopped", "FAILED", "error", "fragment"
]
GOOD: tuple[Outcome, ...] = ("passed", "without gravity")


@dataclass(frozen=True)
class Description:
    """A robot description: a file, or the name of a robot.

    included: whether another file in the folders includes this file.
    """

    file: str
    kind: Kind
    included: bool = False


@dataclass(frozen=True)
class Entry:
    """The outcome of one description.

    Attributes:
        file: Path of the file, or name of the robot.
        kind: "urdf", "mjcf", "sdf" or "name".
        outcome: "passed"; "without gravity" (gravity breaks the symmetry of its root);
            "refused" (an error of pinred); "stopped" (the simulation or the time limit);
            "FAILED" (differs from ABA, MuJoCo or the independent reader); "error" (other exception,
            or a crash);
            "fragment" (only part of other files).
        reason: Reason of the outcome in one line.
        about: Category of the reason, for the summary.
        due: Whether the description should work, see `trial`.
        why_not: Reason why the description is not required to work.
        choice: Option that resolved an ambiguity of the description, such as "root=arm".
        group: Symmetry group of the system.
        joints: Number of joints m.
        duration: Duration of the motion [s].
        aba: Largest error against ABA, relative to the motion's size.
        allowed: Largest `aba` that passes.
        mass: Largest relative error of the mass matrix against MuJoCo's reading; NaN if none.
        forces: Largest relative error of the forces against MuJoCo's reading; NaN if none.
        second: Reason why there is no comparison with MuJoCo's reading.
        reader: Independent reader of the format whose reading was compared; "" if there is none
            or if it does not open the file.
        unread: Reason why that reader does not open the file.
        load: Time for loading [s].
        simulate: Time for the first simulation [s].
        wall: Total time [s].
    """

    file: str
    kind: Kind
    outcome: Outcome
    reason: str = ""
    about: str = ""
    due: bool = True
    why_not: str = ""
    choice: str = ""
    group: str = ""
    joints: int = -1
    duration: float = math.nan
    aba: float = math.nan
    allowed: float = math.nan
    mass: float = math.nan
    forces: float = math.nan
    second: str = ""
    reader: str = ""
    unread: str = ""
    load: float = math.nan
    simulate: float = math.nan
    wall: float = math.nan

    @property
    def good(self) -> bool:
        """Whether the description was loaded and simulated, and agrees with ABA and MuJoCo."""
        return self.outcome in GOOD


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


_BOUNDS = {"places": 1e-10, "mass": 1e-12, "forces": 1e-11}  # of passing `differences`
_SHORTER = 0.1  # factor on the duration of the motion after the verdict CANNOT TELL
_CHOICES = 5  # largest number of choices tried per file
_WEIGHTLESS = (0.0, 0.0, 0.0)


def run_trial(description: Description, duration: float) -> Entry:
    """Try a description, and convert any exception to an outcome.

    Args:
        description: The description.
        duration: Duration of the motion [s].
    Returns:
        The outcome.
    """
    began = time.perf_counter()
    entry = Entry(file=description.file, kind=description.kind, outcome="passed")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            entry = _try_description(description, duration, entry)
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


def _try_description(description: Description, duration: float, entry: Entry) -> Entry:
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
            report, wall = _compare_with_aba(system, duration)
        except SymmetryError:
            system = load(description.file, **{**choices, "gravity": _WEIGHTLESS})
            began = time.perf_counter()
            report, wall = _compare_with_aba(system, duration)
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
        reason = "; ".join([*filter(None, [entry.reason]), *_beyond(report.checks)])
        entry = replace(entry, outcome="FAILED", reason=reason, about=entry.about or "ABA")
    return entry


def _beyond(checks: Mapping[str, tuple[float, float]]) -> list[str]:
    """Return a text for each error that is not within its bound."""
    return [
        f"{name} {error:.2g}, allowed {bound:.2g}"
        for name, (error, bound) in checks.items()
        if not error <= bound
    ]


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
        errors = differences(
            system,
            description.file,
            description.kind,
            root,
            weightless=entry.outcome == "without gravity",
        )
    except (LoadError, MissingPackageError) as error:
        return replace(entry, second=_line(error))
    entry = replace(entry, mass=errors["mass"], forces=errors["forces"])
    failures = _beyond({name: (error, _BOUNDS[name]) for name, error in errors.items()})
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
        differing = f"{about}: {'; '.join(reading.differences)}"
        reason = f"{differing}; {entry.reason}" if entry.outcome == "FAILED" else differing
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


STATES = 3
# Springs and dampers stay enabled, because MuJoCo disables gravity compensation with them.
_OFF = ("CONSTRAINT", "EQUALITY", "FRICTIONLOSS", "LIMIT", "CONTACT", "ACTUATION")
_NEWTON = 60  # largest number of Newton iterations for the pose
_CANCELS = 1e-3  # fraction of cancelling moments that is added to the scale of force errors
_ROUND_OFF = 1e-12  # relative position step below which Newton's method has converged


def differences(
    system: System, file: str, kind: str, root: str | None, *, weightless: bool = False
) -> dict[str, float]:
    """Compare a system with MuJoCo's reading of its file.

    Args:
        system: The system that pinred loaded.
        file: The file.
        kind: "urdf" or "mjcf".
        root: The chosen root body, if there was a choice.
        weightless: Whether the system was loaded without the file's gravity.
    Returns:
        The largest relative differences over some random states. "places": of body positions,
        relative to the robot's reach; "mass": of the mass matrix, relative to its largest entry;
        "forces": of bias forces and of forces at random accelerations, relative to the magnitudes
        of the terms in their sums.
    Raises:
        LoadError: MuJoCo does not read the file, or bodies cannot be matched.
        PinredError: pinred rejects a part of the file.
    """
    with library_output(EVERYTHING), warnings_kept():
        try:
            model = _read(system, file, kind, root)
        except PinredError:
            raise
        except Exception as error:  # MuJoCo raises ValueError, RuntimeError and its own types
            words = str(error).strip().splitlines() or [type(error).__name__]
            raise LoadError(f"MuJoCo: {words[0].removeprefix('Error: ')}") from None
        if weightless:
            model.opt.gravity[:] = 0.0
        for joint in np.flatnonzero(model.jnt_type == int(mujoco_package().mjtJoint.mjJNT_FREE)):
            first = model.jnt_dofadr[joint]
            model.dof_armature[first : first + 6] = 0.0  # pinred ignores it with a warning
        pair = _Pair(system, model, root)
        if kind == "urdf":
            pair.take_armature()
        rng = np.random.default_rng(0)
        samples = [pair.at_random(rng) for _ in range(STATES)]
    return {name: max(sample[name] for sample in samples) for name in _BOUNDS}


def _body(spec: Any, name: str) -> Any:
    """Return a body of an MjSpec; a body without a name is called by its number."""
    return spec.body(name) or next(b for k, b in enumerate(spec.bodies) if f"body{k}" == name)


def _read(system: System, file: str, kind: str, root: str | None) -> Any:
    """Read a file with MuJoCo; add a free joint to the base if it floats in pinred."""
    mj = mujoco_package()
    spec = mj.MjSpec.from_file(file)
    spec.compiler.fusestatic = False
    if kind == "urdf":
        if "quat_xyzw" in read_text(Path(file)):
            raise LoadError("MuJoCo does not read the attribute quat_xyzw")
        spec.compiler.inertiafromgeom = int(mj.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE)
        for element in (*spec.geoms, *spec.meshes):
            spec.delete(element)
    # MuJoCo splits a root joint with several degrees of freedom into joints with longer names.
    joints = [joint.name for joint in spec.joints]
    free = kind == "urdf" and not any(
        name.startswith(root_joint) for name in joints for root_joint in system.root_name.split("+")
    )
    if free and system.model.existBodyName("world"):
        raise LoadError("MuJoCo takes the link 'world' for the fixed world and ignores its mass")
    if free or system.contents.freed:
        tops = [_body(spec, root)] if root else _top_bodies(spec, system)
        if len(tops) != 1:
            raise LoadError("several bodies of MuJoCo's world could be the floating base")
        tops[0].add_freejoint()
    try:
        return spec.compile()
    except Exception:
        if kind == "urdf":
            raise
        return compiled(spec)  # compile without missing meshes that define no mass


def _top_bodies(spec: Any, system: System) -> list[Any]:
    """Return the children of MuJoCo's world that are in a system's model."""
    tops, body = [], spec.worldbody.first_body()
    while body is not None:
        if not body.name or system.model.existBodyName(body.name):
            tops.append(body)
        body = spec.worldbody.next_body(body)
    return tops


class _Pair:
    """A system and MuJoCo's model of the same file."""

    def __init__(self, system: System, model: Any, root: str | None) -> None:
        """Match bodies and joints by name; raise LoadError if one is missing."""
        self._mj = mj = mujoco_package()
        self._system, self._model = system, model
        for word in _OFF:
            model.opt.disableflags |= int(getattr(mj.mjtDisableBit, f"mjDSBL_{word}"))
        model.opt.enableflags = 0
        self._data, self._pin = mj.MjData(model), system.model.createData()
        world = robot_in(model, root)
        self._felt = gravity_of(world)
        ids = {world.joint_names[j]: j for body in world.bodies for j in world.joints(body)}
        # Followers move independently in both models here, so all joints are matched.
        names = [str(name) for name in system.model.names[2:]]
        if missing := [name for name in names if name not in ids]:
            raise LoadError(f"MuJoCo has no joint '{missing[0]}'")
        self._shape = [ids[name] for name in names]
        self._shape_v = _dofs(model, self._shape)
        locked = system.contents.locked
        self._held = _held(
            mj, model, {} if locked is None else {ids[k]: v for k, v in locked.frozen.items()}
        )
        self._dofs = _dofs(model, [j for j in world.all_joints if j not in self._held])
        frames = system.model.frames
        self._bodies = [
            (system.model.getFrameId(world.body_names[body], pin.FrameType.BODY), body)
            for body in world.bodies
            if system.model.existBodyName(world.body_names[body])
        ]
        moving = [pair for pair in self._bodies if frames[pair[0]].parentJoint > 0]
        if not moving:
            raise LoadError("MuJoCo has no body of the same name")
        # The position of the body nearest to the root has the smallest round-off.
        self._ref = min(moving, key=lambda pair: frames[pair[0]].parentJoint)

    def take_armature(self) -> None:
        """Give MuJoCo's joints the armature of pinred's, which MuJoCo does not read from URDF."""
        model = self._system.model
        for joint, number in zip(list(model.joints)[2:], self._shape, strict=True):
            armature = model.armature[joint.idx_v : joint.idx_v + joint.nv]
            self._model.dof_armature[_dofs(self._model, [number])] = armature

    def at_random(self, rng: np.random.Generator) -> dict[str, float]:
        """Compute the differences at a random state."""
        mj, m, d = self._mj, self._model, self._data
        model, data = self._system.model, self._pin
        d.qpos[:] = m.qpos0 + rng.uniform(-1.0, 1.0, m.nq)
        d.qvel[:] = rng.normal(size=m.nv)
        for joint, value in self._held.items():
            d.qpos[m.jnt_qposadr[joint]], d.qvel[m.jnt_dofadr[joint]] = value, 0.0
        mj.mj_normalizeQuat(m, d.qpos)
        mj.mj_forward(m, d)
        rates = d.qvel[self._dofs]
        q = self._configuration([self._coordinates(joint) for joint in self._shape])
        T, drift = self._velocities(q)
        M = np.zeros((m.nv, m.nv))
        mj.mj_fullM(m, d, M)
        M = M[np.ix_(self._dofs, self._dofs)]
        H = symmetric(pin.crba(model, data, q))
        a, v = rng.normal(size=len(rates)), T @ rates
        compensation = 0.0 if self._felt.is_uneven else d.qfrc_gravcomp
        bias = (d.qfrc_bias - compensation)[self._dofs]
        own_bias = T.T @ pin.rnea(model, data, q, v, drift)
        total = T.T @ pin.rnea(model, data, q, v, T @ a + drift)
        scale = self._force_terms(T, q, v, T @ a + drift)
        errors = np.append((own_bias - bias) / scale, (total - M @ a - bias) / scale)
        pin.framesForwardKinematics(model, data, q)
        reach = max(np.linalg.norm(data.oMf[f].translation) for f, _ in self._bodies)
        place_errors = [
            max(
                np.abs(data.oMf[f].rotation - d.xmat[body].reshape(3, 3)).max(),
                np.abs(data.oMf[f].translation - d.xpos[body]).max() / max(reach, 1e-3),
            )
            for f, body in self._bodies
        ]
        return {
            "places": float(np.max(place_errors)),
            "mass": float(np.abs(T.T @ H @ T - M).max() / np.abs(M).max()),
            "forces": float(np.abs(errors).max()),
        }

    def _coordinates(self, joint: int) -> Array:
        """Return the quaternion (x, y, z, w) of a ball, or the value of another joint."""
        first = int(self._model.jnt_qposadr[joint])
        if self._model.jnt_type[joint] == int(self._mj.mjtJoint.mjJNT_BALL):
            return np.roll(self._data.qpos[first : first + 4], -1)
        return np.array(self._data.qpos[first : first + 1])

    def _configuration(self, x: Sequence[Array]) -> Array:
        """Solve by Newton's method for the q that places the reference body as in MuJoCo."""
        system, model, data = self._system, self._system.model, self._pin
        group, (frame, body) = system.group, self._ref
        d = self._data
        target = pin.SE3(d.xmat[body].reshape(3, 3), d.xpos[body].copy())
        pose = group.identity()
        for _ in range(_NEWTON):
            q = self._place(pose, x)
            J = self._jacobian(q)[:, : system.r]
            pin.framesForwardKinematics(model, data, q)
            error = pin.log6(data.oMf[frame].actInv(target)).vector
            step = np.linalg.lstsq(J, error)[0]
            pose = group.compose(pose, group.exp(step))
            if np.linalg.norm(J @ step) < _ROUND_OFF * (1.0 + np.linalg.norm(target.translation)):
                break
        return self._place(pose, x)

    def _place(self, pose: Array, x: Sequence[Array]) -> Array:
        """Return Pinocchio's q for a pose and the coordinates of all joints."""
        system, model = self._system, self._system.model
        q = system.q(pose, system.space.neutral)
        for joint, value in zip(list(model.joints)[2:], x, strict=True):
            entry = [np.cos(value[0]), np.sin(value[0])] if joint.nq == 2 else value
            q[joint.idx_q : joint.idx_q + joint.nq] = entry
        return q

    def _velocities(self, q: Array) -> tuple[Array, Array]:
        """Return T = ∂v/∂qvel from MuJoCo's to Pinocchio's velocities, and v̇ − T q̈vel."""
        mj, m, d, model, data = self._mj, self._model, self._data, self._system.model, self._pin
        frame, body = self._ref
        r, n = self._system.r, model.nv
        jac, dot = np.zeros((6, m.nv)), np.zeros((6, m.nv))
        mj.mj_jacBody(m, d, jac[:3], jac[3:], body)
        mj.mj_jacDot(m, d, dot[:3], dot[3:], d.xpos[body], body)
        to_body = np.kron(np.eye(2), d.xmat[body].reshape(3, 3).T)
        P = np.zeros((n - r, len(self._dofs)))
        for row, dof in enumerate(self._shape_v):
            P[row, list(self._dofs).index(dof)] = 1.0
        J = self._jacobian(q)
        root = np.linalg.lstsq(J[:, :r], (to_body @ jac)[:, self._dofs] - J[:, r:] @ P)[0]
        T = np.vstack([root, P])
        pin.forwardKinematics(model, data, q, T @ d.qvel[self._dofs], np.zeros(n))
        classical = pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL).vector
        rate = np.linalg.lstsq(J[:, :r], to_body @ dot @ d.qvel - classical)[0]
        return T, np.append(rate, np.zeros(n - r))

    def _jacobian(self, q: Array) -> Array:
        """Return the Jacobian of the reference body in its own frame, (6, n)."""
        J = pin.computeFrameJacobian(self._system.model, self._pin, q, self._ref[0])
        # Pinocchio returns a matrix with a single column as a one-dimensional array.
        return np.asarray(J).reshape(6, self._system.model.nv)

    def _force_terms(self, T: Array, q: Array, v: Array, a: Array) -> Array:
        """Return the sum of magnitudes of the terms in each coordinate's force, (n,).

        The terms of a body are its mass times the terms of its acceleration, and its moments of
        inertia times angular acceleration and squared rate, projected on all axes that move it.
        MuJoCo sums moments about the robot's centre of mass, where the moments of a distant small
        heavy wheel cancel. Therefore a fraction of these moments is added.
        """
        model, data = self._system.model, self._pin
        terms, com = np.zeros(model.nv), pin.centerOfMass(model, data, q).copy()
        pin.forwardKinematics(model, data, q, v, a)
        g = np.linalg.norm(model.gravity.linear)
        for i in range(1, model.njoints):
            body, w = model.inertias[i], np.linalg.norm(data.v[i].angular)
            angular = np.linalg.norm(data.a[i].angular) + w**2
            lever = np.linalg.norm(body.lever)
            linear = np.linalg.norm(data.a[i].linear) + w * np.linalg.norm(data.v[i].linear)
            force = body.mass * (linear + g + lever * angular)
            far = np.linalg.norm(data.oMi[i].act(body.lever) - com)
            moment = np.linalg.norm(body.inertia) * angular + lever * force
            moment += _CANCELS * far * (force + body.mass * far * angular)
            S = np.abs(pin.computeJointJacobian(model, data, q, i)).reshape(6, model.nv)
            terms += S[:3].sum(axis=0) * force + S[3:].sum(axis=0) * moment
        terms += model.armature * np.abs(a)
        return np.asarray(np.abs(T).T @ terms + 1e-300)


def _held(mj: Any, model: Any, frozen: Mapping[int, float]) -> dict[int, float]:
    """Return the values of the joints that equality constraints hold, by number.

    Args:
        mj: The module mujoco.
        model: MuJoCo's model.
        frozen: Values by pinred.  MuJoCo's own numbers replace them, except for tendons.
    """
    held = dict(frozen)
    for k in np.flatnonzero(model.eq_active0).tolist():
        joint = int(model.eq_obj1id[k])
        is_joint = model.eq_type[k] == int(mj.mjtEq.mjEQ_JOINT)
        if is_joint and joint in held and model.eq_obj2id[k] < 0:
            held[joint] = float(model.qpos0[model.jnt_qposadr[joint]] + model.eq_data[k, 0])
    return held


def _dofs(model: Any, joints: Iterable[int]) -> Array:
    """Return the indices of the degrees of freedom of joints in MuJoCo."""
    sizes = (6, 3, 1, 1)  # degrees of freedom by mjtJoint
    dofs = [int(model.jnt_dofadr[j]) + k for j in joints for k in range(sizes[model.jnt_type[j]])]
    return np.array(dofs, dtype=int)
