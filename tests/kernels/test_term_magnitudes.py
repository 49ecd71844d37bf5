"""Tests of the tolerance of kernel validation: a relative error and the round-off of terms.

The magnitudes of terms are compared with closed forms for one body and for a cart and pole.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from trees import random_model

import pinred
from pinred import forces
from pinred.common.arrays import Array
from pinred.kernels import validation
from pinred.kernels.kernel import Kernel
from pinred.kernels.reference_state import ReferenceState, random_state
from pinred.simulation.compiled.compiled_flow import kernel_of
from pinred.simulation.plan import plan_of

MASS, ARM, G = 2.0, 0.3, 10.0
GYRATION = 0.5  # √(tr I / m)
REACH = ARM + GYRATION
FORCE, MOMENT, HEIGHT, POTENTIAL = np.array([3.0, 4.0, 0.0]), np.array([0.0, 0.0, 0.5]), 5.0, 7.0
SPIN, TIME = 2.0, 2.0
LEVER = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, ARM], [0.0, ARM, 0.0]])  # |c ×|
INERTIA = np.diag([0.2, 0.2 + MASS * ARM**2, 0.1 + MASS * ARM**2])  # about the origin
SIZES_OF_H = np.block([[MASS * np.eye(3), MASS * LEVER], [MASS * LEVER, INERTIA]])

Tested = Callable[..., None]


def kernel(model: pin.Model, **options: Any) -> Kernel:
    """Return the kernel of a model."""
    scene = pinred.Scene(system=pinred.load(model), seed=0, **options)
    return kernel_of(plan_of(scene), zero_momentum=False)


def body(joint: pin.JointModel) -> pin.Model:
    """Return a body of 2 kg, 0.3 m from a joint 5 m above the ground."""
    model = pin.Model()
    model.addJoint(0, joint, pin.SE3(np.eye(3), np.array([0.0, 0.0, HEIGHT])), "root")
    inertia = pin.Inertia(MASS, np.array([ARM, 0.0, 0.0]), np.diag([0.2, 0.2, 0.1]))
    model.appendBodyToJoint(1, inertia, pin.SE3.Identity())
    model.gravity.linear = np.array([0.0, 0.0, -G])
    return model


@cache
def pushed() -> Kernel:
    """Return the kernel of this body, free, with a thruster."""
    wrench = forces.Wrench(lambda _t, _x, _xdot, _mu: [*FORCE, *MOMENT])
    return kernel(body(pin.JointModelFreeFlyer()), forces=wrench)


def draw_state(tested: Kernel) -> ReferenceState:
    """Return a random state."""
    at = random_state(tested, np.random.default_rng(0), 1.0)
    assert at is not None
    return at


def record_terms(monkeypatch: pytest.MonkeyPatch, work: Callable[[], object]) -> dict[str, Array]:
    """Record the terms, and the expected values, of each comparison during some work."""
    found: dict[str, Array] = {}

    def record(
        _: str, what: str, _found: Array, expected: Array, terms: Array | float, **_kinds: Any
    ) -> None:
        found[what] = np.broadcast_to(np.asarray(terms, dtype=float), expected.shape)
        found[f"expected {what}"] = expected

    monkeypatch.setattr(validation, "require_agreement", record)
    work()
    return found


def spinning_state() -> ReferenceState:
    """Return a state of the free body that spins about z, without linear momentum."""
    line = np.array([1.0, 0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0, -G])
    return replace(
        draw_state(pushed()), time=TIME, com_path=line,
        push=np.array([0.5, 0.0, 0.0, 0.0, 0.0, -4.0]),
        pose=np.array([0.0] * 6 + [1.0]), q=np.array([0.0] * 6 + [1.0]),
        v=np.array([0.0, -SPIN * ARM, 0.0, 0.0, 0.0, SPIN]),
    )  # fmt: skip


# Momenta m v + m c × ω and m c × v + I ω, each the largest of three components. The round-off of
# levers that cancel in m c is that of the reach.
LINEAR = 2.0 * MASS * SPIN * ARM + MASS * REACH * SPIN
ANGULAR = MASS * SPIN * ARM**2 + INERTIA[2, 2] * SPIN
H = SIZES_OF_H * np.array([[1, 1, 1, 1, 1, 1]] * 4 + [[1, 1, -1, 1, 1, 1]] * 2)
H[2, 4] *= -1.0
VELOCITY = np.abs(np.linalg.inv(H)) @ np.repeat([LINEAR, ANGULAR], 3)
VELOCITY += np.array([0.0, SPIN * ARM, 0.0, 0.0, 0.0, SPIN])
PARTS = 1.0 + 3.0 * TIME + 0.5 * G * TIME**2 + 0.5  # displacements of the centre-of-mass path
SPEEDS = 3.0 + G * TIME + 4.0 / MASS
FAST = SPEEDS + VELOCITY[:3].sum() + REACH * VELOCITY[3:].sum() + 3.0 * LINEAR / MASS


def test_terms_of_full_state_equal_closed_form(monkeypatch: pytest.MonkeyPatch) -> None:
    """Terms of the centre-of-mass path, momenta and energy, with the base at (1, 2, 0)."""
    tested, at = pushed(), spinning_state()
    where = tested.where
    out = np.zeros(where.size)
    out[where.fields["pose"]] = out[where.fields["q"]] = [1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    out[where.fields["v"]] = speed = [0.0, 0.0, 3.0, 0.0, 0.0, SPIN]
    found = record_terms(monkeypatch, lambda: validation._validate_full_state(tested, at, out))
    assert found["full velocity"] == pytest.approx(VELOCITY[3:])
    assert found["position of the centre of mass"] == pytest.approx(PARTS + REACH)
    assert found["velocity of the centre of mass"] == pytest.approx(FAST)
    whole = VELOCITY + np.array([FAST] * 3 + [0.0] * 3)
    momentum = SIZES_OF_H @ whole
    assert found["body momentum"] == pytest.approx(momentum)
    carried = momentum.copy()  # (1, 2, 0) × P besides
    carried[3:] += np.array([[0, 0, 2], [0, 0, 1], [2, 1, 0]]) @ momentum[:3]
    assert found["spatial momentum"] == pytest.approx(carried)
    height = MASS * G * (PARTS + REACH + HEIGHT)
    assert found["energy"] == pytest.approx(np.abs(speed) @ momentum + height)
    energy = 0.5 * MASS * 3.0**2 + 0.5 * INERTIA[2, 2] * SPIN**2 + MASS * G * HEIGHT
    assert found["expected energy"] == pytest.approx(energy)


def test_terms_of_energy_include_potential(monkeypatch: pytest.MonkeyPatch) -> None:
    """The potential enters the energy with its sign and the terms with its magnitude."""

    def compared(value: float) -> tuple[Array, Array]:
        model = body(pin.JointModelFreeFlyer())
        at = model.addJoint(1, pin.JointModelRX(), pin.SE3.Identity(), "joint")
        model.appendBodyToJoint(at, pin.Inertia.FromSphere(1.0, 0.2), pin.SE3(1))
        tested = kernel(model, forces=forces.PotentialEnergy(lambda x: value + 0.0 * x[0]))
        state = draw_state(tested)
        out = tested.evaluate_outputs(state.time, state.y, state.parameters, state.com_path)
        found = record_terms(
            monkeypatch, lambda: validation._validate_full_state(tested, state, out)
        )
        return found["expected energy"], found["energy"]

    (first, terms), (second, more) = compared(1e-9), compared(-POTENTIAL)
    assert second - first == pytest.approx(-POTENTIAL)
    assert more - terms == pytest.approx(POTENTIAL)


def test_terms_of_momenta_equal_closed_form(monkeypatch: pytest.MonkeyPatch) -> None:
    """Momenta and velocity relative to the centre of mass."""
    tested, at = pushed(), spinning_state()
    out = np.zeros(tested.where.size)
    found = record_terms(monkeypatch, lambda: validation._validate_momentum(tested, at, out))
    momenta = np.repeat([LINEAR, ANGULAR], 3)
    assert found["momentum of the velocity"] == pytest.approx(momenta)
    assert found["momentum"] == pytest.approx(momenta)
    assert found["velocity"] == pytest.approx(VELOCITY)
    assert found["centre of mass"] == pytest.approx(REACH)


def test_terms_of_base_rates_equal_closed_form(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half the twist for the attitude; N, c × F and μ × ω for the angular momentum."""
    tested, at = pushed(), spinning_state()
    rate, wrench = np.zeros(tested.layout.base.size), np.append(FORCE, MOMENT)
    found = record_terms(monkeypatch, lambda: validation._validate_velocity(tested, at, rate))
    assert found["attitude rate"] == pytest.approx([*(0.5 * VELOCITY[3:]), 0.0])
    found = record_terms(
        monkeypatch, lambda: validation._validate_base(tested, at, rate, at.v, wrench)
    )
    turning = 3.0 * ANGULAR * VELOCITY[3:].sum()
    moments = MOMENT + LEVER.T @ FORCE + turning
    assert found["rate of the angular momentum"] == pytest.approx(moments)
    assert found["rate of the centre of mass"] == pytest.approx([0.0, 0.0, 2.0, *FORCE])
    turned = replace(at, pose=np.array([0.0] * 5 + [1.0, 0.0]))  # half a turn about z
    found = record_terms(
        monkeypatch, lambda: validation._validate_base(tested, turned, rate, at.v, wrench)
    )
    assert found["expected rate of the centre of mass"][3:] == pytest.approx(-FORCE)
    assert found["rate of the centre of mass"][3:] == pytest.approx(FORCE)


def test_terms_of_gravity_on_pivot_equal_closed_form(monkeypatch: pytest.MonkeyPatch) -> None:
    """The gravity force times the reach, for any direction."""
    tested = kernel(body(pin.JointModelSpherical()))
    at = replace(draw_state(tested), v=np.array([0.0, 0.0, SPIN]))
    rate, none = np.zeros(tested.layout.base.size), np.zeros(3)
    found = record_terms(
        monkeypatch, lambda: validation._validate_base(tested, at, rate, at.v, none)
    )
    momentum = INERTIA[2, 2] * SPIN
    fast = np.abs(np.linalg.inv(INERTIA)).sum() * momentum + SPIN
    expected = MASS * G * REACH + 3.0 * momentum * fast
    assert found["rate of the angular momentum"] == pytest.approx([expected] * 3)


CART, POLE, HALF = 2.0, 1.0, 0.5  # of robots/cartpole.urdf, SI


def record_accelerations(
    monkeypatch: pytest.MonkeyPatch, **options: Any
) -> tuple[Kernel, ReferenceState, dict[str, Array]]:
    """Return a state of the cart and pole, with the recorded terms."""
    scene = pinred.Scene(system=pinred.load("cartpole"), seed=0, **options)
    tested = kernel_of(plan_of(scene), zero_momentum=False)
    at = draw_state(tested)
    return tested, at, record_terms(monkeypatch, lambda: validation._validate_at(tested, at))


def test_terms_of_accelerations_equal_closed_form(monkeypatch: pytest.MonkeyPatch) -> None:
    """H⁻¹ of inertial forces, torques, gravity and H a, with and without a prescribed joint."""
    torque = forces.Torque(lambda *_: [40.0])
    _, at, found = record_accelerations(monkeypatch, forces=torque)
    a, given = np.abs(found["expected acceleration"]), np.array([0.0, 40.0])
    sums = at.force_terms + given + at.gravity_terms + np.abs(at.H) @ a
    assert found["acceleration"] == pytest.approx(np.abs(np.linalg.inv(at.H)) @ sums)
    plan = {"pole_pivot": pinred.signals.Expression("20*t**2")}
    _, at, found = record_accelerations(monkeypatch, prescribed=plan)
    a = np.abs([found["expected acceleration"][0], 2.0 * at.force_parameters[0]])  # of t²
    sums = at.force_terms[0] + at.gravity_terms[0] + np.abs(at.H[0]) @ a
    assert found["acceleration"] == pytest.approx([sums / (CART + POLE)])


def test_accelerations_with_prescribed_joint_equal_crba(monkeypatch: pytest.MonkeyPatch) -> None:
    """The other rows of H a + b = 0 determine the other accelerations."""
    system = pinred.load(random_model("SE3", 3, 1))
    plan = {system.shape_names[1]: pinred.signals.Expression("20*t**2")}
    scene = pinred.Scene(system=system, seed=0, prescribed=plan)
    tested = kernel_of(plan_of(scene), zero_momentum=False)
    at = draw_state(tested)
    found = record_terms(monkeypatch, lambda: validation._validate_at(tested, at))
    data = at.model.createData()
    upper = np.triu(pin.crba(at.model, data, at.q))
    whole = upper + np.triu(upper, 1).T
    bias = pin.nonLinearEffects(at.model, data, at.q, at.v)
    free, planned = [k for k in range(9) if k != 7], 2.0 * at.force_parameters[0]  # of t²
    a = np.linalg.solve(whole[np.ix_(free, free)], -(bias[free] + whole[free, 7] * planned))
    assert found["expected acceleration"] == pytest.approx(a)


def test_terms_of_inverse_dynamics_equal_closed_form(monkeypatch: pytest.MonkeyPatch) -> None:
    """Terms of the joint's row, and of the cart's row as far as the cart moves."""
    held = forces.ComputedTorque({"pole_pivot": 0.1}, kp=400.0, kd=20.0)
    tested, at, found = record_accelerations(monkeypatch, forces=held)
    coupled, moment = -POLE * HALF * np.cos(at.x[0]), 0.09 + POLE * HALF**2
    assert tested.forces is not None
    (((wanted,), _),) = tested.forces.required(validation.force_inputs(at, at.v))
    weight = POLE * 9.81 * HALF * np.sin(at.x[0])
    swing = POLE * HALF * np.sin(at.x[0]) * at.v[1] ** 2  # of the pole on the cart
    cart = -(coupled * wanted + swing) / (CART + POLE)
    torque = coupled * cart + moment * wanted + weight
    assert found["expected inverse dynamics"] == pytest.approx([torque])
    a = np.abs([cart, wanted])
    sums = at.force_terms + at.gravity_terms + np.abs(at.H) @ a
    carried = abs(coupled) / (CART + POLE) * sums[0]
    assert found["inverse dynamics"] == pytest.approx([sums[1] + carried])


@pytest.mark.parametrize(("part", "passes"), [(0.95, True), (1.05, False)])
def test_require_agreement_tolerance(part: float, passes: bool) -> None:
    """1e-10 of the largest expected value plus 1e-13 of the terms, for each entry."""
    expected = np.array([0.0, -20.0, 5.0])
    for terms in (np.zeros(3), np.array([1e6, 0.0, 1e5])):
        allowed = 1e-10 * 20.0 + 1e-13 * terms
        for sign in (-1.0, 1.0):
            for k, error in enumerate(part * sign * allowed):
                found = expected.copy()
                found[k] += error
                if passes:
                    validation.require_agreement("it", "this", found, expected, terms)
                    continue
                off = abs(found[k] - expected[k])
                words = f"it disagrees with Pinocchio: this is off by {off:.3g} of 20\n"
                with pytest.raises(pinred.KernelMismatch, match=words):
                    validation.require_agreement("it", "this", found, expected, terms)
    validation.require_agreement("it", "this", np.zeros(0), np.zeros(0), 0.0)


def test_validation_tries_smaller_states(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sizes decrease to a thousandth; the first three defined states are compared."""
    tried: list[float] = []
    tested, validate_at = pushed(), validation._validate_at
    seen: list[ReferenceState] = []

    def smaller(_kernel: Kernel, rng: np.random.Generator, reach: float) -> ReferenceState | None:
        tried.append(reach)
        return random_state(tested, rng, 1.0) if reach < most else None

    def record(found: Kernel, at: ReferenceState) -> None:
        validate_at(found, at)
        seen.append(at)

    monkeypatch.setattr(validation, "random_state", smaller)
    monkeypatch.setattr(validation, "_validate_at", record)
    most = 0.0
    with pytest.raises(pinred.InputError, match="not finite at 80 of 80 random states"):
        validation.validate_kernel(tested)
    assert tried[:4] == [1.0] * 4
    ratios = np.array(tried[4:]) / tried[3:-1]
    assert ratios == pytest.approx(0.9)
    assert tried[-1] < 1e-3
    tried, most = [], 0.5
    validation.validate_kernel(tested)
    assert len(seen) == 3
    assert sum(reach < most for reach in tried) == 3
    most, seen = 1.001 * 0.9**76, []
    with pytest.raises(pinred.InputError, match="not finite at 79 of 80 random states"):
        validation.validate_kernel(tested)
    assert len(seen) == 1
