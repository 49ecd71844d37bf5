"""The file of a store that contains its scene, so that single points can be simulated again.

A scene is a pickle, which could execute anything.  Therefore the file has the user's signature, and
only files with the own signature are read; see common/files.py.
"""

from __future__ import annotations

import hmac
import pickle
from contextlib import suppress
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

from ..common.errors import InputError
from ..common.files import TEMPORARY, fingerprint, read_plain_file, signing_key, write_atomic
from ..common.names import brief
from .sweep_job import SweepJob

_FILE = "scene.signed"
_SIGNATURE = 32  # bytes of the HMAC-SHA256 of the sweep and the scene, at the start
_MOST_BYTES = 2**30  # largest accepted size of the file [bytes]
# Former modules of stored classes, by which older stores name them.
_MOVED = {
    "pinred.forces.ball_control": "pinred.forces.kinds",
    "pinred.forces.signals.formulas": "pinred.forces.signals.signal",
    "pinred.forces.signals.tabulated": "pinred.forces.signals.signal",
    "pinred.forces.wrench": "pinred.forces.kinds",
    "pinred.system.actuator": "pinred.system.robot_file_contents",
    "pinred.system.ball_forces": "pinred.system.passive",
    "pinred.system.elementary_joints": "pinred.system.joints",
    "pinred.system.loops.looped_system": "pinred.system.loops.kinematics",
    "pinred.system.shape_space": "pinred.system.coordinates",
    "pinred.system.visuals": "pinred.system.robot_files",
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
            else "the scene contains functions, which its store cannot keep"
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
    content = read_plain_file(path, _MOST_BYTES) or b""
    signature, data = content[:_SIGNATURE], content[_SIGNATURE:]
    return data if hmac.compare_digest(signature, _signature(data, sweep)) else None


def _signature(data: bytes, sweep: str) -> bytes:
    return hmac.digest(signing_key(), sweep.encode() + data, "sha256")
