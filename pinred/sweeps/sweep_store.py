"""SweepStore: a zarr folder (format 3) with one chunk of each array for each block.

Arrays have the dimension `point` first, in chunks of one block.  A chunk is an uncompressed file,
written under a temporary name and renamed.  The chunk of `status` is written last, so a block whose
status is not zero is complete.  The group `plan` contains plan.json, and a file for each block with
the reasons of failures and the CPU.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..common.errors import InputError, OutputError
from ..common.files import remove_temporary_files, write_atomic
from ..common.names import quoted_path
from ..common.zarr_folders import array_name, create_array, create_group, open_group
from ..system.state_fields import axis_labels, dimension
from .sweep_job import MISSING, Block, SweepJob
from .sweep_outputs import Output
from .sweep_plan import changed_part, plan_of_sweep

_PLAN = "plan"
_DIFFERENCES = {
    "scene": "another scene", "robot": "another robot", "vary": "other varied numbers",
    "outputs": "other outputs", "first": "the points of another version of NumPy or SciPy",
    "pinred": "another version of pinred",
}  # fmt: skip


class SweepStore:
    """The store of one sweep.

    Attributes:
        path: The zarr folder.
        job: The sweep.
    """

    def __init__(self, path: Path, job: SweepJob) -> None:
        """Create a store, or continue an existing one.

        Args:
            path: Path of the zarr folder.
            job: The sweep.
        Raises:
            InputError: The folder belongs to another sweep, or is not the store of a sweep.
            OutputError: The folder cannot be written.
            MissingPackageError: zarr is not installed.
        """
        self.path, self.job = path, job
        self._plan = plan_of_sweep(job)
        if path.exists():
            self._check()
        else:
            self._create()

    def _check(self) -> None:
        """Check that the folder belongs to this sweep, and remove temporary files."""
        name = quoted_path(self.path)
        plan = read_plan(self.path)
        if plan.get("hash") != self._plan["hash"]:
            part = changed_part(plan, self._plan)
            other = _DIFFERENCES.get(part, f"{part}={plan.get(part)!r}")
            raise InputError(
                f"store: {name} was written for {other}. Choose another name, or delete the folder"
            )
        for partial in self.path.rglob("*.partial"):  # of zarr itself
            partial.unlink(missing_ok=True)
        remove_temporary_files(self.path)

    def _create(self) -> None:
        """Create the folder with its plan, the varied numbers and the status."""
        job, numbers = self.job, self.job.varied.numbers
        attributes = {
            "robot": job.varied.scene.system.name,
            "sampler": job.sequence.sampler,
            "seed": job.sequence.seed,
            "coordinates": " ".join(array_name(number.key) for number in numbers),
            "pinred_sweep": self._plan["hash"],
        }
        root = create_group(self.path, attributes)
        for number in numbers:
            self._new_array(root, number.key, (), (), {"units": number.unit, "name": number.key})
        meaning = {"flag_values": [0, 1, 2, 3], "flag_meanings": "missing done failed rejected"}
        chunk = {"shape": (job.points,), "chunks": (job.block,)}
        create_array(root, "status", ("point",), meaning, dtype="u1", fill_value=MISSING, **chunk)
        system = job.varied.scene.system
        labels = {
            dimension(system, axis): axis_labels(system)[axis] for axis in axis_labels(system)
        }
        used = {name for output in job.outputs for name in output.dims}
        for name in sorted(used & labels.keys()):
            values = np.array([str(label) for label in labels[name]], dtype=object)
            if isinstance(labels[name], range):
                values = np.arange(len(labels[name]))
            self._write_labels(root, name, values, {})
        if "t" in used:
            self._write_labels(root, "t", job.varied.scene.report_times, {"units": "s"})
        sizes = {name: len(values) for name, values in labels.items()}
        sizes["t"] = len(job.varied.scene.report_times)
        for output in job.outputs:
            if output.function is None:
                self._new_output(root, output, [sizes[name] for name in output.dims], output.dims)
        root.create_group(_PLAN)
        text = json.dumps(self._plan, indent=1, ensure_ascii=False)
        write_atomic(self.path / _PLAN / "plan.json", lambda file: file.write(text.encode()))

    @staticmethod
    def _write_labels(root: Any, name: str, values: Any, attributes: Mapping[str, Any]) -> None:
        dtype = "string" if values.dtype == object else values.dtype
        fill = {"f": float("nan"), "i": 0, "O": ""}[values.dtype.kind]
        array = create_array(
            root, name, (name,), attributes, shape=values.shape, dtype=dtype, fill_value=fill
        )
        array[:] = values

    def _new_output(
        self, root: Any, output: Output, shape: Sequence[int], dims: Sequence[str]
    ) -> None:
        attributes = {"units": output.unit, "name": output.name}
        self._new_array(root, output.name, shape, dims, attributes)

    def _new_array(
        self,
        root: Any,
        name: str,
        shape: Sequence[int],
        dims: Sequence[str],
        attributes: Mapping[str, Any],
    ) -> None:
        job = self.job
        create_array(
            root, array_name(name), ("point", *dims), attributes,
            shape=(job.points, *shape), chunks=(job.block, *map(int, shape)), dtype="f8",
            fill_value=float("nan"),
        )  # fmt: skip

    def pending(self) -> list[int]:
        """Return the indices of the blocks that are not complete."""
        return [k for k in range(self.job.blocks) if not (self.path / "status/c" / str(k)).exists()]

    def write(self, block: Block) -> None:
        """Store a block; a block that is stored already is overwritten with equal numbers.

        Args:
            block: The block.
        Raises:
            OutputError: Writing fails.
        """
        for output in self.job.outputs:
            values = block.outputs.get(output.name)
            if values is None:
                continue
            if not (self.path / array_name(output.name) / "zarr.json").exists():
                dims = [f"{array_name(output.name)}_{k}" for k in range(1, values.ndim)]
                self._new_output(open_group(self.path, "r+"), output, values.shape[1:], dims)
            self._write_chunk(output.name, block.index, values)
        for number, column in zip(self.job.varied.numbers, block.values.T, strict=True):
            self._write_chunk(number.key, block.index, column)
        record = {"cpu": block.cpu, "reasons": block.reasons}
        text = json.dumps(record, ensure_ascii=False).encode()
        write_atomic(self._record(block.index), lambda file: file.write(text))
        self._write_chunk("status", block.index, block.status, fill=MISSING)

    def _write_chunk(self, name: str, index: int, values: Any, fill: float = np.nan) -> None:
        """Write the chunk of a block, filled up to the size of a block."""
        shape = (self.job.block, *values.shape[1:])
        chunk = np.ascontiguousarray(values, dtype="u1" if name == "status" else "<f8")
        if chunk.shape != shape:
            full = np.full(shape, fill, dtype=chunk.dtype)
            full[: len(chunk)] = chunk
            chunk = full
        path = self.path / array_name(name) / "c" / Path(str(index), *["0"] * (chunk.ndim - 1))
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"cannot write {quoted_path(path)}: {error.strerror}") from error
        write_atomic(path, lambda file: file.write(chunk.data))

    def _record(self, index: int) -> Path:
        return self.path / _PLAN / f"{index:08d}.json"

    def records(self) -> list[dict[str, Any]]:
        """Return the CPU and the reasons {point: text} of each complete block."""
        return read_records(self.path)


def read_plan(path: Path) -> dict[str, Any]:
    """Return the plan in a store.  Raises InputError if the folder is not the store of a sweep."""
    try:
        plan: dict[str, Any] = json.loads((path / _PLAN / "plan.json").read_text("utf-8"))
    except (OSError, ValueError):
        raise InputError(
            f"store: {quoted_path(path)} is not the store of a sweep. Choose another name"
        ) from None
    return plan


def read_records(path: Path) -> list[dict[str, Any]]:
    """Return the CPU and the reasons {point: text} of each complete block of a store."""
    records = []
    for file in sorted((path / _PLAN).glob("[0-9]*.json")):
        record = json.loads(file.read_text("utf-8"))
        record["reasons"] = {int(point): text for point, text in record["reasons"].items()}
        records.append(record)
    return records
