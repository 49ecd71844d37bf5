"""Checkpoints: a simulation that is interrupted continues with the same bits.

A file contains a record of each run of a simulation, because functions of time that steps skip are
integrated again with more stops.  A record has the integrations from stop to stop, and the state of
the run's followers: its controllers and events.

Files hold nested values, signed with the user's key.  The compiled loops trust the registers of a
run, and states of controllers are pickled.  Therefore only files with the user's own signature are
used; see common/files.py.
"""

from __future__ import annotations

import hmac
import json
import struct
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from ..common.arrays import Array, pack, read_only, unpack
from ..common.errors import InputError, OutputError
from ..common.files import TEMPORARY, check_path, fingerprint, is_file, signing_key, write_atomic
from ..common.names import quoted_path
from ..common.object_cache import cache_key
from ..common.waiting import cleaning_up, held_interrupt
from ..integrators.integrate import SavedRun

if TYPE_CHECKING:
    from .compiled.compiled_flow import CompiledFlow
    from .plan import Plan


SUFFIX = ".ckpt"
_MAGIC = b"pinred checkpoint 1\n"
_LENGTH = struct.Struct("<Q")
_SIGNATURE = 32  # bytes of the HMAC-SHA256 of all other bytes, at the end


def check_checkpoint_path(path: str | Path) -> Path:
    """Check that a checkpoint can be written at a path and read by a later process.

    Args:
        path: Name of the file.
    Returns:
        The path.
    Raises:
        OutputError: The signing key cannot be stored, so no other process could read the file.
    """
    checked = check_path(path, (SUFFIX,))
    if fingerprint() == TEMPORARY:
        raise OutputError(
            "checkpoint: expected a data folder that keeps the signing key, so that a later "
            "process can read the checkpoint. Make the home folder writable, or set XDG_DATA_HOME"
        )
    return checked


def write_checkpoint(path: Path, content: dict[str, Any]) -> None:
    """Write nested values atomically.

    Args:
        path: Name of the file.
        content: The values; see `pack` in common/arrays.py.
    Raises:
        OutputError: The file cannot be written.
    """
    data, buffers = pack(content)
    head = json.dumps([data, [len(buffer) for buffer in buffers]]).encode()

    def write(file: BinaryIO) -> None:
        signature = hmac.new(signing_key(), digestmod="sha256")
        for block in (_MAGIC, _LENGTH.pack(len(head)), head, *buffers):
            signature.update(block)
            file.write(block)
        file.write(signature.digest())

    write_atomic(path, write)


def read_checkpoint(path: Path) -> dict[str, Any] | None:
    """Read a checkpoint.

    Args:
        path: Name of the file.
    Returns:
        The values; None if there is no file.
    Raises:
        InputError: The file is not a complete checkpoint of this user.
    """
    if not is_file(path):
        return None
    try:
        content = memoryview(path.read_bytes())
    except OSError as error:
        raise InputError(f"checkpoint: cannot read {quoted_path(path)}: {error.strerror}") from None
    if content[: len(_MAGIC)] != _MAGIC:
        raise InputError(_refuse(path, "was not written as a checkpoint by this version of pinred"))
    signed, signature = content[:-_SIGNATURE], content[-_SIGNATURE:]
    if not hmac.compare_digest(signature, hmac.digest(signing_key(), signed, "sha256")):
        why = "is truncated or damaged, or was written with the key of another data folder"
        raise InputError(_refuse(path, why))
    at = len(_MAGIC) + _LENGTH.size
    (size,) = _LENGTH.unpack(signed[len(_MAGIC) : at])
    data, lengths = json.loads(bytes(signed[at : at + size]))
    at, buffers = at + size, []
    for length in lengths:
        buffers.append(signed[at : at + length])
        at += length
    values: dict[str, Any] = unpack(data, buffers)
    return values


def _refuse(path: Path, why: str) -> str:
    return (
        f"checkpoint: expected a checkpoint of this user, but {quoted_path(path)} {why}. Choose "
        "another name, or delete the file to start again"
    )


@dataclass(frozen=True)
class Part:
    """An integration from one stop to the next.

    Attributes:
        start: Start time [s].
        end: End time [s].
        y0: Reduced state at the start, (k,).
        parameters: Parameters of the vector field, (p,).
        run: State of the integration; None if it has not begun.
        follower: State of controllers and events at the start, or None.
    """

    start: float
    end: float
    y0: Array
    parameters: Array
    run: SavedRun | None = None
    follower: Mapping[str, Any] | None = None

    @property
    def is_finished(self) -> bool:
        """Whether the run of this part is finished."""
        return self.run is not None and self.follower is None

    @classmethod
    def of(cls, saved: Mapping[str, Any]) -> Part:
        """Return a saved part."""
        part = cls(**saved)
        return replace(part, y0=read_only(part.y0), parameters=read_only(part.parameters))


class RunRecord:
    """The record of one run; it keeps the integration of its last part (see RunKeeper).

    Attributes:
        finished: Finished parts, in order.
        current: The saved part that is not finished, or None.
        follower: State of controllers and events at the end of a finished run, or None.
    """

    def __init__(self, saved: Mapping[str, Any], write: Callable[..., None]) -> None:
        """Read a record.

        Args:
            saved: The record as nested values; {} for a new run.
            write: Function that writes the checkpoint if a save is due.
        """
        self.finished = [Part.of(part) for part in saved.get("finished", ())]
        self.current = Part.of(saved["current"]) if saved.get("current") else None
        self.follower: Mapping[str, Any] | None = saved.get("follower")
        self._write, self._done = write, list(self.finished)
        self._part: Part | None = None
        self._count = 0
        self._state: Callable[[], dict[str, Any]] = dict
        self._follower: Callable[[], dict[str, Any]] = dict

    def begin_run(self, follower: Callable[[], dict[str, Any]]) -> None:
        """Set the function that returns the state of controllers and events.

        Raises an InputError if they have a state that cannot be saved.
        """
        follower()
        self._follower = follower

    def begin(self, part: Part) -> None:
        """Start a part; if its run is saved, it continues from there."""
        self._part = part

    def repeat(self, part: Part) -> None:
        """Start the next part of a run that repeats all its parts; a saved one continues."""
        saved = [*self.finished, *([self.current] if self.current else [])]
        self.begin(saved[self._count] if self._count < len(saved) else part)
        self._count += 1

    def interrupt(self) -> None:
        """Keep the part, which ended before its end, in its last state."""
        self.finish(self._state())

    def saved(self) -> SavedRun | None:
        """Return the state from which the current part continues; see RunKeeper."""
        assert self._part is not None
        return self._part.run

    def pause(self, state: Callable[[], dict[str, Any]]) -> None:
        """Write the checkpoint if a save is due; see RunKeeper."""
        part = self._part
        assert part is not None
        self._state = state
        if part.is_finished:
            return

        def current() -> dict[str, Any]:
            return vars(replace(part, run=state(), follower=self._follower()))

        self._write(lambda: self._values(current()))

    def finish(self, state: dict[str, Any]) -> None:
        """Keep a finished part; see RunKeeper."""
        assert self._part is not None
        if not self._part.is_finished:
            self._done.append(replace(self._part, run=state, follower=None))

    def values(self) -> dict[str, Any]:
        """Return the record of a finished run as nested values."""
        return self._values(None) | {"follower": self._follower()}

    def _values(self, current: dict[str, Any] | None) -> dict[str, Any]:
        return {"finished": [dict(vars(part)) for part in self._done], "current": current}


INTERVAL = 60.0  # time between saves [s]
_SHARE = 20.0  # Saves take at most 1/20 of the time.


class Checkpoint:
    """The checkpoint file of one simulation."""

    def __init__(self, path: Path, interrupted: Callable[[], bool]) -> None:
        """Read the file, if it exists.

        Args:
            path: Name of the file.
            interrupted: Function that returns whether Ctrl-C was pressed.
        """
        self._path, self._interrupted = path, interrupted
        self._content = read_checkpoint(path) or {}
        self._records: list[dict[str, Any]] = []
        self._last, self._cost = time.monotonic(), 0.0

    def run(self, flow: CompiledFlow, plan: Plan) -> RunRecord:
        """Return the record of the next run, empty unless the file contains it.

        Args:
            flow: The flow of the plan.
            plan: The plan of the run.
        Returns:
            The record.
        Raises:
            InputError: The file belongs to another scene, or to other versions or another CPU.
        """
        scene, place = _fingerprint_of(flow, plan), _fingerprint_of_environment()
        k, content = len(self._records), self._content
        saved = content["runs"][k] if content and k < len(content["runs"]) else {}
        for entry, current, what in (
            # Other versions may also describe the same scene otherwise.
            ("place", place, "other versions of the packages, or for another CPU"),
            ("scene", scene, "another scene"),
        ):
            if saved and saved[entry] != current:
                raise InputError(
                    f"checkpoint: {quoted_path(self._path)} was written for {what}, so the motion "
                    "cannot continue with the same bits. Choose another name, or delete the file"
                )
        identity = {"scene": scene, "place": place}
        return RunRecord(saved, lambda values: self._write_if_due(lambda: identity | values()))

    def close(self, record: RunRecord, flow: CompiledFlow, plan: Plan, *, cut: bool) -> None:
        """Write the checkpoint of a finished run.

        Args:
            record: The record of the run.
            flow: The flow of the plan.
            plan: The plan of the run.
            cut: Whether an event ended the run. Then its last steps are integrated again, and the
                file is not written.
        """
        if cut:
            self._records.append({})
            return
        identity = {"scene": _fingerprint_of(flow, plan), "place": _fingerprint_of_environment()}
        self._records.append(identity | record.values())
        self._write([])

    def _write_if_due(self, values: Callable[[], dict[str, Any]]) -> None:
        interrupted = self._interrupted()
        if interrupted or time.monotonic() - self._last >= max(INTERVAL, _SHARE * self._cost):
            self._write([values()])
        if interrupted:
            raise KeyboardInterrupt

    def _write(self, more: list[dict[str, Any]]) -> None:
        started = time.monotonic()
        with cleaning_up:
            write_checkpoint(self._path, {"runs": [*self._records, *more]})
        self._last = time.monotonic()
        self._cost = self._last - started


@contextmanager
def opened(path: str | Path) -> Iterator[Checkpoint]:
    """Read a checkpoint, and delay Ctrl-C until it is written.

    Args:
        path: Name of the file.
    Yields:
        The checkpoint.
    """
    checked = check_checkpoint_path(path)
    with held_interrupt() as interrupted:
        yield Checkpoint(checked, interrupted)


def _fingerprint_of(flow: CompiledFlow, plan: Plan) -> str:
    """Return a text that identifies the motion of a plan, 64 hexadecimal digits."""
    from ..kernels.build import model_bytes

    kernel, scene = flow.kernel, plan.scene
    forces = kernel.forces
    controllers_held = [] if forces is None else forces.held
    controllers = [(c.name, c.period) for c, _ in controllers_held]
    watched = scene.watched
    events = [(e.name, e.direction, e.terminal) for e in scene.events_given]
    settings = [
        asdict(kernel.structure), forces and forces.key, controllers, events,
        watched and [watched.text, watched.numbers(scene.parameters).tolist()],
        list(map(repr, scene.bounds)),
    ]  # fmt: skip
    arrays = (flow.y0, flow.parameters, flow.path, plan.stops, scene.report_times)
    digest = sha256(model_bytes(kernel.system, kernel.structure.freed))
    if plan.forces is not None:
        digest.update(plan.forces.tables.digest)
    digest.update(json.dumps([*settings, repr(plan.method), scene.end], default=str).encode())
    for array in arrays:
        digest.update(repr(array.shape).encode() + array.tobytes())
    return digest.hexdigest()


@cache
def _fingerprint_of_environment() -> str:
    """Return a text that identifies everything that computes bits, 64 hexadecimal digits."""
    package = Path(__file__).parent.parent
    folders = [package / name for name in ("integrators", "simulation", "forces")]
    files = sorted(path for folder in folders for path in folder.rglob("*.py"))
    sources = b"".join(path.read_bytes() for path in files)
    return cache_key(sources, version("numpy"))
