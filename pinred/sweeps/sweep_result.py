"""SweepResult: the results of a sweep as an xarray.Dataset that reads its store when needed."""

from __future__ import annotations

import asyncio
from collections.abc import Hashable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import xarray
from zarr.storage import LocalStore, WrapperStore

from ..common.argument_kinds import checks_arguments
from ..common.errors import LoadError, PinredError
from ..common.files import array_name
from ..common.names import brief, quoted_path
from ..simulation.members.trajectories import Failure
from .sweep_job import read_job
from .sweep_store import PLAN, StoredBlocks, read_blocks, read_plan

if TYPE_CHECKING:
    from ..simulation.trajectory import Trajectory
    from .sweep_job import SweepJob

_JOB, _BLOCKS, _SOURCE = "pinred_job", "pinred_blocks", "source"


@checks_arguments
class SweepResult(xarray.Dataset):  # type: ignore[no-untyped-call]
    """The results of a sweep: an xarray.Dataset over `point` that is read from its store lazily.

    The numbers that vary are coordinates along `point`.  `status` is 1 for points that reached
    their end, 2 for failed ones, and 3 for rejected ones, whose outputs are NaN.
    """

    __slots__ = ()

    def point(self, index: int) -> Trajectory:
        """Simulate one point again, at the report times of the scene.

        Args:
            index: Index of the point, its coordinate `point` in the whole sweep.
        Returns:
            Its trajectory.
        Raises:
            InputError: There is no such point, its values are rejected, or the results were opened
                by another user, or their scene contains functions.
            IntegrationError: The point did not reach its end time.
        """
        job: SweepJob | None = self.encoding.get(_JOB)
        if job is None:
            path = Path(self.encoding[_SOURCE])
            job = read_job(path / PLAN, read_plan(path)["hash"])
        return job.trajectory(index)

    @property
    def failures(self) -> list[Failure]:
        """The points that failed or were rejected, with their reasons, in order."""
        reasons: dict[int, str] = {}
        for record in self._records():
            reasons |= record["reasons"]
        return [Failure(point, float("nan"), text) for point, text in sorted(reasons.items())]

    @property
    def cpus(self) -> dict[str, int]:
        """Number of blocks by the CPU for which their machine code was compiled."""
        counts: dict[str, int] = {}
        for record in self._records():
            counts[record["cpu"]] = counts.get(record["cpu"], 0) + 1
        return counts

    def _records(self) -> Iterator[dict[str, Any]]:
        """Yield the record of each complete block.  Raises LoadError if one is damaged."""
        blocks = cast("StoredBlocks", self.encoding[_BLOCKS])
        return (blocks.record(k) for k in blocks.stored() if blocks.status(k) is not None)


class CheckedStore(WrapperStore[Any]):
    """A zarr store that refuses damaged and missing chunks of complete blocks."""

    def __init__(self, store: Any, blocks: StoredBlocks) -> None:
        """Wrap a store.

        Args:
            store: Store of zarr.
            blocks: The blocks in the same folder.
        """
        super().__init__(store)
        self._blocks = blocks

    def _with_store(self, store: Any) -> CheckedStore:
        return CheckedStore(store, self._blocks)

    async def get(self, key: str, prototype: Any, byte_range: Any = None) -> Any:
        """Return the content of a file; called by zarr.

        Args:
            key: Name of the file.
            prototype: Types of buffers.
            byte_range: Part of the file, or None for all.
        Raises:
            LoadError: The file is a chunk that is damaged, or missing in a complete block.
        """
        name, _, indices = key.partition("/c/")
        if not indices or name not in self._blocks.rows:
            return await super().get(key, prototype, byte_range)
        index = int(indices.partition("/")[0])
        data = await asyncio.to_thread(self._blocks.read_chunk, name, index)
        if data is None or byte_range is not None:
            return await super().get(key, prototype, byte_range)
        return prototype.buffer.from_bytes(data)


def open_result(path: Path, job: SweepJob | None) -> SweepResult:
    """Open the store of a sweep.

    Args:
        path: The zarr folder.
        job: The sweep, or None.
    Returns:
        The results, which are read when they are needed.
    Raises:
        InputError: The folder is not the store of a sweep.
        LoadError: A file that describes the store is missing or damaged.
    """
    plan = read_plan(path)
    blocks = read_blocks(path, plan)
    store = CheckedStore(LocalStore(path, read_only=True), blocks)
    try:
        plain = xarray.open_zarr(store, consolidated=False, chunks=None)
    except Exception as error:  # Foreign arrays in the folder may make zarr raise any exception.
        if isinstance(error, PinredError):
            raise
        raise LoadError(f"{quoted_path(path)} cannot be read by zarr: {brief(error)}") from None
    names = [array_name(name) for name in (*plan["vary"], *plan["outputs"])]
    coords, variables = _sorted(plain.coords, names), _sorted(plain.data_vars, names)
    result = SweepResult(variables, coords, plain.attrs)
    result.encoding = {**plain.encoding, _SOURCE: str(path), _BLOCKS: blocks, _JOB: job}
    return result


def _sorted(values: Mapping[Hashable, Any], names: Iterable[str]) -> dict[Hashable, Any]:
    """Return values by name, those with the given names first."""
    return {name: values[name] for name in (*names, *values) if name in values}
