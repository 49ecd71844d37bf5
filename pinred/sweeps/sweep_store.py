"""SweepStore: a zarr folder (format 3) with one chunk of each array for each block.

Arrays have the dimension `point` first, in chunks of one block that end with a checksum (crc32c).
Each file is written under a temporary name and renamed.  The chunk of `status` is written last, so
a block that has one is complete.  The group `plan` contains plan.json, files.json with the
checksums of the files that describe the arrays, and a file for each block with its CPU, the reasons
of failures and the shapes of the rows of functions.
"""

from __future__ import annotations

import json
import os
import re
import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from math import ceil, prod
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NoReturn, Self

import numpy as np
from numpy.typing import NDArray

from ..common.errors import (
    InputError,
    LoadError,
    MissingPackageError,
    OutputError,
    StoreWarning,
)
from ..common.files import (
    array_name,
    check_path,
    create_array,
    import_zarr,
    is_file,
    is_folder,
    lock_shared,
    not_written,
    open_group,
    read_plain_file,
    remove_temporary_files,
    write_atomic,
)
from ..common.names import listed, plain, quoted, quoted_path
from ..system.state_fields import axis_labels, dimension
from .sweep_job import (
    FORMAT,
    MISSING,
    REJECTED,
    Block,
    SweepJob,
    check_row_shape,
    digest_of_parts,
    first_difference,
    plan_of_sweep,
    write_job,
)

PLAN = "plan"
_PLAN_FILE, _CHECKSUMS = f"{PLAN}/plan.json", f"{PLAN}/files.json"
# Zarr reserves or changes these names, or the file system has none for them.
_INVALID = re.compile(r"^(\.|__)|[\\\0\ud800-\udfff]")
_DIGEST = re.compile("[0-9a-f]{60}|…")
_LONGEST_VALUE = 120  # largest number of characters of a value in a message
_LONGEST = 80  # Longest name of a variable [bytes], because names of files are limited.
_MOST_BYTES = 2**28  # Largest accepted size of a file that is not a chunk [bytes].
_DIFFERENCES = {
    "scene": "another scene", "robot": "another robot", "vary": "other varied numbers",
    "outputs": "other outputs", "first": "the points of another version of NumPy or SciPy",
    "pinred": "another version of pinred", "format": "an older version of pinred",
}  # fmt: skip
_REPAIR = {
    True: "Call the sweep again with this store: it restores what is damaged",
    False: "This store of an older version cannot be restored: call the sweep with another store",
}  # by whether a store has checksums


@dataclass(frozen=True)
class StoredBlocks:
    """The chunks and records of the blocks of a store; each is checked whenever it is read.

    Attributes:
        path: The zarr folder.
        points: Number of points.
        block: Number of points of a block.
        rows: Shape of one row, by the name of an array over `point`.
        outputs: Names of outputs; blocks whose points are all rejected have no chunks of them.
        has_checksums: Whether chunks and records have checksums; older stores have none.
    """

    path: Path
    points: int
    block: int
    rows: Mapping[str, tuple[int, ...]]
    outputs: frozenset[str]
    has_checksums: bool = True

    def stored(self) -> list[int]:
        """Return the indices of all blocks that have a chunk of `status`, in order."""
        with suppress(OSError):
            names = os.listdir(self.path / "status/c")
            indices = {int(name) for name in names if name.isdecimal() and len(name) < 19}
            return sorted(index for index in indices if index < ceil(self.points / self.block))
        return []

    def is_complete(self, index: int) -> bool:
        """Read all files of a block.

        Args:
            index: Index of the block.
        Returns:
            Whether the block is complete.
        Raises:
            LoadError: The block is complete, but a file is missing or damaged.
        """
        if self.status(index) is None:
            return False
        for name in self.rows:
            self.read_chunk(name, index)
        self.record(index)
        return True

    def read_chunk(self, name: str, index: int) -> bytes | None:
        """Read a chunk.

        Args:
            name: Name of the array.
            index: Index of the block.
        Returns:
            The bytes of the file; None if the block has no values of this array.
        Raises:
            LoadError: The chunk is damaged, or missing in a complete block.
        """
        data = self.read(name, index)
        if data is None and name != "status" and self.has_values(name, index):
            data = self.read(name, index)  # The block may have become complete meanwhile.
            if data is None:
                raise self._damaged(index, self.file_of_chunk(name, index), "is missing")
        return data

    def status(self, index: int) -> NDArray[np.uint8] | None:
        """Return the status of the points of a block; None if the block is not complete.

        Args:
            index: Index of the block.
        Raises:
            LoadError: The chunk is damaged.
        """
        data = self.read("status", index)
        if data is None:
            return None
        count = min(self.block, self.points - index * self.block)
        status = np.frombuffer(data, dtype=np.uint8, count=count)
        if ((status == MISSING) | (status > REJECTED)).any():
            raise self._damaged(index, self.file_of_chunk("status", index), "has invalid entries")
        return status

    def record(self, index: int) -> dict[str, Any]:
        """Return the record of a block: its CPU, reasons {point: text}, and rows {function: shape}.

        Args:
            index: Index of the block.
        Raises:
            LoadError: The record is missing or damaged.
        """
        file = _record_file(index)
        data = read_plain_file(self.path / file, _MOST_BYTES)
        if data is None:
            raise self._damaged(index, file, "is missing")
        record = _unsealed(data) if self.has_checksums else _parsed(data)
        if record is None or record.get("block", index) != index:
            raise self._damaged(index, file, "has another content than was written")
        try:
            reasons = {int(point): str(text) for point, text in record["reasons"].items()}
            shapes = {
                name: tuple(map(int, shape)) for name, shape in record.get("rows", {}).items()
            }
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError):
            raise self._damaged(index, file, "has another content than was written") from None
        return {"cpu": str(record.get("cpu", "")), "reasons": reasons, "rows": shapes}

    def has_values(self, name: str, index: int) -> bool:
        """Return whether a block is complete and has values of an array.

        Args:
            name: Name of the array.
            index: Index of the block.
        Raises:
            LoadError: The chunk of the status is damaged.
        """
        status = self.status(index)
        if status is None:
            return False
        return name not in self.outputs or not bool((status == REJECTED).all())

    def read(self, name: str, index: int) -> bytes | None:
        """Return the bytes of a chunk; None if there is no such file.

        Args:
            name: Name of the array.
            index: Index of the block.
        Raises:
            LoadError: The chunk is damaged.
        """
        size = self.block * prod(self.rows[name]) * (1 if name == "status" else 8)
        file = self.file_of_chunk(name, index)
        data = read_plain_file(self.path / file, size + 5)
        if data is None:
            return None
        expected = size + 4 * self.has_checksums
        if len(data) != expected:
            problem = f"has {'fewer' if len(data) < expected else 'more'} than {expected} bytes"
            raise self._damaged(index, file, problem)
        if self.has_checksums and not _has_checksum(data):
            raise self._damaged(index, file, "has a wrong checksum")
        return data

    def file_of_chunk(self, name: str, index: int) -> str:
        """Return the name of the file of a chunk in the store."""
        return "/".join([name, "c", str(index), *("0" for _ in self.rows[name])])

    def _damaged(self, index: int, file: str, problem: str) -> LoadError:
        return LoadError(
            f"block {index} of the store {quoted_path(self.path)} is damaged: {quoted(file)} "
            f"{problem}. {_REPAIR[self.has_checksums]}"
        )


class SweepStore:
    """The store of one sweep, while the sweep is computed.

    Attributes:
        path: The zarr folder.
        job: The sweep.
    """

    def __init__(self, path: Path, job: SweepJob) -> None:
        """Continue an existing store; a new one is created with its first block.

        Damaged blocks of an existing store are removed, so that they are computed again.

        Args:
            path: Path of the zarr folder.
            job: The sweep.
        Raises:
            InputError: The folder belongs to another sweep, or is not the store of a sweep; or two
                variables have one name.
            OutputError: The folder cannot be written.
        """
        self.path, self.job = path, job
        self._functions = {o.name: array_name(o.name) for o in job.outputs if o.function}
        self._function_rows: dict[str, tuple[int, ...]] = {}
        self._pending = list(range(job.blocks))
        self._arrays: dict[str, Any] = {}
        self._lock: int | None = None
        _check_names(job)
        self._plan = plan_of_sweep(job)
        self._is_checked = is_folder(path) or is_file(path)
        # Try to write before the points are computed.
        check_path(path / "any.zarr" if is_folder(path) else path, (".zarr",))
        if self._is_checked:
            self._check()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Release the lock on the folder."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def pending(self) -> list[int]:
        """Return the indices of the blocks that were not complete when the store was opened."""
        return self._pending

    def _check(self) -> None:
        """Check that the folder belongs to this sweep, and remove and restore what is damaged."""
        self._check_plan()
        if self._lock is None:
            # A driver that is killed leaves temporary files; those of running ones are kept.
            self._lock = lock_shared(self.path, self._remove_partial_files)
        remove_temporary_files(self.path)
        self._read_function_rows()
        restored = self._restore()
        blocks, self._pending = self._blocks(), []
        for index in range(self.job.blocks):
            is_damaged = False
            try:
                if blocks.is_complete(index):
                    continue
            except LoadError:
                is_damaged = True
                restored.append(f"block {index}")
            self._pending.append(index)
            self._clear(blocks, index, is_damaged)
        write_job(self.path / PLAN, self.job, self._plan["hash"])
        if restored:
            warnings.warn(
                f"missing or damaged parts of the store {quoted_path(self.path)} are written "
                f"again: {listed(restored)}",
                StoreWarning,
                stacklevel=5,
            )

    def _check_plan(self) -> None:
        """Check that the folder belongs to this sweep.  Raises InputError or LoadError."""
        name = quoted_path(self.path)
        try:
            plan = read_plan(self.path)
        except (InputError, LoadError):
            # The plan is written again if the group states the same sweep.
            if _group_attributes(self.path).get("pinred_sweep") == self._plan["hash"]:
                return
            raise
        if plan["hash"] != self._plan["hash"]:
            raise InputError(
                f"store: {name} was written for {_difference(plan, self._plan)}. Choose another "
                "name, or delete the folder"
            )

    def _remove_partial_files(self) -> None:
        for partial in self.path.rglob("*.partial"):  # of zarr
            with suppress(OSError):
                partial.unlink()

    def _blocks(self) -> StoredBlocks:
        """Return the blocks of the folder, with the shapes that this sweep has."""
        job, sizes = self.job, self._sizes()
        row_shapes: dict[str, tuple[int, ...]] = {"status": ()}
        row_shapes |= {array_name(number.key): () for number in job.varied.numbers}
        row_shapes |= {
            array_name(output.name): tuple(sizes[name] for name in output.dims)
            for output in job.outputs
            if output.function is None
        }
        row_shapes |= {self._functions[name]: shape for name, shape in self._function_rows.items()}
        outputs = frozenset(array_name(output.name) for output in job.outputs)
        return StoredBlocks(self.path, job.points, job.block, row_shapes, outputs)

    def _read_function_rows(self) -> None:
        """Read the shapes of the rows of functions from the first record that states them."""
        blocks = self._blocks()
        for index in blocks.stored() if self._functions else ():
            with suppress(LoadError):
                if row_shapes := blocks.record(index)["rows"]:
                    self._add_function_rows(row_shapes)
                    return

    def _add_function_rows(self, rows: Mapping[str, tuple[int, ...]]) -> None:
        """Add shapes of rows.  Raises ShapeError if others are known."""
        for name, row in rows.items():
            if name in self._functions:
                check_row_shape(name, self._function_rows.setdefault(name, row), row)

    @staticmethod
    def _clear(blocks: StoredBlocks, index: int, is_damaged: bool) -> None:
        """Remove what is damaged of a block that will be computed, and the status before it."""
        for name in blocks.rows:
            path = blocks.path / blocks.file_of_chunk(name, index)
            try:
                blocks.read(name, index)
                # Another driver may write the block at this moment, so sound files are kept.
                is_in_the_way = path.is_dir() or (is_damaged and name == "status")
            except LoadError:
                is_in_the_way = True
            if is_in_the_way:
                _make_way(path)
        if (path := blocks.path / _record_file(index)).is_dir():
            _make_way(path)

    def _restore(self) -> list[str]:
        """Write all files that describe the store unless they are equal; return their names."""
        restored = []
        for file, content in self._description().items():
            path = self.path / file
            if read_plain_file(path, len(content) + 1) != content:
                _make_way(path)
                _write_file(path, content)
                restored.append(file)
        return restored

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
                for file, content in self._description().items():
                    (complete / file).parent.mkdir(parents=True, exist_ok=True)
                    (complete / file).write_bytes(content)
                with suppress(OSError):  # The folder exists; it is checked below.
                    complete.rename(self.path)
        except OSError as error:
            raise OutputError(not_written(self.path, error)) from error
        self._check()
        self._is_checked = True

    def _description(self) -> dict[str, bytes]:
        """Return the files that do not depend on results, by name, those with checksums last."""
        job, numbers = self.job, self.job.varied.numbers
        attributes = {
            "robot": job.varied.scene.system.name,
            "sampler": job.sequence.sampler,
            "seed": job.sequence.seed,
            "coordinates": " ".join(array_name(number.key) for number in numbers),
            "pinred_sweep": self._plan["hash"],
        }
        zarr = import_zarr(self.path, "sweep")
        memory: dict[str, Any] = {}
        root = zarr.create_group(
            zarr.storage.MemoryStore(memory), zarr_format=3, attributes=attributes
        )
        for number in numbers:
            self._new_array(root, number.key, (), (), {"units": number.unit, "name": number.key})
        meaning = {"flag_values": [0, 1, 2, 3], "flag_meanings": "missing done failed rejected"}
        self._new_array(root, "status", (), (), meaning)
        labels = self._labels()
        for name in sorted({dim for output in job.outputs for dim in output.dims}):
            values = labels[name]
            fill = {"f": float("nan"), "i": 0, "O": ""}[values.dtype.kind]
            array = create_array(
                root, name, (name,), {"units": "s" if name == "t" else ""}, shape=values.shape,
                dtype="string" if values.dtype == object else values.dtype, fill_value=fill,
                config=_WRITE_ALL,
            )  # fmt: skip
            array[:] = values
        sizes = self._sizes()
        for output in job.outputs:
            if output.function is None:
                shape, dims = tuple(sizes[name] for name in output.dims), output.dims
            elif output.name in self._function_rows:
                shape = self._function_rows[output.name]
                dims = tuple(f"{array_name(output.name)}_{k + 1}" for k in range(len(shape)))
            else:
                continue  # The shape is unknown before the first block.
            attributes = {"units": output.unit, "name": output.name}
            self._new_array(root, output.name, shape, dims, attributes)
        root.create_group(PLAN)
        files = {key: bytes(memory[key].to_bytes()) for key in sorted(memory)}
        checksums = {name: sha256(content).hexdigest() for name, content in files.items()}
        text = json.dumps(self._plan, indent=1, ensure_ascii=False)
        files[_PLAN_FILE] = text.encode("utf-8", "surrogatepass")
        files[_CHECKSUMS] = _sealed({"sweep": self._plan["hash"], "files": checksums})
        return files

    def _labels(self) -> dict[str, Any]:
        """Return the labels of all dimensions as arrays, by dimension."""
        labels: dict[str, Any] = {"t": np.asarray(self.job.varied.scene.report_times)}
        for name, values in _labels_of(self.job).items():
            texts = np.array([str(label) for label in values], dtype=object)
            labels[name] = np.arange(len(values)) if isinstance(values, range) else texts
        return labels

    def _sizes(self) -> dict[str, int]:
        """Return the lengths of all dimensions."""
        return {name: len(values) for name, values in self._labels().items()}

    def _new_array(
        self,
        root: Any,
        name: str,
        shape: Sequence[int],
        dims: Sequence[str],
        attributes: Mapping[str, Any],
    ) -> None:
        job, is_status = self.job, name == "status"
        create_array(
            root, array_name(name), ("point", *dims), attributes,
            shape=(job.points, *shape), chunks=(job.block, *map(int, shape)),
            dtype="u1" if is_status else "f8", fill_value=MISSING if is_status else float("nan"),
            compressors=[import_zarr(self.path, "sweep").codecs.Crc32cCodec()],
        )  # fmt: skip

    def write(self, block: Block) -> None:
        """Store a block; a block that is stored already is overwritten with equal numbers.

        Args:
            block: The block.
        Raises:
            OutputError: Writing fails.
            ShapeError: An output has rows of another shape than in the blocks before.
        """
        row_shapes = {
            name: values.shape[1:]
            for name, values in block.outputs.items()
            if name in self._functions
        }
        is_new = bool(row_shapes.keys() - self._function_rows.keys())
        self._add_function_rows(row_shapes)
        if not self._is_checked:
            self._create()
        elif is_new:
            self._restore()
        for name, values in block.outputs.items():
            self._write_chunk(name, block.index, values)
        for number, column in zip(self.job.varied.numbers, block.values.T, strict=True):
            self._write_chunk(number.key, block.index, column)
        record = {
            "block": block.index,
            "cpu": block.cpu,
            "reasons": {str(point): text for point, text in block.reasons.items()},
            "rows": {name: list(shape) for name, shape in row_shapes.items()},
        }
        _write_file(self.path / _record_file(block.index), _sealed(record))
        self._write_chunk("status", block.index, block.status)

    def _write_chunk(self, name: str, index: int, values: Any) -> None:
        """Write the chunk of a block.  Raises OutputError."""
        name = array_name(name)
        if name not in self._arrays:
            self._arrays[name] = open_group(self.path, "r+")[name].with_config(_WRITE_ALL)
        first, last = self.job.span(index)
        try:
            self._arrays[name][first:last] = values
        except OSError as error:
            raise OutputError(not_written(self.path / name / "c" / str(index), error)) from error


# Blocks whose numbers are all NaN have chunks, too, because missing chunks are damage.
_WRITE_ALL = {"write_empty_chunks": True}


def _record_file(index: int) -> str:
    return f"{PLAN}/{index:08d}.json"


def _make_way(path: Path) -> None:
    """Remove a file, or an empty folder with the name of a file.  Raises OutputError."""
    try:
        if path.is_dir() and not path.is_symlink():
            path.rmdir()
        else:
            path.unlink(missing_ok=True)
    except NotADirectoryError:  # A folder above is a file, so writing will fail.
        return
    except OSError as error:
        raise OutputError(f"{not_written(path, error)}. Move it away") from None


def _write_file(path: Path, content: bytes) -> None:
    """Write a file and the folders above it.  Raises OutputError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(not_written(path, error)) from error
    write_atomic(path, lambda file: file.write(content))


def _has_checksum(data: bytes) -> bool:
    """Return whether a chunk ends with its checksum."""
    import google_crc32c  # zarr needs this package, too

    return bool(google_crc32c.value(data[:-4]) == int.from_bytes(data[-4:], "little"))


def _parsed(data: bytes) -> dict[str, Any] | None:
    """Return the object in a JSON file; None if there is none."""
    try:
        content = json.loads(data)
    except (ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None


def _sealed(content: Mapping[str, Any]) -> bytes:
    """Return the text of a JSON file that contains its own checksum."""
    digest = sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
    text = json.dumps({**content, "sha256": digest}, ensure_ascii=False)
    return text.encode("utf-8", "surrogatepass")


def _unsealed(data: bytes) -> dict[str, Any] | None:
    """Return the content of a file that `_sealed` wrote; None if any bit has changed."""
    content = _parsed(data)
    if content is None or not content.pop("sha256", None) or _sealed(content) != data:
        return None
    return content


def _difference(old: dict[str, Any], new: dict[str, Any]) -> str:
    """Return the first difference of two plans in words."""
    (entry, *names), before, now = first_difference(old, new)
    if not names:
        return _DIFFERENCES.get(entry, f"{entry}={before!r}")
    words, place = _DIFFERENCES[entry], ".".join(names)
    texts = [
        "none" if value is None else plain(str(value), _LONGEST_VALUE) for value in (before, now)
    ]
    if any(_DIGEST.search(text) for text in texts):
        return f"{words}: other {place}"
    return f"{words}: {place} is {texts[0]} there, and {texts[1]} here"


def _labels_of(job: SweepJob) -> dict[str, Any]:
    """Return the labels of the entries of fields, by dimension."""
    system = job.varied.scene.system
    return {dimension(system, axis): labels for axis, labels in axis_labels(system).items()}


def _check_names(job: SweepJob) -> None:
    """Raise an InputError if a variable has no valid name of its own."""
    used = dict.fromkeys(("point", "status", "t", PLAN, *_labels_of(job)), "a variable of pinred")
    names = [("vary", number.key) for number in job.varied.numbers]
    for argument, name in names + [("outputs", output.name) for output in job.outputs]:
        plain = array_name(name)
        is_valid = plain and plain != "zarr.json" and not _INVALID.search(plain)
        if not is_valid or len(plain.encode()) > _LONGEST:
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
    """Return the plan in a store.

    Args:
        path: The zarr folder.
    Returns:
        The plan.
    Raises:
        InputError: The folder is not the store of a sweep, or of a newer version of pinred.
        LoadError: The plan is damaged.
    """
    name, data = quoted_path(path), read_plain_file(path / _PLAN_FILE, _MOST_BYTES)
    if data is None and "pinred_sweep" not in _group_attributes(path):
        raise InputError(f"store: {name} is not the store of a sweep. Choose another name")
    plan = _parsed(data or b"") or {}
    version = plan.get("format")
    if isinstance(version, int) and version > FORMAT:
        raise InputError(f"store: {name} was written by a newer version of pinred. Install it")
    entries = {key: value for key, value in plan.items() if key != "hash"}
    is_valid = (
        plan.get("hash") == digest_of_parts(entries)
        and isinstance(version, int)
        and all(isinstance(plan.get(key), dict) for key in ("vary", "outputs"))
        and all(type(plan.get(key)) is int and plan[key] > 0 for key in ("points", "block"))
    )
    if not is_valid:
        _refuse(path, _PLAN_FILE)
    return plan


def read_blocks(path: Path, plan: Mapping[str, Any]) -> StoredBlocks:
    """Check the files that describe a store, and return its blocks.

    Args:
        path: The zarr folder.
        plan: Its plan.
    Raises:
        LoadError: A file is missing or damaged, or describes another sweep.
        MissingPackageError: zarr is not installed.
    Returns:
        The blocks.
    """
    has_checksums = plan["format"] > 1
    if _group_attributes(path).get("pinred_sweep") != plan["hash"]:
        _refuse(path, "zarr.json", has_checksums)
    if has_checksums:
        _check_files(path, plan["hash"])
    kinds = {array_name(name): isinstance(output, str) for name, output in plan["outputs"].items()}
    functions = [name for name, is_function in kinds.items() if is_function]
    fields = [name for name, is_function in kinds.items() if not is_function]
    names = ["status", *map(array_name, plan["vary"]), *fields]
    row_shapes = {name: _row_shape(path, name, plan) for name in names}
    if not has_checksums:
        _check_labels(path, {*names, *functions, PLAN})
    blocks = StoredBlocks(
        path, plan["points"], plan["block"], row_shapes, frozenset(kinds), has_checksums
    )
    # The array of a function is created before the first block that has values of it.
    has_values = any(blocks.has_values(name, k) for name in functions[:1] for k in blocks.stored())
    for name in functions:
        if has_values or (path / name / "zarr.json").exists():
            row_shapes[name] = _row_shape(path, name, plan)
    return blocks


def _group_attributes(path: Path) -> dict[str, Any]:
    """Return the attributes of a zarr folder; empty if it has none."""
    group = _parsed(read_plain_file(path / "zarr.json", _MOST_BYTES) or b"") or {}
    attributes = group.get("attributes")
    return attributes if isinstance(attributes, dict) else {}


def _check_files(path: Path, sweep: str) -> None:
    """Compare the files that describe a store with their checksums.  Raises LoadError."""
    listing = _unsealed(read_plain_file(path / _CHECKSUMS, _MOST_BYTES) or b"")
    files = {} if listing is None else listing.get("files")
    if listing is None or listing.get("sweep") != sweep or not isinstance(files, dict):
        _refuse(path, _CHECKSUMS)
    for name, checksum in files.items():
        data = read_plain_file(path / name, _MOST_BYTES)
        if data is None or sha256(data).hexdigest() != checksum:
            _refuse(path, name)


def _row_shape(path: Path, name: str, plan: Mapping[str, Any]) -> tuple[int, ...]:
    """Return the shape of one row of an array.  Raises LoadError if it has an unexpected form."""
    file = f"{name}/zarr.json"
    try:
        if read_plain_file(path / file, _MOST_BYTES) is None:
            raise FileNotFoundError
        array = open_group(path)[name]
        dict(array.attrs)
        shape, dtype = tuple(array.shape[1:]), "u1" if name == "status" else "f8"
        if (array.shape[0], *array.chunks, array.dtype) != (
            plan["points"], plan["block"], *shape, np.dtype(dtype)
        ):  # fmt: skip
            raise ValueError
    except Exception as error:  # A foreign zarr.json may make zarr raise any exception.
        if isinstance(error, MissingPackageError):
            raise
        _refuse(path, file, plan["format"] > 1)
    return shape


def _check_labels(path: Path, others: set[str]) -> None:
    """Check the labels in a store without checksums.  Raises LoadError if a chunk is missing."""
    for name in sorted(file.parent.name for file in path.glob("*/zarr.json")):
        if name in others:
            continue
        try:
            array = open_group(path)[name]
            is_complete = array.nchunks_initialized == array.nchunks
        except Exception:  # A foreign zarr.json may make zarr raise any exception.
            _refuse(path, f"{name}/zarr.json", has_checksums=False)
        if not is_complete:
            _refuse(path, f"{name}/c", has_checksums=False)


def _refuse(path: Path, file: str, has_checksums: bool = True) -> NoReturn:
    raise LoadError(
        f"{quoted(file)} of the store {quoted_path(path)} is missing or damaged. "
        f"{_REPAIR[has_checksums]}"
    )
