"""Cost of derivatives: of flows relative to a run, of kernels relative to a rate evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.progress import Progress, one_by_one
from ...integrators.stepping.compiling import compiled
from ...integrators.stepping.kernel_call import SEEDS, call, call_slopes
from ...integrators.stepping.linear_systems import jacobian
from ...kernels.derived_code import tangent_of
from ...kernels.differentiable import repeat_adjoint
from ...kernels.evaluate import repeat
from ...kernels.flow_functions import rate_of
from ...kernels.state_jacobian import jacobian_code
from ...simulation.flow_map.flow import Flow, flow
from ...system.catalogue import has_example_robots
from ...system.load import load
from .timing import alternating, repeated

BUNDLED = ("planar_chain5", "satellite_two_arms")
EXAMPLES = ("solo12", "talos")
_SPAN = 2.0  # duration of the motion [s]
_ROUNDS, _BURST = 100, 1e-3  # many short rounds [s], so that some are not interrupted


@checks_arguments
@dataclass(frozen=True)
class DerivativeTiming:
    """Cost of derivatives of one robot: ratios of the fastest of several alternating rounds.

    Attributes:
        robot: Name of the robot.
        joints: Number of joints.
        jvp: Time of a flow's derivative along one direction, including its run, in runs.
        vjp: Time of a flow's gradient, including its run, in runs.
        direction: Time of the rates with their derivative along one direction, in rates.
        eight: Time of the derivatives along eight directions, in rates.
        adjoint: Time of an adjoint evaluation, in rates.
        jacobian: Time of the state Jacobian by recursion, in rates.
        columns: Time of the state Jacobian by eight columns at once, in rates.
        pinocchio: Time of Pinocchio's computeABADerivatives, in its aba, both called from Python.
    """

    robot: str
    joints: int
    jvp: float
    vjp: float
    direction: float
    eight: float
    adjoint: float
    jacobian: float
    columns: float
    pinocchio: float

    @staticmethod
    def header() -> str:
        """Return the header of the table."""
        names = ("jvp", "vjp", "direction", "eight", "adjoint", "Jacobian", "columns", "Pinocchio")
        units = ("[runs]",) * 2 + ("[rates]",) * 5 + ("[aba]",)
        return "\n".join(
            f"{first:<20} {second:>6} " + " ".join(f"{name:>9}" for name in rest)
            for first, second, rest in (("robot", "joints", names), ("", "", units))
        )

    def __str__(self) -> str:
        ratios = (
            self.jvp, self.vjp, self.direction, self.eight, self.adjoint, self.jacobian,
            self.columns, self.pinocchio,
        )  # fmt: skip
        return f"{self.robot:<20} {self.joints:>6} " + " ".join(f"{one:>9.2f}" for one in ratios)


@checks_arguments
def bench_derivatives(
    robots: Sequence[str] = (), *, progress: Progress | bool | None = None
) -> list[DerivativeTiming]:
    """Measure the cost of each robot's derivatives.

    Args:
        robots: Names or files of robots whose joints are hinges and slides; two bundled robots and,
            if installed, solo12 and talos by default.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        One result for each robot.
    """
    names = list(robots) or [*BUNDLED, *(EXAMPLES if has_example_robots() else ())]
    return one_by_one(names, _bench, progress, "derivatives")


def _bench(name: str) -> DerivativeTiming:
    system = load(name, gravity=(0.0, 0.0, 0.0))
    options: Any = {"seed": 1, "duration": _SPAN, "method": "DOP853", "rtol": 1e-8}
    made = flow(system, wrt=["x0", "xdot0", "xi0"], **options)
    own, calls = made.own("x0"), [0]
    along = {"x0": np.ones(system.m)}
    covector = np.ones(sum(rows.stop - rows.start for rows in made.outputs.values()))

    def x0() -> Array:  # a different shape at each call, so that the flow runs again
        calls[0] += 1
        return np.asarray(own + 1e-9 * calls[0])

    flows = [
        repeated(lambda: made.run({"x0": x0()})),
        repeated(lambda: made.jvp(along, x0=x0())),
        repeated(lambda: made.vjp(covector, x0=x0())),
    ]
    run, jvp, vjp = _fastest(flows)
    rate, *kernels = _fastest(_kernels(made))
    model, data = system.model, system.model.createData()
    q, v, tau = pin.neutral(model), np.ones(model.nv), np.zeros(model.nv)
    aba, derivatives = _fastest(
        [
            repeated(lambda: pin.aba(model, data, q, v, tau)),
            repeated(lambda: pin.computeABADerivatives(model, data, q, v, tau)),
        ]
    )
    direction, eight, adjoint, recursion, columns = (kernel / rate for kernel in kernels)
    return DerivativeTiming(
        robot=name, joints=system.m, jvp=jvp / run, vjp=vjp / run, direction=direction,
        eight=eight, adjoint=adjoint, jacobian=recursion, columns=columns,
        pinocchio=derivatives / aba,
    )  # fmt: skip


def _fastest(actions: Sequence[Any]) -> list[float]:
    times = np.nanmin(alternating(actions, rounds=_ROUNDS, span=_BURST), axis=0)
    return [float(time) for time in times]


def _kernels(made: Flow) -> list[Any]:
    """Return repetitions of the rate, then of its derivatives in the order of DerivativeTiming."""
    kernel = made.propagator.kernel
    function = rate_of(kernel)
    (solution,) = made.run({}).solutions
    y, p = solution.states[0].copy(), solution.params
    n = len(y)
    dy, dp, out = np.ones(n), np.ones(len(p)), np.empty(2 * n)
    wide = np.ones(n * SEEDS), np.ones(len(p) * SEEDS), np.empty(n * SEEDS)
    covector, back = np.ones(n), np.empty(n + len(p))
    matrix, columns = np.empty(n * n), np.empty((n, n + SEEDS))
    seeds, slopes = np.zeros((2, n * SEEDS))
    tangent = tangent_of(kernel).address
    return [
        partial(repeat, kernel.rate.address, p, y),
        partial(_repeat_tangent, function.pair.address, y, p, dy, dp, out),
        partial(_repeat_tangent, function.tangent.address, y, p, *wide),
        partial(repeat_adjoint, function.adjoint.address, y, p, covector, back),
        partial(_repeat_jacobian, jacobian_code(kernel).address, y, p, matrix),
        partial(_repeat_columns, tangent, y, p, seeds, slopes, columns),
    ]


@compiled
def _repeat_tangent(
    address: int, y: Array, p: Array, dy: Array, dp: Array, out: Array, count: int
) -> None:
    for _ in range(count):
        call_slopes(address, y, p, dy, dp, out)


@compiled
def _repeat_jacobian(address: int, y: Array, p: Array, out: Array, count: int) -> None:
    for _ in range(count):
        call(address, y, p, out)


@compiled
def _repeat_columns(
    address: int, y: Array, p: Array, seeds: Array, slopes: Array, matrix: Array, count: int
) -> None:
    for _ in range(count):
        jacobian(address, y, p, seeds, slopes, matrix, 0, len(y))
