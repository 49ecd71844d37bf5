"""Blocks of a sweep on the workers of dask.distributed.

Each worker gets the sweep once, as a plugin, also if it joins or restarts later.  A task contains
only the index of its block.  Workers return arrays, and only the driver writes the store.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from threading import Lock
from typing import Any, cast

import cloudpickle
import distributed

from ..common.errors import InputError, PinredError, __version__
from ..common.names import brief, quoted
from .sweep_job import Block, SweepJob

_AHEAD = 2  # number of tasks in flight for each thread of the workers
_PATIENCE = "20s"  # time to wait for a scheduler


class SweepPlugin(distributed.WorkerPlugin):
    """The sweep that a worker computes, unpickled once.

    Attributes:
        name: Name under which the worker finds the plugin.
    """

    def __init__(self, name: str, job: SweepJob) -> None:
        """Pickle a sweep.

        Args:
            name: Name of the plugin.
            job: The sweep.
        """
        self.name = name
        self._data: bytes = cloudpickle.dumps(job)
        self._job: SweepJob | None = None
        self._lock: Any = None

    def setup(self, worker: Any) -> None:  # noqa: ARG002
        """Prepare the plugin on a worker; called by distributed."""
        self._lock = Lock()

    @property
    def job(self) -> SweepJob:
        """The sweep on this worker."""
        with self._lock:
            if self._job is None:
                self._job = cloudpickle.loads(self._data)
            return self._job


def compute_on_worker(
    name: str, index: int, version: str, device: str | None
) -> tuple[Block | PinredError | None, str]:
    """Compute a block on a worker.

    Args:
        name: Name of the plugin with the sweep.
        index: Index of the block.
        version: Version of pinred on the driver.
        device: "cuda" for the CUDA devices of the worker, None for its CPU.
    Returns:
        The results or an error, and the version of pinred on the worker.  The result is None if
        the versions differ; the sweep of another version is not even unpickled.
    """
    if version != __version__:
        return None, __version__
    plugin: Any = distributed.get_worker().plugins[name]
    try:
        threads = 1 if device is None else None
        return plugin.job.compute(index, threads, device), __version__
    except PinredError as error:  # An error of pinred would occur again on other workers.
        return error, __version__


def compute_on_dask(
    job: SweepJob, blocks: Sequence[int], scheduler: Any, device: str | None = None
) -> Iterator[Block]:
    """Compute blocks on the workers of a scheduler.

    Args:
        job: The sweep.
        blocks: Indices of the blocks.
        scheduler: Address of the scheduler, or a Client.
        device: "cuda" for CUDA devices, None for the CPU.
    Yields:
        The results, in the order in which they arrive.
    Raises:
        InputError: There is no scheduler, or a worker has another version of pinred.
        PinredError: A block cannot be computed.
    """
    if not blocks:
        return
    with _client_of(scheduler) as client:
        name = f"pinred-sweep-{id(job):x}-{client.id}"
        client.register_plugin(SweepPlugin(name, job), name=name)
        waiting = list(reversed(blocks))

        def submit(index: int) -> Any:
            key = f"{name}-{index}"
            arguments = (name, index, __version__, device)
            return client.submit(compute_on_worker, *arguments, key=key, pure=False)

        running: Any = None
        try:
            running = cast("Any", distributed).as_completed(loop=client.loop, with_results=True)
            while waiting or running.count():
                ahead = max(1, _AHEAD * sum(client.nthreads().values()))
                while waiting and running.count() < ahead:
                    running.add(submit(waiting.pop()))
                _, (block, version) = next(running)
                if version != __version__:
                    raise InputError(
                        f"scheduler: a worker has pinred {version}, but the driver has "
                        f"{__version__}. Install one version on all machines"
                    )
                if isinstance(block, PinredError):
                    raise block
                yield block
        finally:
            if running is not None:
                client.cancel(list(running.futures))
            with suppress(Exception):  # The scheduler may have ended.
                client.unregister_worker_plugin(name)


@contextmanager
def _client_of(scheduler: Any) -> Iterator[Any]:
    """Yield a client of a scheduler, and close it unless the caller owns it."""
    if isinstance(scheduler, distributed.Client):
        if scheduler.asynchronous:
            raise InputError("scheduler: expected a Client with asynchronous=False")
        yield scheduler
        return
    if not isinstance(scheduler, str):
        raise InputError(
            "scheduler: expected an address such as 'tcp://host:8786' or a "
            f"dask.distributed.Client, got {brief(scheduler)}"
        )
    try:
        client = cast("Any", distributed).Client(scheduler, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(
            f"scheduler: there is no Dask scheduler at {quoted(scheduler)}: {error}. Start one "
            "with `dask scheduler`, and workers with `dask worker ADDRESS`"
        ) from None
    with client:
        yield client
