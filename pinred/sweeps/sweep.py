"""sweep(): many points of one scene, computed in blocks and stored in a zarr folder."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..common.argument_kinds import checks_arguments
from ..common.arrays import whole
from ..common.errors import (
    InputError,
    RejectedWarning,
    install_command,
    optional_package,
    require_package,
)
from ..common.files import import_zarr, is_folder
from ..common.names import brief, nearest, one_of, quoted, quoted_path
from ..common.waiting import Progress, say, shown
from ..scene.scene import Scene
from ..scene.scene_options import BLOCK, SAMPLERS, Sampler
from ..simulation.plan import Group, members_plan, refuse_with_stops
from ..simulation.simulate_many import check_device
from .distributions import (
    MOST_SOBOL,
    Distribution,
    Listed,
    PointSequence,
    grid_size,
    parse_distribution,
)
from .sweep_job import FAILED, REJECTED, Block, SweepJob
from .sweep_outputs import Outputs, parse_outputs
from .sweep_store import SweepStore, read_plan
from .varied_numbers import VariedScene

if TYPE_CHECKING:
    from .sweep_result import SweepResult


Report = Callable[[float], None]


class PointsDone:
    """The completed fraction of the points of a sweep.

    Attributes:
        start: The fraction that was complete at the start.
    """

    def __init__(self, job: SweepJob, pending: Sequence[int], report: Report | None) -> None:
        """Start from the blocks that are complete.

        Args:
            job: The sweep.
            pending: Indices of the other blocks.
            report: Called with the completed fraction, or None.
        """
        self._job, self._report = job, report
        self._done = job.points - sum(self._size(index) for index in pending)
        self.start = self._done / job.points

    @property
    def count(self) -> int:
        """Number of points whose blocks are stored."""
        return self._done

    def _size(self, index: int) -> int:
        first, last = self._job.span(index)
        return last - first

    def inside(self, index: int, part: float) -> None:
        """Report the completed fraction of a block that is not yet stored."""
        if self._report is not None:
            self._report((self._done + part * self._size(index)) / self._job.points)

    def finished(self, index: int) -> None:
        """Report that a block is stored."""
        self._done += self._size(index)
        self.inside(index, 0.0)


_NO_XARRAY = f"sweeps need the package xarray: {install_command('sweep')}"


@checks_arguments
def sweep(
    scene: Scene,
    vary: Mapping[str, Any],
    *,
    points: int | None = None,
    sampler: Sampler | None = None,
    seed: int = 0,
    outputs: Mapping[str, Any] | Sequence[str] | None = None,
    store: str | Path | None = None,
    scheduler: Any = None,
    block: int = BLOCK,
    threads: int | None = None,
    device: Literal["cuda"] | None = None,
    progress: Progress | bool | None = None,
) -> SweepResult:
    """Simulate many points of a scene, in blocks that are stored as soon as they are complete.

    A sweep that was interrupted continues when it is called again with the same store.  Blocks of
    the store that are damaged are computed again, with a StoreWarning.  All numbers are independent
    of interruptions, threads and workers.  A point whose values are rejected, such as a negative
    mass, or whose integration fails, has NaN as outputs and is listed in `failures`.

    Args:
        scene: The scene, which states all numbers that do not vary.
        vary: Distributions by name: {"base.mass": Uniform(0.5, 2), "x0.bend": Grid(-1, 1, 50),
            "gain": Normal(1, 0.1)}.  Names are those of Parameters, of parameters of the robot, of
            entries of the initial state and of vectors, and of numbers in springs, forces and
            prescribed joints (see docs/sweeps.md).  A distribution may be text; a list of numbers
            is short for Values.
        points: Number of points; by default, all points of the grid.
        sampler: "sobol", "latin", "random", or "grid" for all combinations of Grid and Values.
            Default: "grid" without points, else "sobol".
        seed: Seed of the sampler.
        outputs: {name: field or function}, or a list of fields.  "pose" is the pose at the last
            report time, "pose.θ" an entry of it, and "pose(t)" the pose at all report times;
            "turn", "position(FRAME)", "peak_torque" and "excursion" are others.  A
            function takes the Trajectories of many points and returns one row for each.  Default:
            x, xdot, pose and energy.
        store: Path of the zarr folder of the results; by default, a temporary folder, which is
            kept until the process ends.
        scheduler: Address of a Dask scheduler, or a dask.distributed.Client, whose workers compute
            the blocks; by default, threads of this process do.
        block: Number of points of a block.
        threads: Number of local threads; as many as processors if None.
        device: "cuda" to integrate on CUDA devices, as in `simulate_many`; those of the workers
            with a scheduler.  None for the CPU.
        progress: As in `simulate`, but called with the completed fraction of the points.
    Returns:
        The results, an xarray.Dataset.
    Raises:
        InputError: An argument is invalid, or the store belongs to another sweep.
        DeviceError: There is no device that can run the code, or it reports an error.
        MissingPackageError: zarr, xarray or dask, or what a device needs, is not installed.
    """
    job = _job(scene, vary, points, sampler, seed, outputs, block)
    if device is not None:
        plan = members_plan(job.varied.scene)
        check_device(
            device, threads, [Group(np.broadcast_to(0, job.points), plan, plan.scene.given)]
        )
    path = Path(_temporary_folder() if store is None else store)
    if path.suffix != ".zarr" or not is_folder(path.parent):
        raise InputError(
            f"store: expected a name that ends in .zarr in an existing folder, got "
            f"{quoted_path(path)}"
        )
    import_zarr(path, "sweep")
    # xarray and pandas take 60 MB, so they are imported when the blocks are stored.
    require_package("xarray", _NO_XARRAY)
    title = f"sweep of {job.varied.scene.system.name}"
    with (
        SweepStore(path, job) as results,
        shown(progress, title, job.points, "points", f"computes a {title}", reports=True) as report,
    ):
        pending = results.pending()
        done = PointsDone(job, pending, report)
        if done.start and pending and progress is not False:
            say(f"{title}: continuing at {done.count:,} of {job.points:,} points")
        done.inside(0, 0.0)
        for computed in _blocks(job, pending, scheduler, threads, device, done):
            results.write(computed)
            done.finished(computed.index)
    from .sweep_result import open_result

    result = open_result(path, job)
    _warn_of_failures(result)
    return result


@checks_arguments
def open_sweep(store: str | Path) -> SweepResult:
    """Open the results of a sweep without its scene.

    Args:
        store: Path of the zarr folder.
    Returns:
        The results, an xarray.Dataset.  Its method `point` reads the scene from a store that the
        same user has written.  Reading a damaged block raises a LoadError.
    Raises:
        InputError: The folder is not the store of a sweep.
        LoadError: A file that describes the store is missing or damaged.
        MissingPackageError: zarr or xarray is not installed.
    """
    path = Path(store)
    read_plan(path)
    import_zarr(path, "sweep")
    require_package("xarray", _NO_XARRAY)
    from .sweep_result import open_result

    return open_result(path, None)


def _job(
    scene: Scene,
    vary: Mapping[str, Any],
    points: int | None,
    sampler: Sampler | None,
    seed: int,
    outputs: Outputs | None,
    block: int,
) -> SweepJob:
    """Check the arguments of `sweep`."""
    if not vary:
        raise InputError("vary: expected at least one number with its distribution")
    laws = tuple(parse_distribution(value, key) for key, value in vary.items())
    _check_seeds(vary, laws)
    chosen: Sampler = sampler or ("grid" if points is None else "sobol")
    if not one_of(chosen, SAMPLERS):
        raise InputError(
            f"sampler: expected one of {', '.join(SAMPLERS)}, got {brief(chosen)}; "
            f"{nearest(str(chosen), SAMPLERS)}".rstrip("; ")
        )
    if chosen == "grid":
        for key, law in zip(vary, laws, strict=True):
            if not isinstance(law, Listed):
                raise InputError(
                    f"points: expected a number of points, because {quoted(key)} has no list of "
                    "values. Without points, give a Grid or Values for each number"
                )
        if points not in (None, grid_size(laws)):
            raise InputError(
                f"points: the grid has {grid_size(laws)} points, got {points}. Omit points, or "
                "choose another sampler"
            )
        points = grid_size(laws)
    if points is None:
        raise InputError(f"points: the sampler {chosen} needs a number of points")
    count = whole(points, "points", 1)
    if chosen == "sobol" and count > MOST_SOBOL:
        raise InputError(f"points: the sampler sobol has {MOST_SOBOL} points; use sampler='random'")
    varied = VariedScene(scene, list(vary))
    # All points have one method, which does not depend on the first point of a block.
    if varied.scene.method == "auto":
        varied.scene = replace(varied.scene, method=members_plan(varied.scene).method.name)
    if varied.scene.bounds:
        refuse_with_stops(members_plan(varied.scene), checkpoint=False)
    sequence = PointSequence.of(chosen, laws, count, whole(seed, "seed", 0))
    size = min(whole(block, "block", 1), count)  # Chunks have the size of a block.
    return SweepJob(varied, sequence, parse_outputs(varied.scene, outputs), size)


def _check_seeds(vary: Mapping[str, Any], laws: Sequence[Distribution]) -> None:
    """Check that the values of `seed` are listed whole numbers."""
    for key, law in zip(vary, laws, strict=True):
        if key != "seed":
            continue
        seeds = law.listed if isinstance(law, Listed) else np.array([-1.0])
        if ((seeds < 0.0) | (seeds >= 2.0**53) | (seeds % 1.0 > 0.0)).any():
            raise InputError(
                f"vary: 'seed': expected a list of whole numbers of at least 0, such as "
                f"range(100), got {brief(vary[key])}"
            )


def _blocks(
    job: SweepJob,
    pending: list[int],
    scheduler: Any,
    threads: int | None,
    device: str | None,
    done: PointsDone,
) -> Iterator[Block]:
    """Compute blocks on threads and in SIMD lanes, or on the workers of a scheduler."""
    if scheduler is None:
        return (job.compute(k, threads, device, partial(done.inside, k)) for k in pending)
    optional_package(
        "distributed", f"scheduler: this needs dask.distributed: {install_command('dask')}"
    )
    from .dask_engine import compute_on_dask

    return compute_on_dask(job, pending, scheduler, device)


_KEPT: list[tempfile.TemporaryDirectory[str]] = []


def _temporary_folder() -> Path:
    """Return a path in a new folder, which is removed when the process ends."""
    folder = tempfile.TemporaryDirectory(prefix="pinred-sweep-")
    _KEPT.append(folder)
    return Path(folder.name) / "sweep.zarr"


def _warn_of_failures(result: SweepResult) -> None:
    """Warn once that some points were rejected or failed."""
    status = result["status"].values
    counts = {name: int((status == k).sum()) for name, k in _KINDS.items()}
    if not any(counts.values()):
        return
    first = result.failures[0]
    words = " and ".join(f"{count} {name}" for name, count in counts.items() if count)
    warnings.warn(
        f"{words} of {len(status)} points, listed in `failures`; the first is point "
        f"{first.member}: {first.reason.rstrip('.')}.",
        RejectedWarning,
        stacklevel=4,
    )


_KINDS = {"rejected": REJECTED, "failed": FAILED}
