"""Checkpoints: a simulation that is interrupted continues with the same bits.

A file contains a record of each run of a simulation (see run_record.py), because functions of time
that steps skip are integrated again with more stops.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError
from ..common.interrupts import cleaning_up, held_interrupt
from ..common.names import quoted_path
from ..common.object_cache import cache_key
from ..kernels.build import model_bytes
from .checkpoint_file import check_checkpoint_path, read_checkpoint, write_checkpoint
from .run_record import RunRecord

if TYPE_CHECKING:
    from .compiled.compiled_flow import CompiledFlow
    from .plan import Plan

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
            ("scene", scene, "another scene"),
            ("place", place, "other versions of the packages, or for another CPU"),
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
    kernel, scene = flow.kernel, plan.scene
    forces = kernel.forces
    held = [] if forces is None else forces.held
    controllers = [(c.name, c.period) for c, _ in held]
    watched = scene.watched
    events = [(e.name, e.direction, e.terminal) for e in scene.events_given]
    settings = [
        asdict(kernel.structure), forces and forces.key, controllers, events,
        watched and [watched.text, watched.numbers(scene.parameters).tolist()],
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
