"""SweepStore: a zarr folder (format 3) with one chunk of each array for each block.

Arrays have the dimension `point` first, in chunks of one block.  A chunk is an uncompressed file,
written under a temporary name and renamed.  The chunk of `status` is written last, so a block whose
status is not zero is complete.  The group `plan` contains plan.json, and a file for each block with
the reasons of failures and the CPU.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ..common.errors import InputError, OutputError
from ..common.files import check_path, remove_temporary_files, write_atomic
from ..common.names import quoted, quoted_path
from ..common.zarr_folders import array_name, create_array, create_group, open_group
from ..system.state_fields import axis_labels, dimension
from .sweep_job import MISSING, Block, SweepJob, check_row_shape
from .sweep_outputs import Output
from .sweep_plan import changed_part, plan_of_sweep

_PLAN = "plan"
_INVALID = re.compile(r"^(\.|__)|[\\\0]")  # Zarr reserves or changes these names.
_LONGEST = 80  # Longest name of a variable, because names of files are limited.
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
        """Continue an existing store; a new one is created with its first block.

        Args:
            path: Path of the zarr folder.
            job: The sweep.
        Raises:
            InputError: The folder belongs to another sweep, or is not the store of a sweep; or two
                variables have one name.
            OutputError: The folder cannot be written.
        """
        self.path, self.job = path, job
        self._row_shapes: dict[str, tuple[int, ...]] = {}
        _check_names(job)
        self._plan = plan_of_sweep(job)
        self._is_checked = path.exists()
        if self._is_checked:
            self._check()
        # Try to write before the points are computed.
        check_path(path / "any.zarr" if path.exists() else path, (".zarr",))

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
        """Create the folder under a temporary name and rename it.

        A process that ends meanwhile leaves no store.

        Raises:
            InputError: Another driver has created the store meanwhile, for another sweep.
            OutputError: The folder cannot be written.
        """
        try:
            with TemporaryDirectory(dir=self.path.parent, prefix=f".{self.path.name}.") as parent:
                complete = Path(parent) / "complete"
                self._write_plan(complete)
                with suppress(OSError):  # The folder exists; it is checked below.
                    complete.rename(self.path)
        except OSError as error:
            name = quoted_path(self.path)
            raise OutputError(f"cannot write {name}: {error.strerror or error}") from error
        self._check()
        self._is_checked = True

    def _write_plan(self, path: Path) -> None:
        """Write a folder with the plan, the arrays of varied numbers and fields, and the status."""
        job, numbers = self.job, self.job.varied.numbers
        attributes = {
            "robot": job.varied.scene.system.name,
            "sampler": job.sequence.sampler,
            "seed": job.sequence.seed,
            "coordinates": " ".join(array_name(number.key) for number in numbers),
            "pinred_sweep": self._plan["hash"],
        }
        root = create_group(path, attributes)
        for number in numbers:
            self._new_array(root, number.key, (), (), {"units": number.unit, "name": number.key})
        meaning = {"flag_values": [0, 1, 2, 3], "flag_meanings": "missing done failed rejected"}
        chunk = {"shape": (job.points,), "chunks": (job.block,)}
        create_array(root, "status", ("point",), meaning, dtype="u1", fill_value=MISSING, **chunk)
        labels = _labels_of(job)
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
        write_atomic(path / _PLAN / "plan.json", lambda file: file.write(text.encode()))

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
            ShapeError: An output has rows of another shape than in the blocks before.
        """
        if not self._is_checked:
            self._create()
        for output in self.job.outputs:
            values = block.outputs.get(output.name)
            if values is None:
                continue
            known = self._known_row_shape(output.name)
            if known is not None:
                check_row_shape(output.name, known, values.shape[1:])
            else:
                dims = [f"{array_name(output.name)}_{k}" for k in range(1, values.ndim)]
                self._new_output(open_group(self.path, "r+"), output, values.shape[1:], dims)
            self._write_chunk(output.name, block.index, values)
        for number, column in zip(self.job.varied.numbers, block.values.T, strict=True):
            self._write_chunk(number.key, block.index, column)
        record = {"cpu": block.cpu, "reasons": block.reasons}
        text = json.dumps(record, ensure_ascii=False).encode()
        write_atomic(self._record(block.index), lambda file: file.write(text))
        self._write_chunk("status", block.index, block.status, fill=MISSING)

    def _known_row_shape(self, name: str) -> tuple[int, ...] | None:
        """Return the shape of the rows of an array; None before the array exists."""
        if name not in self._row_shapes:
            try:
                text = (self.path / array_name(name) / "zarr.json").read_text("utf-8")
            except FileNotFoundError:
                return None
            self._row_shapes[name] = tuple(json.loads(text)["shape"][1:])
        return self._row_shapes[name]

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


def _labels_of(job: SweepJob) -> dict[str, Any]:
    """Return the labels of the entries of fields, by dimension."""
    system = job.varied.scene.system
    return {dimension(system, axis): labels for axis, labels in axis_labels(system).items()}


def _check_names(job: SweepJob) -> None:
    """Raise an InputError if a variable has no valid name of its own."""
    used = dict.fromkeys(("point", "status", "t", _PLAN, *_labels_of(job)), "a variable of pinred")
    names = [("vary", number.key) for number in job.varied.numbers]
    for argument, name in names + [("outputs", output.name) for output in job.outputs]:
        plain = array_name(name)
        if not plain or plain == "zarr.json" or _INVALID.search(plain) or len(plain) > _LONGEST:
            raise InputError(
                f"{argument}: expected a name that can be that of a file, got {quoted(name)}"
            )
        if plain in used:
            raise InputError(
                f"{argument}: expected names of their own, but {quoted(name)} is the name of "
                f"{used[plain]} in the store, too. Choose another name"
            )
        used[plain] = f"{quoted(name)} in {argument}"


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
