"""Time of an evaluation of a compiled kernel, against `pin.aba` called from Python."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...common.argument_kinds import checks_arguments
from ...common.progress import Progress, one_by_one
from ...kernels.build import build_kernel
from ...kernels.state_layout import Structure
from ...reduction.cyclic_joints import cyclic_joints
from ...reduction.pointwise_reduction import PointwiseReduction
from ...system.catalogue import has_example_robots
from ...system.load import load
from .timing import NoCache, alternating, evaluations, repeated

BUNDLED = ("coupled_planar", "planar_chain5", "falling_cat", "satellite_two_arms")
EXAMPLES = ("ur5", "solo12", "talos")


@checks_arguments
@dataclass(frozen=True)
class KernelTiming:
    """Cost of the kernel of one robot.

    Attributes:
        robot: Name of the robot.
        joints: Number of joints m.
        instructions: Number of instructions of the CasADi graph.
        build: Time from the model to the address of machine code [s].
        kernel: Time of an evaluation of the kernel [µs].
        aba: Time of an evaluation of `pin.aba` from Python [µs].
    """

    robot: str
    joints: int
    instructions: int
    build: float
    kernel: float
    aba: float

    @property
    def ratio(self) -> float:
        """Time of `pin.aba` called from Python divided by the time of the kernel."""
        return self.aba / self.kernel

    @staticmethod
    def header() -> str:
        """Return the header of the table."""
        return (
            f"{'robot':<20} {'joints':>6} {'instructions':>12} {'build [s]':>10} "
            f"{'kernel [µs]':>12} {'pin.aba [µs]':>13} {'ratio':>7}"
        )

    def __str__(self) -> str:
        return (
            f"{self.robot:<20} {self.joints:>6} {self.instructions:>12} {self.build:>10.3f} "
            f"{self.kernel:>12.4f} {self.aba:>13.2f} {self.ratio:>7.1f}"
        )


@checks_arguments
def bench_kernels(
    robots: Sequence[str] = (), *, progress: Progress | bool | None = None
) -> list[KernelTiming]:
    """Measure the cost of each robot's kernel, with momentum and without forces.

    Args:
        robots: Names or files; four bundled robots and, if installed, ur5, solo12 and talos by
            default.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        One result for each robot.
    """
    names = list(robots) or [*BUNDLED, *(EXAMPLES if has_example_robots() else ())]
    return one_by_one(names, _bench_kernel, progress, "kernels")


def _bench_kernel(name: str) -> KernelTiming:
    system = load(name, group="SE3" if name == "ur5" else None, gravity=(0.0, 0.0, 0.0))
    structure = Structure(zero_momentum=False, cyclic=cyclic_joints(PointwiseReduction(system)))
    began = time.perf_counter()
    kernel = build_kernel(system, structure, cache=NoCache())
    build = time.perf_counter() - began
    rng = np.random.default_rng(0)
    model, data = system.model, system.model.createData()
    q = system.q(system.group.identity(), rng.normal(size=system.m))
    v = system.joint_rates(rng.normal(size=system.n))
    tau = np.zeros(model.nv)

    times = alternating([evaluations(kernel), repeated(lambda: pin.aba(model, data, q, v, tau))])
    return KernelTiming(
        robot=name,
        joints=system.m,
        instructions=kernel.instructions,
        build=build,
        kernel=float(np.median(times[:, 0])) * 1e6,
        aba=float(np.median(times[:, 1])) * 1e6,
    )
