"""SweepResult: the results of a sweep as an xarray.Dataset that reads its store when needed."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import xarray

from ..common.errors import InputError
from ..common.zarr_folders import array_name
from ..simulation.members.trajectories import Failure
from .sweep_store import read_plan, read_records

if TYPE_CHECKING:
    from ..simulation.trajectory import Trajectory
    from .sweep_job import SweepJob

_JOB, _SOURCE = "pinred_job", "source"


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
            InputError: There is no such point, its values are rejected, or the results were read
                without their scene.
            IntegrationError: The point did not reach its end time.
        """
        job: SweepJob | None = self.encoding.get(_JOB)
        if job is None:
            raise InputError(
                "point: these results were read without their scene. Call pinred.sweep with the "
                "scene and the same store, which computes nothing again"
            )
        return job.trajectory(index)

    @property
    def failures(self) -> list[Failure]:
        """The points that failed or were rejected, with their reasons, in order."""
        reasons: dict[int, str] = {}
        for record in read_records(self._folder):
            reasons |= record["reasons"]
        return [Failure(point, float("nan"), text) for point, text in sorted(reasons.items())]

    @property
    def cpus(self) -> dict[str, int]:
        """Number of blocks by the CPU for which their machine code was compiled."""
        counts: dict[str, int] = {}
        for record in read_records(self._folder):
            counts[record["cpu"]] = counts.get(record["cpu"], 0) + 1
        return counts

    @property
    def _folder(self) -> Path:
        return Path(cast("Mapping[str, Any]", self.encoding)[_SOURCE])


def open_result(path: Path, job: SweepJob | None) -> SweepResult:
    """Open the store of a sweep.

    Args:
        path: The zarr folder.
        job: The sweep, or None.
    Returns:
        The results, which are read when they are needed.
    """
    plain = xarray.open_zarr(str(path), consolidated=False, chunks=None)
    plan = read_plan(path)
    names = [array_name(name) for name in (*plan["vary"], *plan["outputs"])]
    coords, variables = _sorted(plain.coords, names), _sorted(plain.data_vars, names)
    result = SweepResult(variables, coords, plain.attrs)
    result.encoding = {**plain.encoding, _SOURCE: str(path), _JOB: job}
    return result


def _sorted(values: Mapping[Hashable, Any], names: Iterable[str]) -> dict[Hashable, Any]:
    """Return values by name, those with the given names first."""
    return {name: values[name] for name in (*names, *values) if name in values}
