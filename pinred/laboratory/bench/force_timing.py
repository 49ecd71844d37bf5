"""Cost of forces that depend on the base, relative to the same kernel without forces.

The forces are a torque at every joint and a wrench. Both depend on the attitude and the twist of
the base: damping, and attraction to a pose. The torque adds no integrated state. The wrench adds
momentum and the path of the centre of mass.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from ...common.argument_kinds import checks_arguments
from ...common.progress import Progress, one_by_one
from ...forces import SeenState, Torque, Wrench
from ...forces.force_model import ForceModel
from ...kernels.build import build_kernel
from ...kernels.kernel import Kernel
from ...kernels.state_layout import Structure
from ...system.catalogue import has_example_robots
from ...system.load import load
from ...system.system import System
from .timing import alternating, evaluations

BUNDLED = ("planar_chain5", "satellite_two_arms")
EXAMPLES = ("solo12", "talos")
_ROUNDS, _SPAN = 400, 5e-4  # many short rounds [s], so that some are not interrupted


@checks_arguments
@dataclass(frozen=True)
class ForcesTiming:
    """Cost of kernels with forces: the fastest of many alternating rounds.

    Attributes:
        robot: Name of the robot.
        free: Time of an evaluation without forces [µs].
        torque: Ratio to `free` with torques that depend on attitude and angular velocity.
        wrench: Ratio to `free` with a constant wrench.
        full: Ratio to `free` with a wrench that depends on pose and twist.
        numbers: Number of integrated states of each of the four kernels.
    """

    robot: str
    free: float
    torque: float
    wrench: float
    full: float
    numbers: tuple[int, ...]

    @staticmethod
    def header() -> str:
        """Return the header of the table."""
        return (
            f"{'robot':<20} {'free [µs]':>10} {'torque, attitude':>17} {'wrench':>8} "
            f"{'wrench, pose and twist':>23}   integrated"
        )

    def __str__(self) -> str:
        return (
            f"{self.robot:<20} {self.free:>10.3f} {self.torque:>17.3f} {self.wrench:>8.3f} "
            f"{self.full:>23.3f}   {', '.join(map(str, self.numbers))}"
        )


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
    names = list(robots) or [*BUNDLED, *(EXAMPLES if has_example_robots() else ())]
    return one_by_one(names, _bench, progress, "forces")


def _bench(name: str) -> ForcesTiming:
    system = load(name, gravity=(0.0, 0.0, 0.0))
    kernels = [_kernel(system, force) for force in (None, *_forces(system))]
    times = alternating([evaluations(kernel) for kernel in kernels], rounds=_ROUNDS, span=_SPAN)
    # A few percent can only be measured in rounds that the operating system does not interrupt.
    fastest = times.min(axis=0)
    torque, wrench, full = (fastest[1:] / fastest[0]).tolist()
    numbers = tuple(kernel.layout.size for kernel in kernels)
    return ForcesTiming(name, float(fastest[0]) * 1e6, torque, wrench, full, numbers)


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
