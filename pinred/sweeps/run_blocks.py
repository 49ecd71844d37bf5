"""The loop over the blocks of a sweep on this machine, and the progress of all points."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial

from .sweep_job import Block, SweepJob

Report = Callable[[float], None]


def compute_locally(
    job: SweepJob, blocks: Iterable[int], threads: int | None, report: Callable[[int, float], None]
) -> Iterator[Block]:
    """Compute blocks one after another, each on threads and in SIMD lanes.

    Args:
        job: The sweep.
        blocks: Indices of the blocks.
        threads: Number of threads; as many as processors if None.
        report: Called with the index of a block and its completed fraction.
    Yields:
        The results.
    """
    for index in blocks:
        yield job.compute(index, threads, partial(report, index))


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
