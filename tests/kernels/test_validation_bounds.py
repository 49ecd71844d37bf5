"""Bounds of the validation of derived code: how far values may differ, and at which states.

Robots of a metre, a millimetre and a kilometre have the same bounds relative to their values.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from loop_robots import five_bar
from scaled_robots import ROBOTS, Units, evaluate_connection, scaled

import pinred
from pinred.analysis.connections import drag_fluid_and_wheels
from pinred.common.arrays import Array, central_differences
from pinred.forces import ComputedTorque, Torque, Wrench
from pinred.forces.force_numbers import random_numbers
from pinred.kernels import build as codes
from pinred.kernels import differentiable, flow_functions, initial_conditions, validation
from pinred.kernels.build import jacobian_by_columns, tangent_of, validate_jacobian
from pinred.kernels.connection import connection_validation
from pinred.kernels.differentiable import Differentiable, Sample, values_near
from pinred.kernels.flow_functions import initial_conditions_of, rate_of
from pinred.kernels.initial_conditions import initial_conditions_kernel
from pinred.kernels.kernel import Kernel, evaluate
from pinred.kernels.reference_state import random_state
from pinred.reduction.tree.free_bodies import free_numbers
from pinred.reduction.tree.loop_constraints import GAUGE_RATE
from pinred.simulation.compiled.compiled_flow import kernel_of
from pinred.simulation.plan import plan_of
from pinred.system.loops.kinematics import loop_jacobian

MODULES = (
    validation, codes, differentiable, flow_functions, initial_conditions,
    connection_validation, drag_fluid_and_wheels,
)  # fmt: skip
SMALL, LARGE = Units(1e-3, 1e-3, 1e-3), Units(1e3, 1e-3, 1e-3)


@cache
def build(robot: str, units: Units = Units()) -> Kernel:  # noqa: B008
    """Return the kernel of a robot in other units."""
    system, options = scaled(robot, units)
    return kernel_of(plan_of(pinred.Scene(system=system, **options)), zero_momentum=False)


# For each comparison: its tolerance, and the largest magnitude of the summed terms relative to the
# largest value, at most three times that of the robots of these tests.
LIMITS = {
    "canonical momenta": (1e-10, 8e3),
    "angular momentum": (1e-10, 2e3),
    "spatial angular momentum": (1e-10, 2e3),
    "centre of mass": (1e-10, 10.0),
    "momentum": (1e-10, 250.0),
    "the centre of mass": (1e-10, 27.0),
    "the body velocity": (1e-10, 100.0),
    "the metric": (1e-10, 1e3),
    "A": (1e-10, 25.0),
    "P_b": (1e-10, 3.0),
    "the form": (1e-10, 3.0),
    "M": (1e-10, 150.0),
    "A of the curvature": (1e-10, 25.0),
    "the curvature": (1e-7, 3e5),
    "the slope of its velocity": (1e-7, 1.5e5),
    "the slope of its metric": (1e-7, 5e5),
    "the derivative of P_b": (1e-7, 2.5e4),
    "the covariant force": (1e-7, 9e5),
    "its derivative": (1e-7, 2.3e6),
    "the multipliers": (1e-9, 150.0),
    "the pull": (1e-10, 3.0),
    "the gap": (1e-10, 70.0),
    "the result": (1e-10, 1.2),
    "the value": (1e-10, 8.0),
}


# A loop contains the terms of a tree.
@pytest.mark.by_hand("metre-tree")
@pytest.mark.sampled(3)
@pytest.mark.parametrize("robot", ["tree", "loop"])
@pytest.mark.parametrize("units", [Units(), SMALL, LARGE], ids=["metre", "small", "large"])
def test_bounds_are_relative_to_values(
    robot: str, units: Units, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tolerances are those documented, and terms are of the size of values, in any units."""
    kernel = build.__wrapped__(robot, units)  # without validated code
    system = kernel.system
    require_agreement, seen = validation.require_agreement, set()

    def record(
        who: str, what: str, found: Array, expected: Array, terms: Any,
        tolerance: float = validation.TOLERANCE, *rest: Any, **kinds: Any,
    ) -> None:  # fmt: skip
        require_agreement(who, what, found, expected, terms, tolerance, *rest, **kinds)
        if what in LIMITS:
            most, limit = LIMITS[what]
            assert tolerance <= most, what
            assert np.max(terms) <= limit * np.abs(expected).max(), what
            seen.add(what)

    for module in MODULES:
        monkeypatch.setattr(module, "require_agreement", record)
    for given in ("xi", "mu"):
        initial_conditions_kernel(system, given)
    _ = initial_conditions_of(kernel, "xi").value, rate_of(kernel).pair
    if system.loops:
        monkeypatch.setattr(validation, "require_agreement", require_agreement)
        codes.with_multipliers(kernel)
        assert {"the multipliers", "the pull", "the gap"} <= seen
    else:
        evaluate_connection(system)
        assert set(LIMITS) - seen == {"the multipliers", "the pull", "the gap"}


@cache
def driven(units: Units) -> Kernel:
    """Return the kernel of a tree with two prescribed joints, a controller and a thruster.

    The thruster has a zero, whose random value has the size of the robot's own forces.
    """
    system, options = scaled("tree", units)
    L, M, T = units.length, units.mass, units.time
    (slide, *_), (*_, hinge) = (
        [name for name, unit in zip(system.shape_names, system.units, strict=True) if unit == kind]
        for kind in ("m", "rad")
    )
    waves = {
        slide: pinred.signals.Expression(f"{0.2 * L!r}*sin({2.0 / T!r}*t)"),
        hinge: pinred.signals.Expression(f"0.3*sin({3.0 / T!r}*t)"),
    }
    others = {
        name: 0.1 * (L if unit == "m" else 1.0)
        for name, unit in zip(system.shape_names, system.units, strict=True)
        if name not in waves
    }
    held = ComputedTorque(others, kp=4.0 / T**2, kd=2.0 / T)
    F = M * L / T**2
    thrust = Wrench([0.3 * F, 0.0, 0.2 * F, 0.1 * F * L, -0.2 * F * L, 0.3 * F * L])
    options["forces"] = [held, thrust]
    scene = pinred.Scene(system=system, prescribed=waves, **options)
    return kernel_of(plan_of(scene), zero_momentum=False)


def cyclic(units: Units) -> Kernel:
    """Return the kernel of a slide that carries a slide and a wheel, both cyclic."""
    model, L, M = pin.Model(), units.length, units.mass
    for name, joint in (
        ("root", pin.JointModelPX()), ("slide", pin.JointModelPX()), ("wheel", pin.JointModelRX()),
    ):  # fmt: skip
        i = model.addJoint(min(1, model.njoints - 1), joint, pin.SE3.Identity(), name)
        model.appendBodyToJoint(i, pin.Inertia.FromSphere(M, 0.3 * L), pin.SE3.Identity())
    model.gravity.setZero()
    kernel = kernel_of(
        plan_of(pinred.Scene(system=pinred.load(model), seed=0)), zero_momentum=False
    )
    assert kernel.layout.cyclic == (0, 1)
    return kernel


ROBOT_KERNELS: dict[str, Callable[[Units], Kernel]] = {
    **{robot: partial(build, robot) for robot in ROBOTS}, "driven": driven, "cyclic": cyclic,
}  # fmt: skip


@pytest.mark.by_hand("weld", "loop", "driven", "tree")
@pytest.mark.parametrize("robot", [*ROBOTS, "driven"])
def test_states_are_equal_in_own_units(robot: str) -> None:
    """States, parameters and times, relative to their sizes, do not depend on units."""

    def relative(units: Units) -> Array:
        kernel = ROBOT_KERNELS[robot](units)
        at, r = random_state(kernel, np.random.default_rng(3), 1.0), kernel.system.r
        assert at is not None
        sizes = at.sizes
        return np.concatenate([
            at.y / sizes.of_state(kernel.layout, r),
            at.parameters / sizes.of_parameters(kernel.layout, r, at.parameters),
            at.com_path / sizes.of_path(kernel.system.group.linear),
            at.pi / sizes.momenta[r:],
            [sizes.length / units.length, sizes.mass / units.mass, sizes.time / units.time],
        ])  # fmt: skip

    # Prescribed motions determine the unit of time.
    units = Units(1e-3, 1e-3) if robot == "driven" else SMALL
    assert relative(units) == pytest.approx(relative(Units()), rel=1e-9, abs=1e-9)


@pytest.mark.by_hand("weld", "tree")
@pytest.mark.parametrize("robot", ["tree", "weld", "driven", "cyclic"])
def test_compared_entries_of_one_kind_have_equal_units(
    robot: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In units of a millimetre, values of one kind change by one factor."""
    require_agreement = validation.require_agreement

    def compared(units: Units) -> list[tuple[str, Array, Any, Any]]:
        kernel = ROBOT_KERNELS[robot](units)
        seen: list[tuple[str, Array, Any, Any]] = []

        def record(
            who: str, what: str, found: Array, expected: Array, terms: Any, *rest: Any, **kinds: Any
        ) -> None:
            require_agreement(who, what, found, expected, terms, *rest, **kinds)
            exact = np.abs(expected) > 1e-8 * np.asarray(terms)
            seen.append((what, expected, exact, kinds.get("kinds")))

        with monkeypatch.context() as patch:
            for module in MODULES:
                patch.setattr(module, "require_agreement", record)
            validation.validate_kernel(kernel)
            initial_conditions_kernel(kernel.system, "xi")
            if kernel.system.loops:
                codes.with_multipliers(kernel)
        return seen

    first, second = compared(Units()), compared(Units(1e-3, 10.0, 1.0))
    assert len(first) == len(second)
    for (what, values, exact, kinds), (name, others, *_) in zip(first, second, strict=True):
        assert what == name
        for kind in (exact,) if kinds is None else (exact & kinds, exact & ~kinds):
            factors = others[kind] / values[kind]
            assert factors == pytest.approx(factors[:1].repeat(len(factors)), rel=1e-4), what


@pytest.mark.parametrize(("part", "passes"), [(0.3, True), (3.0, False)])
def test_jacobian_tolerance(part: float, passes: bool) -> None:
    """Entries may differ by 1e-6 of the largest entry of their column, relative to sizes."""
    kernel = build("tree", SMALL)
    tangent, layout, r = tangent_of(kernel), kernel.layout, kernel.system.r
    at = random_state(kernel, np.random.default_rng(0), 1.0)
    assert at is not None
    units = at.sizes.of_state(layout, r)

    def shifted(y: Array, parameters: Array) -> Array:
        relative = jacobian_by_columns(tangent, y, parameters) / units[:, None] * units
        relative[-1] += part * 1e-6 * np.abs(relative).max(axis=0)
        return relative * units[:, None] / units

    if passes:
        validate_jacobian(kernel, shifted)
        return
    with pytest.raises(pinred.KernelMismatch, match="column 0 is off"):
        validate_jacobian(kernel, shifted)


@pytest.mark.parametrize(("width", "part"), [(4e-5, 1.0), (4e-5, 0.05)])
def test_jacobian_at_short_pulses_is_not_compared(width: float, part: float) -> None:
    """Differences skip a pulse that is shorter than their step, so the columns are left out.

    `part` is the slope of the pulse relative to that of a spring.
    """
    system = pinred.load("cartpole")

    def kernel_with(centres: Sequence[float]) -> Kernel:
        def torque(_t: Any, x: Any, _xdot: Any, _mu: Any) -> list[Any]:
            pulses = [ca.exp(-(((x[0] - centre) / width) ** 2)) for centre in centres]
            return [-200.0 * x[0] + 200.0 * part * width * sum(pulses)]

        scene = pinred.Scene(system=system, seed=0, forces=Torque(torque))
        return kernel_of(plan_of(scene), zero_momentum=False)

    plain, rng = kernel_with([10.0]), np.random.default_rng(0)
    states = [random_state(plain, rng, 1.0) for _ in range(2)]
    # The slope of a pulse is largest 0.7 widths beside its centre.
    tangent_of(kernel_with([float(at.x[0]) - 0.7 * width for at in states if at is not None]))


def test_jacobian_near_infinite_forces_is_not_compared() -> None:
    """Differences of rates that overflow are not finite: these states are left out in silence."""

    def torque(_t: Any, x: Any, _xdot: Any, _mu: Any) -> list[Any]:
        return [ca.exp(4000.0 * x[0])]

    scene = pinred.Scene(system=pinred.load("cartpole"), seed=0, forces=Torque(torque))
    kernel, rng = kernel_of(plan_of(scene), zero_momentum=False), np.random.default_rng(0)
    states = [random_state(kernel, rng, 1.0) for _ in range(2)]
    assert any(at is not None and 0.17 < at.x[0] < 0.175 for at in states)
    tangent_of(kernel)


def test_two_states_are_compared() -> None:
    """Derivatives are compared at two states."""
    kernel, states = build("tree"), []
    tangent = tangent_of(kernel)

    def count(y: Array, parameters: Array) -> Array:
        states.append(y)
        return jacobian_by_columns(tangent, y, parameters)

    validate_jacobian(kernel, count)
    assert len(states) == 2
    function, samples = rate_of(kernel), []

    def record(at: Sample, da: Array, db: Array, covector: Array) -> Array:
        samples.append(at)
        forward = function.forward(at.a, at.b, da[:, None], db[:, None], len(covector))
        return np.asarray(covector @ forward)

    function._validate_derivative("counted", record)
    assert len(samples) == 2
    code = drag_fluid_and_wheels.mechanical_code(kernel.system)
    assert len(list(connection_validation.trial_shapes(code.form))) == 2


@pytest.mark.parametrize(("part", "passes"), [(0.3, True), (3.0, False)])
def test_tolerance_of_directional_derivatives(
    part: float, passes: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Derivatives may differ by 1e-6 of the magnitude of their terms."""
    function = rate_of(build("tree", SMALL))
    monkeypatch.setattr("pinred.kernels.build.once", lambda _k, _key, make: make())
    validate = Differentiable._validate_derivative

    def shifted_validation(self: Differentiable, name: str, derivative: Any) -> None:
        def shifted(at: Sample, da: Array, db: Array, covector: Array) -> Array:
            def value(s: Array) -> Array:
                moved = Sample(at.a + s * da, at.b + s * db, at.sizes_a, at.sizes_b, at.sizes)
                return values_near(self._reference, moved, np.zeros(len(at.a)))

            columns = central_differences(value, np.zeros(1), 1e-3)[:, 0]
            fault = part * 1e-6 * float(np.abs(covector) @ np.abs(columns))
            assert self._noise_of(at, covector) < 1e-12 * _size_of(self, at, covector)
            return np.asarray(derivative(at, da, db, covector) + fault)

        validate(self, name, shifted)

    monkeypatch.setattr(Differentiable, "_validate_derivative", shifted_validation)
    fresh = Differentiable(
        function.kernel, function.name, function.write, function.sample, function.judge
    )
    if passes:
        _ = fresh.tangent, fresh.adjoint
        return
    for mode in ("tangent", "adjoint"):
        with pytest.raises(pinred.KernelMismatch, match="disagrees with differences"):
            getattr(fresh, mode)


def _size_of(function: Differentiable, at: Sample, covector: Array) -> float:
    values = values_near(function._reference, at, np.zeros(len(at.a)))
    return float(np.abs(covector) @ np.abs(values))


@pytest.mark.parametrize("own_parameters", [False, True])
def test_each_lane_is_compared(own_parameters: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """An error of 1e-9 in the last entry of any lane is found."""
    kernel, lanes = build("tree", SMALL), 4
    code = codes.wide_rate(kernel, lanes, own_parameters=own_parameters)
    for lane in range(lanes):

        def faulty(
            address: int, parameters: Array, y: Array, entries: int, lane: int = lane
        ) -> Array:
            values = evaluate(address, parameters, y, entries)
            values.reshape(-1, lanes)[:, lane] *= 1.0 + 1e-9
            return values

        with monkeypatch.context() as patch:
            patch.setattr(codes, "evaluate", faulty)
            with pytest.raises(pinred.KernelMismatch, match=f"in lane {lane}"):
                codes._validate_wide_rate(kernel, code, lanes, own_parameters=own_parameters)


@pytest.mark.parametrize("own_parameters", [False, True])
def test_exchanged_lanes_are_found(own_parameters: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """No lane may return the rate of another."""
    kernel, lanes = build("tree"), 4
    code = codes.wide_rate(kernel, lanes, own_parameters=own_parameters)
    for first in range(lanes):
        for second in range(first):

            def exchanged(
                address: int, parameters: Array, y: Array, entries: int,
                pair: tuple[int, int] = (first, second),
            ) -> Array:  # fmt: skip
                values = evaluate(address, parameters, y, entries)
                columns = values.reshape(-1, lanes)
                columns[:, pair] = columns[:, pair[::-1]]
                return values

            with monkeypatch.context() as patch:
                patch.setattr(codes, "evaluate", exchanged)
                with pytest.raises(pinred.KernelMismatch, match="4 states at once, in lane"):
                    codes._validate_wide_rate(kernel, code, lanes, own_parameters=own_parameters)


def test_body_parameters_of_lanes_are_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lane that computes with the nominal masses is found."""
    system = pinred.load("cartpole")
    scene = pinred.Scene(system=system, seed=0, parameters={"pole.mass": 1.1})
    kernel, lanes = kernel_of(plan_of(scene), zero_momentum=False), 4
    code = codes.wide_rate(kernel, lanes, own_parameters=True)
    layout = kernel.layout
    bodies = slice(layout.bodies_at, layout.bodies_at + layout.freed.size)
    nominal = free_numbers(kernel.system, layout.freed)

    def faulty(address: int, parameters: Array, y: Array, entries: int) -> Array:
        changed = parameters.reshape(-1, lanes).copy()
        changed[bodies, 1] = nominal
        return evaluate(address, changed.ravel(), y, entries)

    monkeypatch.setattr(codes, "evaluate", faulty)
    with pytest.raises(pinred.KernelMismatch, match="in lane 1"):
        codes._validate_wide_rate(kernel, code, lanes, own_parameters=True)


def test_round_off_near_is_ten_times_the_spread() -> None:
    """The spread of 1 + ε k, with k from −4 to 4, is at most 8 ε."""
    epsilon = np.finfo(float).eps
    spread = codes.round_off_near(lambda step: 1.0 + step, 200) / epsilon
    assert spread == pytest.approx(80.0)
    single = codes.round_off_near(lambda step: 1.0 + step, 1) / epsilon
    assert single > 60.0  # nine neighbours differ by nearly the whole range
    assert codes.round_off_near(lambda _: np.ones(2), 3) == 0.0


def test_random_numbers_have_the_size_of_values() -> None:
    """Numbers of forces keep their magnitude; zero becomes a number of size one."""
    values = np.array([0.0, 1e-6, -1e6, 2e3])
    draws = [random_numbers(values, [3], np.random.default_rng(k)) for k in range(200)]
    spread = np.sqrt(np.mean(np.square(draws), axis=0))
    assert spread[:3] == pytest.approx([1.0, 1e-6, 1e6], rel=0.15)
    assert np.abs(np.array(draws)[:, 3] / 2e3 - 1.0).max() < 0.5


def test_terms_of_accelerations_with_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    """The drift J̇ ẋ of the loops, and the multipliers of the impetus, are among the terms."""
    model, loops = five_bar()
    scene = pinred.Scene(system=pinred.load(model, loops=loops), seed=0)
    kernel, found = kernel_of(plan_of(scene), zero_momentum=False), {}
    system, r = kernel.system, kernel.system.r
    at = random_state(kernel, np.random.default_rng(0), 1.0)
    assert at is not None
    assert system.closure is not None

    def record(
        _: str, what: str, _found: Array, expected: Array, terms: Any, **_kinds: Any
    ) -> None:
        found[what] = expected, terms

    monkeypatch.setattr(validation, "require_agreement", record)
    validation._validate_at(kernel, at)
    rows, rates = system.closure.rows, at.v[r:]

    def jacobian(t: Array) -> Array:
        moved = system.space.integrate(at.x, t[0] * rates)
        return np.asarray(loop_jacobian(system, moved)[rows]).ravel()

    step = 1e-3 / np.abs(rates).max()
    turning = central_differences(jacobian, np.zeros(1), step)[:, 0].reshape(len(rows), -1)
    expected, terms = found["acceleration"]
    sums = at.force_terms + at.gravity_terms + np.abs(at.H) @ np.abs(expected)
    J = np.abs(loop_jacobian(system, at.x)[rows])
    sums[r:] += np.abs(at.nu) @ (np.abs(turning) + GAUGE_RATE * J)
    H, drift = np.linalg.inv(at.H), np.abs(turning) @ np.abs(rates)
    opened = np.abs(H) @ sums
    response = H[:, r:] @ loop_jacobian(system, at.x)[rows].T
    mobility = loop_jacobian(system, at.x)[rows] @ response[r:]
    multipliers = np.abs(np.linalg.inv(mobility)) @ (J @ opened[r:] + drift)
    assert terms == pytest.approx(opened + np.abs(response) @ multipliers, rel=1e-6)


def test_entries_of_a_kind_that_all_cancel_have_the_round_off_of_their_terms() -> None:
    """The linear momenta of a large robot vanish in the frame of its centre of mass."""
    kinds, expected = np.array([True, True, False]), np.array([0.0, 1e-14, 100.0])
    terms = np.array([1e3, 1e3, 2e3])
    accept = partial(validation.require_agreement, "the kernel", "momentum", kinds=kinds)
    accept(np.add(expected, [8e-8, 0.0, 0.0]), expected, terms)
    with pytest.raises(pinred.KernelMismatch, match="momentum"):
        accept(np.add(expected, [1e-6, 0.0, 0.0]), expected, terms)
    # An entry of this kind that does not cancel is a scale of its own.
    scaled_by = np.add(expected, [0.0, 2e-6, 0.0])
    with pytest.raises(pinred.KernelMismatch, match="momentum"):
        accept(np.add(scaled_by, [1.5e-10, 0.0, 0.0]), scaled_by, terms)


def test_balanced_bodies_have_the_round_off_of_their_masses() -> None:
    """Three welded balls: their levers cancel in H, and the round-off of 1e-17 m remains."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    I = np.array([[2.94465, 2.2e-16, 0.0], [2.2e-16, 2.94465, 0.0], [0.0, 0.0, 5.69153]])
    model.appendBodyToJoint(
        joint, pin.Inertia(7.911, np.array([1.4e-17, 2.8e-17, 0.0]), I), pin.SE3.Identity()
    )
    system = pinred.load(model, gravity=[0.0, 0.0, 0.0])
    assert pinred.compare(pinred.simulate(system, seed=0, duration=0.2)).passed


def test_linear_momentum_terms_contain_masses_at_the_reach() -> None:
    """Each component has the largest of |H| |v|, plus mass · reach · Σ |ω|."""
    kernel = build("tree")
    at = random_state(kernel, np.random.default_rng(0), 1.0)
    assert at is not None
    size = (np.abs(at.H) @ np.abs(at.v))[:3].max()
    size += kernel.system.mass * at.reach * np.abs(at.v[3:6]).sum()
    assert at.momentum_terms[:3] == pytest.approx(np.full(3, size), rel=1e-12)
