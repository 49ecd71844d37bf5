"""SweepJob: the inputs of the blocks of a sweep, and the computation of a block."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil

import numpy as np
from numpy.typing import NDArray

from ..common.arrays import Array, whole
from ..common.errors import LoopWarning, ShapeError
from ..common.machine_code import cpu_target
from ..common.names import quoted
from ..scene.scene import Scene
from ..simulation.members.member_options import MemberOptions, separate_all_rejected
from ..simulation.members.trajectories import Trajectories
from ..simulation.simulate_many import run_members, simulate_many
from ..simulation.trajectory import Trajectory
from ..system.state_fields import axis_lengths
from .distributions import PointSequence
from .sweep_outputs import Output
from .varied_numbers import VariedScene

# Status of a point in the store.
MISSING, DONE, FAILED, REJECTED = 0, 1, 2, 3
# Size of the states of members that are computed together [bytes].
_MOST_BYTES, _MOST_BYTES_OF_DEVICES = 2**25, 2**30


@dataclass(frozen=True)
class Block:
    """The results of consecutive points.

    Attributes:
        index: Index of the block.
        values: Values of the varied numbers, (n, number of them).
        outputs: Outputs by name, (n, …); a function is missing if all points are rejected.
        status: Status of each point, (n,).
        reasons: Reason of each point that failed or was rejected, {index of the point: text}.
        cpu: CPU for which the machine code was compiled, or the kind of device.
    """

    index: int
    values: Array
    outputs: dict[str, Array]
    status: NDArray[np.uint8]
    reasons: dict[int, str]
    cpu: str


@dataclass(frozen=True, eq=False)
class SweepJob:
    """A sweep without its store; it can be pickled.

    Attributes:
        varied: The scene and the numbers that vary.
        sequence: The values of these numbers at all points.
        outputs: The outputs.
        block: Number of points of a block.
    """

    varied: VariedScene
    sequence: PointSequence
    outputs: tuple[Output, ...]
    block: int

    @property
    def points(self) -> int:
        """Number of points."""
        return self.sequence.points

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return ceil(self.points / self.block)

    def span(self, index: int) -> tuple[int, int]:
        """Return the first point of a block, and the index after its last point."""
        return index * self.block, min((index + 1) * self.block, self.points)

    def values(self, first: int, last: int) -> Array:
        """Return the values of the varied numbers at points first … last − 1."""
        return self.sequence.values(first, last)

    def trajectory(self, point: int) -> Trajectory:
        """Simulate one point at the report times of the scene.

        Args:
            point: Index of the point.
        Returns:
            Its trajectory.
        Raises:
            InputError: There is no such point, or its values are rejected.
        """
        point = whole(point, "point", 0, self.points - 1)
        members, seeds = self.varied.member_values(self.values(point, point + 1))
        many = simulate_many(self.varied.scene, members=members, seeds=seeds, invalid="raise")
        return many[0]

    @cached_property
    def _varied_scene(self) -> VariedScene:
        """The scene with as few report times as the outputs need."""
        if any(output.over_time for output in self.outputs):
            return self.varied
        scene = self.varied.scene
        short = VariedScene(scene, [])
        short.scene = replace(scene, duration=scene.end, times=scene.report_times[-1:])
        short.numbers = self.varied.numbers
        return short

    @cached_property
    def _template(self) -> Scene:
        """The scene of all points, prepared once."""
        varied = self._varied_scene
        members, seeds = varied.member_values(varied.nominal_values()[None])
        return MemberOptions(varied.scene, {}, members, seeds).template()

    def _members_of(self, size: int) -> int:
        """Return the number of points whose states have a size [bytes]."""
        scene = self._varied_scene.scene
        numbers = 3 * sum(axis_lengths(scene.system).values()) * len(scene.report_times)
        return max(1, size // (8 * numbers))

    def compute(
        self,
        index: int,
        threads: int | None,
        device: str | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> Block:
        """Compute a block.

        Args:
            index: Index of the block.
            threads: Number of threads; as many as processors if None.
            device: "cuda" for CUDA devices, None for the CPU.
            progress: Called with the completed fraction of the block.
        Returns:
            The results.
        """
        first, last = self.span(index)
        values = self.values(first, last)
        status = np.full(last - first, DONE, dtype=np.uint8)
        reasons: dict[int, str] = {}
        blocks: list[dict[str, Array] | None] = []
        together = self._members_of(_MOST_BYTES if device is None else _MOST_BYTES_OF_DEVICES)
        starts = range(0, last - first, together)
        for start in starts:
            points_together = values[start : start + together]
            with warnings.catch_warnings():
                if first + start:  # The first points have shown the warnings about open loops.
                    warnings.simplefilter("ignore", LoopWarning)
                many, rejected = self._simulate(points_together, threads, device)
            for failure in many.failures:
                place = start + failure.member
                status[place] = REJECTED if failure.member in rejected else FAILED
                reasons[first + place] = failure.reason
            blocks.append(None if len(rejected) == len(points_together) else self._outputs_of(many))
            if progress is not None:
                progress((start + len(points_together)) / (last - first))
        outputs = _joined(blocks, [len(values[s : s + together]) for s in starts])
        return Block(index, values, outputs, status, reasons, device or cpu_target().name)

    def _simulate(
        self, values: Array, threads: int | None, device: str | None
    ) -> tuple[Trajectories, set[int]]:
        varied = self._varied_scene
        members, seeds = varied.member_values(values)
        options = MemberOptions(varied.scene, {}, members, seeds)
        options.prepared = self._template
        resolved, rejected = separate_all_rejected(options)
        many = run_members(resolved, threads, None, rejected, device)
        return many, {failure.member for failure in rejected}

    def _outputs_of(self, many: Trajectories) -> dict[str, Array]:
        fields = many.fields(sorted({output.field for output in self.outputs if output.field}))
        return {output.name: output.read(fields, many) for output in self.outputs}


def check_row_shape(name: str, known: tuple[int, ...], shape: tuple[int, ...]) -> None:
    """Raise a ShapeError if the rows of an output have another shape than earlier rows."""
    if shape != known:
        raise ShapeError(
            f"outputs: expected rows of one shape from the function of {quoted(name)}, got "
            f"{known} for some points and {shape} for others"
        )


def _joined(parts: list[dict[str, Array] | None], counts: list[int]) -> dict[str, Array]:
    """Join the outputs of parts; the outputs of parts without valid points are NaN."""
    shapes: dict[str, tuple[int, ...]] = {}
    for block in parts:
        for name, values in (block or {}).items():
            check_row_shape(name, shapes.setdefault(name, values.shape[1:]), values.shape[1:])
    return {
        name: np.concatenate([
            np.full((count, *shape), np.nan) if block is None else block[name]
            for block, count in zip(parts, counts, strict=True)
        ])
        for name, shape in shapes.items()
    }  # fmt: skip
