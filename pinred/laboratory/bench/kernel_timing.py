"""Time of an evaluation of a kernel: against `pin.aba`, with forces, and for long chains."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from ...common.argument_kinds import checks_arguments
from ...common.errors import InputError
from ...common.waiting import Progress, one_by_one, quiet, shown
from ...forces import SeenState, Torque, Wrench
from ...forces.force_model import ForceModel
from ...kernels.build import build_kernel
from ...kernels.kernel import Kernel, Structure
from ...reduction.cyclic_joints import cyclic_joints
from ...reduction.pointwise_reduction import PointwiseReduction
from ...system.load import load
from ...system.system import System
from .problems import FAMILIES, chain
from .timing import (
    ROUNDS,
    NoCache,
    Table,
    alternating,
    evaluations,
    fastest,
    repeated,
    robots_to_measure,
)

_BUNDLED = ("coupled_planar", "planar_chain5", "falling_cat", "satellite_two_arms")
_EXAMPLES = ("ur5", "solo12", "talos")


@checks_arguments
def bench_kernels(robots: Sequence[str] = (), *, progress: Progress | bool | None = None) -> Table:
    """Measure the cost of each robot's kernel, with momentum and without forces.

    Args:
        robots: Names or files; four bundled robots and, if installed, ur5, solo12 and talos by
            default.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        A row for each robot: its number of joints, the instructions of the CasADi graph, the time
        from the model to the address of machine code [s], the time of an evaluation of the kernel
        and of `pin.aba` called from Python [µs], and the ratio of these two.
    """
    names = robots_to_measure(robots, _BUNDLED, _EXAMPLES)
    rows = tuple(one_by_one(names, _bench_kernel, progress, "kernels"))
    return Table("kernels", rows, {"build": "s", "kernel": "µs", "pin_aba": "µs"})


def _bench_kernel(name: str) -> SimpleNamespace:
    system = load(name, group="SE3" if name == "ur5" else None, gravity=(0.0, 0.0, 0.0))
    kernel, build = _build(system)
    rng = np.random.default_rng(0)
    model, data = system.model, system.model.createData()
    q = system.q(system.group.identity(), rng.normal(size=system.m))
    v = system.joint_rates(rng.normal(size=system.n))
    tau = np.zeros(model.nv)
    actions = [evaluations(kernel), repeated(lambda: pin.aba(model, data, q, v, tau))]
    own, aba = (1e6 * np.median(alternating(actions), axis=0)).tolist()
    return SimpleNamespace(
        robot=name, joints=system.m, instructions=kernel.instructions, build=build, kernel=own,
        pin_aba=aba, ratio=aba / own,
    )  # fmt: skip


def _build(system: System) -> tuple[Kernel, float]:
    """Build the kernel with momentum and without forces; return it and the time [s]."""
    began = time.perf_counter()
    structure = Structure(zero_momentum=False, cyclic=cyclic_joints(PointwiseReduction(system)))
    kernel = build_kernel(system, structure, cache=NoCache())
    return kernel, time.perf_counter() - began


_MANY, _SHORT = 400, 5e-4  # many short rounds [s], so that some are not interrupted


@checks_arguments
def bench_forces(robots: Sequence[str] = (), *, progress: Progress | bool | None = None) -> Table:
    """Measure the cost of forces that depend on the base, for each robot.

    Args:
        robots: Names or files; two bundled robots and, if installed, solo12 and talos by default.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        A row for each robot: the time of an evaluation without forces [µs]; the ratios to it with
        torques that depend on attitude and angular velocity, with a constant wrench, and with a
        wrench that depends on pose and twist; the numbers of integrated states of the four kernels.
    """
    rows = one_by_one(robots_to_measure(robots), _bench_forces, progress, "forces")
    return Table("forces", tuple(rows), {"free": "µs"})


def _bench_forces(name: str) -> SimpleNamespace:
    system = load(name, gravity=(0.0, 0.0, 0.0))
    kernels = [_kernel(system, force) for force in (None, *_forces(system))]
    # A few percent can only be measured in rounds that the operating system does not interrupt.
    free, *others = fastest([evaluations(k) for k in kernels], rounds=_MANY, span=_SHORT)
    torque, wrench, full = (seconds / free for seconds in others)
    return SimpleNamespace(
        robot=name, free=1e6 * free, torque=torque, wrench=wrench, full=full,
        integrated=", ".join(str(kernel.layout.size) for kernel in kernels),
    )  # fmt: skip


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
def bench_scaling(
    joints: Sequence[int] = JOINTS,
    *,
    rounds: int = ROUNDS,
    progress: Progress | bool | None = None,
) -> list[Table]:
    """Measure the costs of planar and spatial chains.

    Args:
        joints: Increasing numbers of joints.
        rounds: Number of rounds, of which the median is reported.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        A table for each family, with a row for each chain: its number of joints, the instructions
        of the CasADi graph, the time from System to machine code [s], and the time of an evaluation
        with momentum and without forces, in total [µs] and for each joint [ns].
    Raises:
        InputError: `joints` is empty or not increasing.
    """
    if not joints or (np.diff(joints) <= 0).any():
        raise InputError(f"joints must be increasing numbers, got {tuple(joints)}")
    with shown(progress, "scaling") as bar:
        cases = [(family, n) for family in FAMILIES for n in joints]
        kernels, builds = zip(*(_build(chain(*case)) for case in cases), strict=True)
        actions = [evaluations(kernel) for kernel in kernels]
        times = alternating(actions, rounds=rounds, progress=bar or quiet)
    medians = np.median(times, axis=0)
    rows = [
        SimpleNamespace(
            joints=n, instructions=kernel.instructions, build=build,
            kernel=1e6 * seconds, per_joint=1e9 * seconds / n,
        )
        for (_, n), kernel, build, seconds in zip(cases, kernels, builds, medians, strict=True)
    ]  # fmt: skip
    count = len(joints)
    return [scaling_table(name, rows[k * count :][:count]) for k, name in enumerate(FAMILIES)]


def scaling_table(family: str, rows: Sequence[SimpleNamespace]) -> Table:
    """Return the table of one family of chains, with the exponents of the number of joints."""
    long = [row for row in rows if row.joints >= LONG]
    notes: tuple[str, ...] = ()
    if len(long) > 1:
        x = np.log([row.joints for row in long])
        costs = [(row.kernel, row.instructions) for row in long]
        time_slope, instruction_slope = np.polyfit(x, np.log(costs), 1)[0]
        notes = (
            f"from {LONG} joints on, time grows with their number to the power {time_slope:.2f}, "
            f"instructions {instruction_slope:.2f}",
        )
    units = {"build": "s", "kernel": "µs", "per_joint": "ns"}
    return Table("scaling", tuple(rows), units, f"{family} chain", notes, {"family": family})
