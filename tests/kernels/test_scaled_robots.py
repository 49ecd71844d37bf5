"""Validation of machine code is independent of the units of a robot.

The code of correct robots is accepted, and a wrong sign of one term is found, for lengths, masses
and times a thousand times smaller and larger.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from scaled_robots import ROBOTS, Units, corners, refusals, scaled, weld

import pinred
from pinred.common.arrays import Array
from pinred.kernels import build
from pinred.kernels.build import jacobian_by_columns, tangent_of, validate_jacobian
from pinred.kernels.differentiable import Differentiable, Sample
from pinred.kernels.flow_functions import rate_of
from pinred.kernels.kernel import Kernel, evaluate
from pinred.kernels.validation import validate_kernel
from pinred.simulation.compiled.compiled_flow import kernel_of
from pinred.simulation.plan import plan_of

SMALL, LARGE = 1e-3, 1e3
SIZES = (SMALL, 1.0, LARGE)
QUICK = [
    ("loop", Units(SMALL, SMALL, SMALL)),
    ("loop", Units(LARGE, SMALL, SMALL)),
    ("balls", Units(SMALL, LARGE, LARGE)),
    ("tree", Units(SMALL, SMALL, LARGE)),
]


def kernel_in(robot: str, units: Units) -> Kernel:
    """Return the kernel of a robot in other units, whose last force numbers are those of pulls."""
    system, options = scaled(robot, units)
    return kernel_of(plan_of(pinred.Scene(system=system, **options)), zero_momentum=False)


def negated(kernel: Kernel, parameters: Array, number: int) -> Array:
    """Return parameters with the opposite sign of one force number: a wrong sign of its term."""
    changed = parameters.copy()
    changed[kernel.layout.parameters - kernel.layout.numbers + number] *= -1.0
    return changed


class WrongSign:
    """A kernel with a wrong sign of one force, or of all inertial forces on one joint."""

    def __init__(self, kernel: Kernel, number: int | None) -> None:
        """Wrap a kernel; number: index of the force number, None for inertial forces."""
        self._kernel, self._number = kernel, number

    def __getattr__(self, name: str) -> Any:
        return getattr(self._kernel, name)

    def evaluate_rate(self, y: Array, parameters: Array) -> Array:
        """Return the rate with the fault."""
        return spoiled(self._kernel, self._kernel.evaluate_rate, self._number)(y, parameters)


def spoiled(
    kernel: Kernel, rate: Callable[[Array, Array], Array], number: int | None
) -> Callable[[Array, Array], Array]:
    """Return a function (y, parameters) → rate with a wrong sign; see WrongSign."""

    def wrong(y: Array, parameters: Array) -> Array:
        if number is not None:
            return rate(y, negated(kernel, parameters, number))
        layout, values = kernel.layout, rate(y, parameters).copy()
        inertial = parameters.copy()
        inertial[layout.parameters - layout.numbers :] = 0.0
        row = layout.pairs
        values[row] -= 2.0 * rate(y, inertial)[row]
        return values

    return wrong


def assert_wrong_signs_are_found(
    kernel: Kernel, monkeypatch: pytest.MonkeyPatch, functions: list[Differentiable]
) -> None:
    """All validations of a kernel's code accept the code, and refuse a wrong sign of each term."""
    assert kernel.forces is not None
    strengths = np.flatnonzero(kernel.forces.numbers).tolist()  # of the spring and of the damper
    assert len(strengths) == 2
    validate_kernel(kernel)
    size, lanes = kernel.layout.size, 4
    wide, tangent = build.wide_rate(kernel, lanes, own_parameters=True), tangent_of(kernel)
    for number in (None, *strengths):
        with pytest.raises(pinred.KernelMismatch):
            validate_kernel(WrongSign(kernel, number))  # type: ignore[arg-type]

        def spoiled_lane(
            address: int, parameters: Array, y: Array, entries: int, number: int | None = number
        ) -> Array:
            values = evaluate(address, parameters, y, entries)
            columns = values.reshape(size, lanes)
            states, numbers = y.reshape(size, lanes), parameters.reshape(-1, lanes)
            wrong = spoiled(kernel, kernel.evaluate_rate, number)
            columns[:, 2] = wrong(states[:, 2].copy(), numbers[:, 2].copy())
            return values

        with monkeypatch.context() as patch:
            patch.setattr(build, "evaluate", spoiled_lane)
            with pytest.raises(pinred.KernelMismatch, match="at 4 states at once, in lane 2"):
                build._validate_wide_rate(kernel, wide, lanes, own_parameters=True)
        if number is None:
            continue

        def wrong_jacobian(y: Array, parameters: Array, number: int = number) -> Array:
            return jacobian_by_columns(tangent, y, negated(kernel, parameters, number))

        with pytest.raises(pinred.KernelMismatch, match="disagrees with differences of the kernel"):
            validate_jacobian(kernel, wrong_jacobian)
        for function in functions:
            validate = Differentiable._validate_derivative

            def spoiled_validation(
                self: Differentiable,
                name: str,
                derivative: Callable[..., Array],
                number: int = number,
                validate: Callable[..., None] = validate,
            ) -> None:
                validate(self, name, partial(wrong_derivative, derivative, number))

            def wrong_derivative(
                derivative: Callable[..., Array], number: int, at: Sample, *rest: Array
            ) -> Array:
                changed = Sample(
                    at.a, negated(kernel, at.b, number), at.sizes_a, at.sizes_b, at.sizes
                )
                return derivative(changed, *rest)

            for mode in ("tangent", "adjoint"):
                fresh = Differentiable(
                    kernel, function.name, function.write, function.sample, function.judge
                )
                kernel_memo = f"{function.name}_{mode}"
                with monkeypatch.context() as patch:
                    patch.setattr(Differentiable, "_validate_derivative", spoiled_validation)
                    patch.setattr("pinred.kernels.build.once", lambda _k, _key, make: make())
                    with pytest.raises(pinred.KernelMismatch, match=f"'{kernel_memo}' of"):
                        getattr(fresh, mode)


@pytest.mark.parametrize(("robot", "units"), QUICK[:1])
def test_robots_in_other_units_are_accepted(robot: str, units: Units) -> None:
    """No call refuses a correct robot of a millimetre or a kilometre."""
    assert refusals(*scaled(robot, units)) == {}


@pytest.mark.by_hand
@pytest.mark.slow
@pytest.mark.parametrize("units", list(corners(SIZES)), ids=str)
@pytest.mark.parametrize("robot", ROBOTS)
def test_robots_in_all_units_are_accepted(robot: str, units: Units) -> None:
    """No call refuses a correct robot for any combination of lengths, masses and times."""
    assert refusals(*scaled(robot, units)) == {}


@pytest.mark.by_hand("balls-units2")
@pytest.mark.sampled
@pytest.mark.parametrize(("robot", "units"), QUICK)
def test_wrong_sign_is_found_in_other_units(
    robot: str, units: Units, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A spring, a damper or inertia with the wrong sign is found, whatever the robot's size."""
    kernel = kernel_in(robot, units)
    assert_wrong_signs_are_found(kernel, monkeypatch, [rate_of(kernel)])


@pytest.mark.by_hand
@pytest.mark.slow
@pytest.mark.parametrize("units", list(corners(SIZES)), ids=str)
@pytest.mark.parametrize("robot", ROBOTS)
def test_wrong_sign_is_found_in_all_units(
    robot: str, units: Units, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each planted fault is found for any combination of lengths, masses and times."""
    kernel = kernel_in(robot, units)
    assert_wrong_signs_are_found(kernel, monkeypatch, [rate_of(kernel)])


# Robots with loops are accepted in all units, and batches are those of single runs.
@pytest.mark.by_hand
def test_batches_of_welded_arms_are_accepted() -> None:
    """Two welded arms, whose loop equations are ill-conditioned away from closed shapes."""
    system = pinred.load(text=weld(4))
    runs = pinred.simulate_many(system, seeds=range(9), duration=0.1)
    assert len(runs) == 9


@pytest.mark.by_hand
@pytest.mark.slow
@pytest.mark.parametrize("seed", range(30))
def test_welded_arms_are_accepted(seed: int) -> None:
    """Single runs, batches and flows of random welds; single runs agree with ABA."""
    system = pinred.load(text=weld(seed))
    options: dict[str, Any] = {"seed": 1, "duration": 0.5}
    assert pinred.compare(pinred.simulate(system, **options)).passed
    pinred.simulate_many(system, seeds=range(9), duration=0.5)
    flow = pinred.flow(system, wrt=["x0"], **options)
    flow.vjp(np.ones_like(flow.jvp({"x0": np.ones(system.m)})))
