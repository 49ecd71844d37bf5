"""Growth of evaluation time and build time of kernels with the number of joints."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays
from ...common.errors import InputError
from ...common.progress import Progress, quiet, shown
from ...kernels.build import build_kernel
from ...kernels.state_layout import Structure
from ...reduction.cyclic_joints import cyclic_joints
from ...reduction.pointwise_reduction import PointwiseReduction
from .chains import FAMILIES, chain
from .timing import ROUNDS, NoCache, alternating, evaluations

JOINTS = (5, 10, 20, 50, 100)
LONG = 20  # smallest number of joints that is included in the fit of the exponent


@checks_arguments
@dataclass(frozen=True)
class Scaling(FrozenArrays):
    """Costs of one family of K chains; arrays are read-only.

    Attributes:
        family: "planar" or "spatial".
        joints: Numbers of joints, (K,).
        instructions: Numbers of instructions of the CasADi graphs, (K,).
        build: Times from System to machine code, including the search for cyclic joints, (K,) [s].
        kernel: Times of an evaluation, with momentum and without forces, (K,) [µs].
    """

    family: str
    joints: NDArray[np.int64]
    instructions: NDArray[np.int64]
    build: Array
    kernel: Array

    @property
    def slope(self) -> float:
        """Exponent of the number of joints in the evaluation time of long chains; 1 is linear."""
        return self._slope(self.kernel)

    @property
    def instructions_slope(self) -> float:
        """Exponent of the number of joints in the instructions of long chains."""
        return self._slope(self.instructions)

    def _slope(self, cost: NDArray[np.float64] | NDArray[np.int64]) -> float:
        long = self.joints >= LONG
        if long.sum() < 2:
            return float("nan")
        return float(np.polyfit(np.log(self.joints[long]), np.log(cost[long]), 1)[0])

    def __str__(self) -> str:
        head = f"{self.family + ' chain':<14} {'joints':>6} {'instructions':>12} {'build [s]':>10} "
        rows = [
            f"{'':<14} {n:>6} {count:>12} {build:>10.3f} {kernel:>12.4f} {1e3 * kernel / n:>13.1f}"
            for n, count, build, kernel in zip(
                self.joints, self.instructions, self.build, self.kernel, strict=True
            )
        ]
        return "\n".join(
            [
                head + f"{'kernel [µs]':>12} {'ns per joint':>13}",
                *rows,
                f"{'':<14} from {LONG} joints on, time grows with their number to the power "
                f"{self.slope:.2f}, instructions {self.instructions_slope:.2f}",
            ]
        )


@checks_arguments
def bench_scaling(
    joints: Sequence[int] = JOINTS,
    *,
    rounds: int = ROUNDS,
    progress: Progress | bool | None = None,
) -> list[Scaling]:
    """Measure the costs of planar and spatial chains.

    Args:
        joints: Increasing numbers of joints.
        rounds: Number of rounds, of which the median is reported.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        One result for each family.
    Raises:
        InputError: `joints` is empty or not increasing.
    """
    if not joints or (np.diff(joints) <= 0).any():
        raise InputError(f"joints must be increasing numbers, got {tuple(joints)}")
    with shown(progress, "scaling") as bar:
        return _measure(joints, rounds, bar or quiet)


def _measure(joints: Sequence[int], rounds: int, report: Progress) -> list[Scaling]:
    cases = [(family, n) for family in FAMILIES for n in joints]
    kernels, builds = [], []
    for k, (family, n) in enumerate(cases):
        system = chain(family, n)
        began = time.perf_counter()
        structure = Structure(zero_momentum=False, cyclic=cyclic_joints(PointwiseReduction(system)))
        kernels.append(build_kernel(system, structure, cache=NoCache()))
        builds.append(time.perf_counter() - began)
        report(0.5 * (k + 1) / len(cases))
    times = alternating(
        [evaluations(kernel) for kernel in kernels],
        rounds=rounds,
        progress=lambda fraction: report(0.5 + 0.5 * fraction),
    )
    medians = np.median(times, axis=0) * 1e6
    results = []
    for k, family in enumerate(FAMILIES):
        members = slice(k * len(joints), (k + 1) * len(joints))
        results.append(
            Scaling(
                family=family,
                joints=np.array(joints),
                instructions=np.array([kernel.instructions for kernel in kernels[members]]),
                build=np.array(builds[members]),
                kernel=medians[members].copy(),
            )
        )
    return results
