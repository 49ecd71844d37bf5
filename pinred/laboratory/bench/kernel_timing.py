"""Time of an evaluation of a kernel: against `pin.aba`, with forces, and for long chains."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays
from ...common.errors import InputError
from ...common.waiting import Progress, one_by_one, quiet, shown
from ...forces import SeenState, Torque, Wrench
from ...forces.force_model import ForceModel
from ...kernels.build import build_kernel
from ...kernels.kernel import Kernel
from ...kernels.state_layout import Structure
from ...reduction.cyclic_joints import cyclic_joints
from ...reduction.pointwise_reduction import PointwiseReduction
from ...system.load import load
from ...system.system import System
from .problems import FAMILIES, chain
from .timing import (
    ROUNDS,
    NoCache,
    Tables,
    TimingRow,
    alternating,
    evaluations,
    fastest,
    repeated,
    robots_to_measure,
)

_BUNDLED = ("coupled_planar", "planar_chain5", "falling_cat", "satellite_two_arms")
_EXAMPLES = ("ur5", "solo12", "talos")


@checks_arguments
@dataclass(frozen=True)
class KernelTiming(TimingRow):
    """Cost of the kernel of one robot.

    Attributes:
        robot: Name of the robot.
        joints: Number of joints m.
        instructions: Number of instructions of the CasADi graph.
        build: Time from the model to the address of machine code [s].
        kernel: Time of an evaluation of the kernel [µs].
        aba: Time of an evaluation of `pin.aba` from Python [µs].
    """

    ROW = (
        "{robot:<20} {joints:>6} {instructions:>12} {build:>10.3f} {kernel:>12.4f} {aba:>13.2f} "
        "{ratio:>7.1f}"
    )
    TITLES: ClassVar[Mapping[str, str]] = {
        "build": "build [s]",
        "kernel": "kernel [µs]",
        "aba": "pin.aba [µs]",
    }
    FILE = "kernels"

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

    def tables(self) -> Tables:
        """Return the row of the csv file, with the ratio."""
        return {self.FILE: [{**vars(self), "ratio": self.ratio}]}


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
    names = robots_to_measure(robots, _BUNDLED, _EXAMPLES)
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


_MANY, _SHORT = 400, 5e-4  # many short rounds [s], so that some are not interrupted


@checks_arguments
@dataclass(frozen=True)
class ForcesTiming(TimingRow):
    """Cost of kernels with forces: the fastest of many alternating rounds.

    Attributes:
        robot: Name of the robot.
        free: Time of an evaluation without forces [µs].
        torque: Ratio to `free` with torques that depend on attitude and angular velocity.
        wrench: Ratio to `free` with a constant wrench.
        full: Ratio to `free` with a wrench that depends on pose and twist.
        numbers: Number of integrated states of each of the four kernels.
    """

    ROW = "{robot:<20} {free:>10.3f} {torque:>17.3f} {wrench:>8.3f} {full:>23.3f}   {integrated}"
    TITLES: ClassVar[Mapping[str, str]] = {
        "free": "free [µs]",
        "torque": "torque, attitude",
        "full": "wrench, pose and twist",
    }
    FILE = "forces"

    robot: str
    free: float
    torque: float
    wrench: float
    full: float
    numbers: tuple[int, ...]

    @property
    def integrated(self) -> str:
        """Numbers of integrated states, as text."""
        return ", ".join(map(str, self.numbers))

    def tables(self) -> Tables:
        """Return the row of the csv file, without the numbers of states."""
        names = ("robot", "free", "torque", "wrench", "full")
        return {self.FILE: [{name: getattr(self, name) for name in names}]}


@checks_arguments
def bench_forces(
    robots: Sequence[str] = (), *, progress: Progress | bool | None = None
) -> list[ForcesTiming]:
    """Measure the cost of forces that depend on the base, for each robot.

    Args:
        robots: Names or files; two bundled robots and, if installed, solo12 and talos by default.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        One result for each robot.
    """
    return one_by_one(robots_to_measure(robots), _bench_forces, progress, "forces")


def _bench_forces(name: str) -> ForcesTiming:
    system = load(name, gravity=(0.0, 0.0, 0.0))
    kernels = [_kernel(system, force) for force in (None, *_forces(system))]
    # A few percent can only be measured in rounds that the operating system does not interrupt.
    free, *others = fastest([evaluations(k) for k in kernels], rounds=_MANY, span=_SHORT)
    torque, wrench, full = (seconds / free for seconds in others)
    numbers = tuple(kernel.layout.size for kernel in kernels)
    return ForcesTiming(name, free * 1e6, torque, wrench, full, numbers)


def _kernel(system: System, force: Any) -> Kernel:
    # A kernel skips cyclic joints without forces. For comparison, all kernels integrate all joints.
    forces = None if force is None else ForceModel(system, [force], {})
    return build_kernel(system, Structure(zero_momentum=False), forces)


def _forces(system: System) -> list[Torque | Wrench]:
    group, r, k = system.group, system.r, system.group.linear

    def rotation_of(s: SeenState) -> tuple[list[ca.SX], list[ca.SX]]:
        attitude = ca.vertsplit(s.pose)[k:][: r - k]
        return attitude, ca.vertsplit(s.xi)[k:]

    def torque(s: SeenState) -> dict[str, ca.SX]:
        attitude, omega = rotation_of(s)
        torques = [-2.0 * a - 0.3 * w for a, w in zip(attitude, omega, strict=True)]
        return {name: torques[j % len(torques)] for j, name in enumerate(system.shape_names)}

    def wrench(s: SeenState) -> ca.SX:
        attitude, omega = rotation_of(s)
        position, velocity = ca.vertsplit(s.pose)[:k], ca.vertsplit(s.xi)[:k]
        pairs = zip([*position, *attitude], [*velocity, *omega], strict=True)
        components: ca.SX = ca.vertcat(*(-0.5 * a - 0.3 * b for a, b in pairs))
        return components

    constant: Callable[..., list[float]] = lambda *_: [0.1] * group.dim  # noqa: E731
    return [Torque(torque), Wrench(constant), Wrench(wrench)]


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

    def tables(self) -> Tables:
        """Return a row of the csv file for each chain."""
        names = ("joints", "instructions", "build", "kernel")
        columns = zip(*(getattr(self, name) for name in names), strict=True)
        rows = [dict(zip(names, row, strict=True)) for row in columns]
        return {"scaling": [{"family": self.family, **row} for row in rows]}

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
        return _bench_chains(joints, rounds, bar or quiet)


def _bench_chains(joints: Sequence[int], rounds: int, report: Progress) -> list[Scaling]:
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
