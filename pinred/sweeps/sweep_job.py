"""SweepJob: the inputs of the blocks of a sweep, the computation of a block, and its store.

A store keeps the plan that identifies the sweep, and the signed scene.  The plan describes the
sweep in parts, each of which identifies what it describes.  With the scene, single points can be
simulated again.  A scene is a pickle, which could execute anything.  Therefore its file has the
user's signature, and only files with the own signature are read; see common/files.py.
"""

from __future__ import annotations

import hmac
import json
import pickle
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import astuple, dataclass, replace
from functools import cached_property
from hashlib import sha256
from io import BytesIO
from math import ceil
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.arrays import Array, whole
from ..common.errors import InputError, LoopWarning, ShapeError, __version__
from ..common.files import TEMPORARY, fingerprint, read_plain_file, signing_key, write_atomic
from ..common.machine_code import cpu_target
from ..common.names import brief, quoted
from ..kernels.build import model_bytes
from ..scene.scene import Scene
from ..simulation.members.member_options import MemberOptions, separate_all_rejected
from ..simulation.members.trajectories import Trajectories
from ..simulation.plan import members_plan
from ..simulation.simulate_many import run_members, simulate_many
from ..simulation.trajectory import Trajectory
from ..system.state_fields import axis_lengths
from .distributions import PointSequence
from .sweep_outputs import Output
from .varied_numbers import VariedScene

# Status of a point in the store.
MISSING, DONE, FAILED, REJECTED = 0, 1, 2, 3
# Size of the states of members that are computed together [bytes].
_MOST_BYTES, _MOST_BYTES_OF_DEVICES = 2**25, 2**30


@dataclass(frozen=True)
class Block:
    """The results of consecutive points.

    Attributes:
        index: Index of the block.
        values: Values of the varied numbers, (n, number of them).
        outputs: Outputs by name, (n, …); a function is missing if all points are rejected.
        status: Status of each point, (n,).
        reasons: Reason of each point that failed or was rejected, {index of the point: text}.
        cpu: CPU for which the machine code was compiled, or the kind of device.
    """

    index: int
    values: Array
    outputs: dict[str, Array]
    status: NDArray[np.uint8]
    reasons: dict[int, str]
    cpu: str


@dataclass(frozen=True, eq=False)
class SweepJob:
    """A sweep without its store; it can be pickled.

    Attributes:
        varied: The scene and the numbers that vary.
        sequence: The values of these numbers at all points.
        outputs: The outputs.
        block: Number of points of a block.
    """

    varied: VariedScene
    sequence: PointSequence
    outputs: tuple[Output, ...]
    block: int

    @property
    def points(self) -> int:
        """Number of points."""
        return self.sequence.points

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return ceil(self.points / self.block)

    def span(self, index: int) -> tuple[int, int]:
        """Return the first point of a block, and the index after its last point."""
        return index * self.block, min((index + 1) * self.block, self.points)

    def values(self, first: int, last: int) -> Array:
        """Return the values of the varied numbers at points first … last − 1."""
        return self.sequence.values(first, last)

    def trajectory(self, point: int) -> Trajectory:
        """Simulate one point at the report times of the scene.

        Args:
            point: Index of the point.
        Returns:
            Its trajectory.
        Raises:
            InputError: There is no such point, or its values are rejected.
        """
        point = whole(point, "point", 0, self.points - 1)
        members, seeds = self.varied.member_values(self.values(point, point + 1))
        many = simulate_many(self.varied.scene, members=members, seeds=seeds, invalid="raise")
        return many[0]

    @cached_property
    def _varied_scene(self) -> VariedScene:
        """The scene with as few report times as the outputs need."""
        if any(output.over_time for output in self.outputs):
            return self.varied
        scene = self.varied.scene
        short = VariedScene(scene, [])
        short.scene = replace(scene, duration=scene.end, times=scene.report_times[-1:])
        short.numbers = self.varied.numbers
        return short

    @cached_property
    def _template(self) -> Scene:
        """The scene of all points, prepared once."""
        varied = self._varied_scene
        members, seeds = varied.member_values(varied.nominal_values()[None])
        return MemberOptions(varied.scene, {}, members, seeds).template()

    def _members_of(self, size: int) -> int:
        """Return the number of points whose states have a size [bytes]."""
        scene = self._varied_scene.scene
        numbers = 3 * sum(axis_lengths(scene.system).values()) * len(scene.report_times)
        return max(1, size // (8 * numbers))

    def compute(
        self,
        index: int,
        threads: int | None,
        device: str | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> Block:
        """Compute a block.

        Args:
            index: Index of the block.
            threads: Number of threads; as many as processors if None.
            device: "cuda" for CUDA devices, None for the CPU.
            progress: Called with the completed fraction of the block.
        Returns:
            The results.
        """
        first, last = self.span(index)
        values = self.values(first, last)
        status = np.full(last - first, DONE, dtype=np.uint8)
        reasons: dict[int, str] = {}
        blocks: list[dict[str, Array] | None] = []
        together = self._members_of(_MOST_BYTES if device is None else _MOST_BYTES_OF_DEVICES)
        starts = range(0, last - first, together)
        for start in starts:
            points_together = values[start : start + together]
            with warnings.catch_warnings():
                if first + start:  # The first points have shown the warnings about open loops.
                    warnings.simplefilter("ignore", LoopWarning)
                many, rejected = self._simulate(points_together, threads, device)
            for failure in many.failures:
                place = start + failure.member
                status[place] = REJECTED if failure.member in rejected else FAILED
                reasons[first + place] = failure.reason
            blocks.append(None if len(rejected) == len(points_together) else self._outputs_of(many))
            if progress is not None:
                progress((start + len(points_together)) / (last - first))
        outputs = _joined(blocks, [len(values[s : s + together]) for s in starts])
        return Block(index, values, outputs, status, reasons, device or cpu_target().name)

    def _simulate(
        self, values: Array, threads: int | None, device: str | None
    ) -> tuple[Trajectories, set[int]]:
        varied = self._varied_scene
        members, seeds = varied.member_values(values)
        options = MemberOptions(varied.scene, {}, members, seeds)
        options.prepared = self._template
        resolved, rejected = separate_all_rejected(options)
        many = run_members(resolved, threads, None, rejected, device)
        return many, {failure.member for failure in rejected}

    def _outputs_of(self, many: Trajectories) -> dict[str, Array]:
        fields = many.fields(sorted({output.field for output in self.outputs if output.field}))
        return {output.name: output.read(fields, many) for output in self.outputs}


def check_row_shape(name: str, known: tuple[int, ...], shape: tuple[int, ...]) -> None:
    """Raise a ShapeError if the rows of an output have another shape than earlier rows."""
    if shape != known:
        raise ShapeError(
            f"outputs: expected rows of one shape from the function of {quoted(name)}, got "
            f"{known} for some points and {shape} for others"
        )


def _joined(parts: list[dict[str, Array] | None], counts: list[int]) -> dict[str, Array]:
    """Join the outputs of parts; the outputs of parts without valid points are NaN."""
    shapes: dict[str, tuple[int, ...]] = {}
    for block in parts:
        for name, values in (block or {}).items():
            check_row_shape(name, shapes.setdefault(name, values.shape[1:]), values.shape[1:])
    return {
        name: np.concatenate([
            np.full((count, *shape), np.nan) if block is None else block[name]
            for block, count in zip(parts, counts, strict=True)
        ])
        for name, shape in shapes.items()
    }  # fmt: skip


_FILE = "scene.signed"
_SIGNATURE = 32  # bytes of the HMAC-SHA256 of the sweep and the scene, at the start
_MOST_BYTES_OF_FILE = 2**30  # largest accepted size of the file [bytes]
# Former modules of stored classes, by which older stores name them.
_MOVED = {
    "pinred.forces.ball_control": "pinred.forces.kinds",
    "pinred.forces.signals.formulas": "pinred.forces.signals.signal",
    "pinred.forces.signals.tabulated": "pinred.forces.signals.signal",
    "pinred.forces.wrench": "pinred.forces.kinds",
    "pinred.lie.planar_groups": "pinred.lie.groups",
    "pinred.lie.r_se2": "pinred.lie.groups",
    "pinred.lie.spatial_groups": "pinred.lie.groups",
    "pinred.common.default_marker": "pinred.common.argument_kinds",
    "pinred.sweeps.samplers": "pinred.sweeps.distributions",
    "pinred.system.actuator": "pinred.system.robot_file_contents",
    "pinred.system.ball_forces": "pinred.system.passive",
    "pinred.system.elementary_joints": "pinred.system.joints",
    "pinred.system.loops.looped_system": "pinred.system.loops.kinematics",
    "pinred.system.shape_space": "pinred.system.coordinates",
    "pinred.system.robot_files": "pinred.system.find_robot_files",
    "pinred.system.visuals": "pinred.system.find_robot_files",
    "pinred.integrators.methods.explicit_methods": "pinred.integrators.methods.method",
    "pinred.integrators.methods.implicit_methods": "pinred.integrators.methods.method",
}
_REMEDY = "Call pinred.sweep with the scene and the same store, which computes nothing again"


class StoredScene(pickle.Unpickler):
    """Reader of pickles that also finds classes in the modules to which they have moved."""

    def find_class(self, module: str, name: str) -> Any:
        """Return the class or function of a name in a module, possibly a former one."""
        return super().find_class(_MOVED.get(module, module), name)


def write_job(folder: Path, job: SweepJob, sweep: str) -> None:
    """Write scene and points of a sweep, unless the file exists or they cannot be pickled.

    Args:
        folder: The folder of the plan.
        job: The sweep.
        sweep: The entry `hash` of its plan.
    Raises:
        OutputError: The file cannot be written.
    """
    path = folder / _FILE
    if fingerprint() == TEMPORARY or _signed(path, sweep) is not None:
        return
    try:
        data = pickle.dumps(replace(job, outputs=()))
    except Exception:  # Functions of users may raise any exception.
        return
    with suppress(OSError):  # An empty folder in the way of the file; writing reports others.
        path.rmdir()
    write_atomic(path, lambda file: file.write(_signature(data, sweep) + data))


def read_job(folder: Path, sweep: str) -> SweepJob:
    """Read scene and points of a sweep.

    Args:
        folder: The folder of the plan.
        sweep: The entry `hash` of its plan.
    Returns:
        The sweep, without its outputs.
    Raises:
        InputError: The file is missing, or was not written by this user.
    """
    path = folder / _FILE
    data = _signed(path, sweep)
    if data is None:
        why = (
            "their store was written or changed by another user"
            if path.exists()
            else "the scene contains functions, or the store is of a version that kept no scenes"
        )
        raise InputError(f"point: these results were read without their scene: {why}. {_REMEDY}")
    try:
        job: SweepJob = StoredScene(BytesIO(data)).load()
    except Exception as error:  # Another version of pinred may have other classes.
        raise InputError(
            f"point: the scene in the store cannot be read: {brief(error)}. {_REMEDY}"
        ) from None
    return job


def _signed(path: Path, sweep: str) -> bytes | None:
    """Return the pickle in a file; None without a file with the user's signature."""
    content = read_plain_file(path, _MOST_BYTES_OF_FILE) or b""
    signature, data = content[:_SIGNATURE], content[_SIGNATURE:]
    return data if hmac.compare_digest(signature, _signature(data, sweep)) else None


def _signature(data: bytes, sweep: str) -> bytes:
    return hmac.digest(signing_key(), sweep.encode() + data, "sha256")


FORMAT = 2  # Version of the files of a store; those of 1 have no checksums.
_SHORT = 64  # largest number of entries of an array in the plan
_FIRST = 16  # number of points in the plan; versions of NumPy and SciPy may change them


def plan_of_sweep(job: SweepJob) -> dict[str, Any]:
    """Return a description of a sweep that can be written as JSON.

    Its entry `hash` is equal for two sweeps only if all numbers in their stores are equal.

    Args:
        job: The sweep.
    """
    sequence = job.sequence
    entries: dict[str, Any] = {
        "format": FORMAT,
        "pinred": __version__,
        "robot": job.varied.scene.system.name,
        "scene": _parts_of_scene(job.varied.scene),
        "vary": {
            number.key: repr(law)
            for number, law in zip(job.varied.numbers, sequence.laws, strict=True)
        },
        "sampler": sequence.sampler,
        "seed": sequence.seed,
        "points": job.points,
        "first": sha256(job.values(0, min(_FIRST, job.points)).tobytes()).hexdigest(),
        "block": job.block,
        "outputs": {
            output.name: _text_of_function(output.function)
            if output.function is not None
            else [output.field, output.entry, output.over_time]
            for output in job.outputs
        },
    }
    return {**entries, "hash": digest_of_parts(entries)}


def digest_of_parts(parts: dict[str, Any]) -> str:
    """Return the entry `hash` of a plan.

    Args:
        parts: The other entries.
    """
    return sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def first_difference(old: Any, new: Any) -> tuple[tuple[str, ...], Any, Any]:
    """Return where two plans first differ, and both values there.

    Args:
        old: A plan or a part of it.
        new: The other one.
    Returns:
        The names on the path to the first difference, () if there is none; the value of `old`
        there, and that of `new`; None for a missing one.
    """
    if not (isinstance(old, dict) and isinstance(new, dict)):
        return (), old, new
    for name in (*new, *old):
        if old.get(name) != new.get(name):
            path, *values = first_difference(old.get(name), new.get(name))
            return (name, *path), values[0], values[1]
    return (), None, None


def _parts_of_scene(scene: Scene) -> dict[str, Any]:
    """Return numbers and digests, by option, that identify all numbers and expressions."""
    plan, states, watched = members_plan(scene), scene.given, scene.watched
    forces, varied = plan.forces, scene.varied
    held_joints = [] if forces is None else forces.held
    controllers = [
        [controller.name, controller.period, _text_of_function(controller.function)]
        for controller, _ in held_joints
    ]
    events = [[event.name, event.direction, event.terminal] for event in scene.events_given]
    condition = watched and [watched.text, watched.numbers(scene.parameters).tolist()]
    stops = {"joint stops": _part([list(map(astuple, scene.bounds))])} if scene.bounds else {}
    return {
        "robot": sha256(model_bytes(scene.system)).hexdigest(),
        "gravity": _part(scene.system.gravity),
        "x0": _part(states.x[0]),
        "xdot0": _part(states.xdot[0]),
        "pose0": _part(states.pose[0]),
        "xi0" if states.mu is None else "momentum": _part(states.motion[0]),
        "duration": scene.end,
        "times": _part(scene.report_times),
        "outputs": scene.outputs,
        "method": repr(plan.method),
        "parameters": {name: _part(value) for name, value in scene.parameters.items()},
        "varied parameters": None if varied is None else list(varied.names),
        "events": _part([events, condition]),
        "forces": _part([None if forces is None else repr(forces.key), controllers]),
        "tables": None if forces is None else forces.tables.digest.hex(),
        "numbers of springs, forces and prescribed joints": _part(plan.numbers),
        "stops": _part(plan.stops),
        **stops,
    }


def _part(value: Any) -> Any:
    """Return a short array as a list of its numbers, and other values as their digest."""
    if isinstance(value, list):
        return sha256(json.dumps(value, default=repr).encode()).hexdigest()
    array = np.asarray(value, dtype=float)
    if array.size <= _SHORT:
        return array.tolist()
    return sha256(repr(array.shape).encode() + array.tobytes()).hexdigest()


def _text_of_function(function: Any) -> str:
    """Return a text that identifies a function by its code, constants and closure."""
    digest = sha256()
    if isinstance(function, FunctionType):
        _add_code(digest, function.__code__)
        cells = [cell.cell_contents for cell in function.__closure__ or ()]
        for value in (function.__defaults__, function.__kwdefaults__, *cells):
            digest.update(_bytes_of(value))
    else:
        digest.update(_bytes_of(function))
    name = getattr(function, "__qualname__", type(function).__qualname__)
    return f"{name} {digest.hexdigest()}"


def _add_code(digest: Any, code: CodeType) -> None:
    digest.update(code.co_code + repr(code.co_names).encode())
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            _add_code(digest, constant)
        else:
            digest.update(repr(constant).encode())


def _bytes_of(value: Any) -> bytes:
    """Return bytes that identify a value; the name of its type if it cannot be pickled."""
    if isinstance(value, FunctionType):
        return _text_of_function(value).encode()
    try:
        return pickle.dumps(value)
    except Exception:  # Pickling may raise any exception.
        return type(value).__qualname__.encode()
