"""The cost of forces that see the base, paired with the same kernel without any force.

A torque at every joint and a wrench, each by the attitude and the twist of the base: damping and a
pull towards a pose.  The torque needs nothing more to be integrated, a wrench momentum and the
path of the centre of mass.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from ...common.progress import Progress, one_by_one
from ...forces import SeenState, Torque, Wrench
from ...forces.force_model import ForceModel
from ...kernels.build import build_kernel
from ...kernels.kernel import Kernel
from ...kernels.layout import Structure
from ...system.catalogue import has_example_robots
from ...system.load import load
from ...system.system import System
from .timing import alternating, evaluations

BUNDLED = ("planar_chain5", "satellite_two_arms")
EXAMPLES = ("solo12", "talos")
_ROUNDS, _SPAN = 400, 5e-4  # s; short, so that some of them are not interrupted


@dataclass(frozen=True)
class ForcesTiming:
    """The cost of a kernel, each the fastest of many rounds in which all took turns.

    free: µs an evaluation without forces.  torque, wrench, full: ratios to it, of a torque that
    sees attitude and angular velocity, a constant wrench, and one that sees pose and twist.
    numbers: (4,) that are integrated.
    """

    robot: str
    free: float
    torque: float
    wrench: float
    full: float
    numbers: tuple[int, ...]

    @staticmethod
    def header() -> str:
        """Return the head of the table."""
        return (
            f"{'robot':<20} {'free [µs]':>10} {'torque, attitude':>17} {'wrench':>8} "
            f"{'wrench, pose and twist':>23}   integrated"
        )

    def __str__(self) -> str:
        return (
            f"{self.robot:<20} {self.free:>10.3f} {self.torque:>17.3f} {self.wrench:>8.3f} "
            f"{self.full:>23.3f}   {', '.join(map(str, self.numbers))}"
        )


def bench_forces(
    robots: Sequence[str] = (), *, progress: Progress | bool | None = None
) -> list[ForcesTiming]:
    """Return what forces that see the base cost with each robot.

    robots: names or files; four by default.  progress: as for `simulate`.
    """
    names = list(robots) or [*BUNDLED, *(EXAMPLES if has_example_robots() else ())]
    return one_by_one(names, _bench, progress, "forces")


def _bench(name: str) -> ForcesTiming:
    system = load(name, gravity=(0.0, 0.0, 0.0))
    kernels = [_kernel(system, force) for force in (None, *_forces(system))]
    times = alternating([evaluations(kernel) for kernel in kernels], rounds=_ROUNDS, span=_SPAN)
    # A few percent show only where nothing else ran: the fastest of many rounds each.
    fastest = times.min(axis=0)
    torque, wrench, full = (fastest[1:] / fastest[0]).tolist()
    numbers = tuple(kernel.layout.size for kernel in kernels)
    return ForcesTiming(name, float(fastest[0]) * 1e6, torque, wrench, full, numbers)


def _kernel(system: System, force: Any) -> Kernel:
    # All joints are active, whether something acts on them or not.
    forces = None if force is None else ForceModel(system, [force], {})
    return build_kernel(system, Structure(zero_momentum=False), forces)


def _forces(system: System) -> list[Torque | Wrench]:
    group, r, k = system.group, system.r, system.group.linear

    def turning(s: SeenState) -> tuple[list[ca.SX], list[ca.SX]]:
        attitude = ca.vertsplit(s.pose)[k:][: r - k]
        return attitude, ca.vertsplit(s.xi)[k:]

    def torque(s: SeenState) -> dict[str, ca.SX]:
        attitude, omega = turning(s)
        pull = [-2.0 * a - 0.3 * w for a, w in zip(attitude, omega, strict=True)]
        return {name: pull[j % len(pull)] for j, name in enumerate(system.shape_names)}

    def wrench(s: SeenState) -> ca.SX:
        attitude, omega = turning(s)
        place, velocity = ca.vertsplit(s.pose)[:k], ca.vertsplit(s.xi)[:k]
        both = zip([*place, *attitude], [*velocity, *omega], strict=True)
        column: ca.SX = ca.vertcat(*(-0.5 * a - 0.3 * b for a, b in both))
        return column

    steady: Callable[..., list[float]] = lambda *_: [0.1] * group.dim  # noqa: E731
    return [Torque(torque), Wrench(steady), Wrench(wrench)]
