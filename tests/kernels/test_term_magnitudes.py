"""How much the judge of kernels allows: a part of what is expected, and round-off of its terms.

The sizes of those are compared with numbers of one body and of a cart and pole, worked out here.
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
from pinred.kernels import validation as judging
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

Judged = Callable[..., None]


def kernel(model: pin.Model, **options: Any) -> Kernel:
    """Return the kernel of a model."""
    scene = pinred.Scene(system=pinred.load(model), seed=0, **options)
    return kernel_of(plan_of(scene), zero_momentum=False)


def body(joint: pin.JointModel) -> pin.Model:
    """Return a body of 2 kg, 0.3 m beside a joint 5 m above the ground."""
    model = pin.Model()
    model.addJoint(0, joint, pin.SE3(np.eye(3), np.array([0.0, 0.0, HEIGHT])), "root")
    inertia = pin.Inertia(MASS, np.array([ARM, 0.0, 0.0]), np.diag([0.2, 0.2, 0.1]))
    model.appendBodyToJoint(1, inertia, pin.SE3.Identity())
    model.gravity.linear = np.array([0.0, 0.0, -G])
    return model


@cache
def pushed() -> Kernel:
    """Return the kernel of that body, free, with a thruster."""
    wrench = forces.Wrench(lambda _t, _x, _xdot, _mu: [*FORCE, *MOMENT])
    return kernel(body(pin.JointModelFreeFlyer()), forces=wrench)


def drawn(judged: Kernel) -> ReferenceState:
    """Return a random state."""
    at = random_state(judged, np.random.default_rng(0), 1.0)
    assert at is not None
    return at


def sizes(monkeypatch: pytest.MonkeyPatch, work: Callable[[], object]) -> dict[str, Array]:
    """Return the sizes of terms with which numbers are compared in some work, by what they are."""
    found: dict[str, Array] = {}

    def noted(_: str, what: str, _found: Array, expected: Array, terms: Array | float) -> None:
        found[what] = np.broadcast_to(np.asarray(terms, dtype=float), expected.shape)
        found[f"expected {what}"] = expected

    monkeypatch.setattr(judging, "require_agreement", noted)
    work()
    return found


def spinning() -> ReferenceState:
    """Return the free body's state where it turns about z, without momentum of translation."""
    line = np.array([1.0, 0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0, -G])
    return replace(
        drawn(pushed()), time=TIME, com_path=line, push=np.array([0.5, 0.0, 0.0, 0.0, 0.0, -4.0]),
        pose=np.array([0.0] * 6 + [1.0]), q=np.array([0.0] * 6 + [1.0]),
        v=np.array([0.0, -SPIN * ARM, 0.0, 0.0, 0.0, SPIN]),
    )  # fmt: skip


# Of the momenta, m v + m c × ω and m c × v + I ω, each the largest of three.
LINEAR = 2.0 * MASS * SPIN * ARM
ANGULAR = MASS * SPIN * ARM**2 + INERTIA[2, 2] * SPIN
H = SIZES_OF_H * np.array([[1, 1, 1, 1, 1, 1]] * 4 + [[1, 1, -1, 1, 1, 1]] * 2)
H[2, 4] *= -1.0
VELOCITY = np.abs(np.linalg.inv(H)) @ np.repeat([LINEAR, ANGULAR], 3)
VELOCITY += np.array([0.0, SPIN * ARM, 0.0, 0.0, 0.0, SPIN])
PARTS = 1.0 + 3.0 * TIME + 0.5 * G * TIME**2 + 0.5  # of the path of the centre of mass
SPEEDS = 3.0 + G * TIME + 4.0 / MASS
FAST = SPEEDS + VELOCITY[:3].sum() + REACH * VELOCITY[3:].sum() + 3.0 * LINEAR / MASS


def test_terms_of_the_full_state(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the path and its speed, of momenta, of the energy; the base stands at (1, 2, 0)."""
    judged, at = pushed(), spinning()
    where = judged.where
    out = np.zeros(where.size)
    out[where.fields["pose"]] = out[where.fields["q"]] = [1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    out[where.fields["v"]] = speed = [0.0, 0.0, 3.0, 0.0, 0.0, SPIN]
    found = sizes(monkeypatch, lambda: judging._validate_full_state(judged, at, out))
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


def test_terms_of_a_potential(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is part of the energy, with its sign and, in what may cancel, its size."""

    def compared(value: float) -> tuple[Array, Array]:
        model = body(pin.JointModelFreeFlyer())
        at = model.addJoint(1, pin.JointModelRX(), pin.SE3.Identity(), "joint")
        model.appendBodyToJoint(at, pin.Inertia.FromSphere(1.0, 0.2), pin.SE3(1))
        judged = kernel(model, forces=forces.PotentialEnergy(lambda x: value + 0.0 * x[0]))
        state = drawn(judged)
        out = judged.evaluate_outputs(state.time, state.y, state.parameters, state.com_path)
        found = sizes(monkeypatch, lambda: judging._validate_full_state(judged, state, out))
        return found["expected energy"], found["energy"]

    (first, terms), (second, more) = compared(1e-9), compared(-POTENTIAL)
    assert second - first == pytest.approx(-POTENTIAL)
    assert more - terms == pytest.approx(POTENTIAL)


def test_terms_of_what_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """As seen from the centre of mass."""
    judged, at = pushed(), spinning()
    out = np.zeros(judged.where.size)
    found = sizes(monkeypatch, lambda: judging._validate_momentum(judged, at, out))
    momenta = np.repeat([LINEAR, ANGULAR], 3)
    assert found["momentum of the velocity"] == pytest.approx(momenta)
    assert found["momentum"] == pytest.approx(momenta)
    assert found["velocity"] == pytest.approx(VELOCITY)
    assert found["centre of mass"] == pytest.approx(REACH)


def test_terms_of_rates_of_the_base(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the attitude half of the twist's, of the angular momentum N, c × F and μ × ω."""
    judged, at = pushed(), spinning()
    rate, wrench = np.zeros(judged.layout.base.size), np.append(FORCE, MOMENT)
    found = sizes(monkeypatch, lambda: judging._validate_velocity(judged, at, rate))
    assert found["attitude rate"] == pytest.approx([*(0.5 * VELOCITY[3:]), 0.0])
    found = sizes(monkeypatch, lambda: judging._validate_base(judged, at, rate, at.v, wrench))
    turning = 3.0 * ANGULAR * VELOCITY[3:].sum()
    moments = MOMENT + LEVER.T @ FORCE + turning
    assert found["rate of the angular momentum"] == pytest.approx(moments)
    assert found["rate of the centre of mass"] == pytest.approx([0.0, 0.0, 2.0, *FORCE])
    turned = replace(at, pose=np.array([0.0] * 5 + [1.0, 0.0]))  # half a turn about z
    found = sizes(monkeypatch, lambda: judging._validate_base(judged, turned, rate, at.v, wrench))
    assert found["expected rate of the centre of mass"][3:] == pytest.approx(-FORCE)
    assert found["rate of the centre of mass"][3:] == pytest.approx(FORCE)


def test_terms_of_a_weight_on_a_pivot(monkeypatch: pytest.MonkeyPatch) -> None:
    """The weight times the reach, whatever part of it turns the body."""
    judged = kernel(body(pin.JointModelSpherical()))
    at = replace(drawn(judged), v=np.array([0.0, 0.0, SPIN]))
    rate, none = np.zeros(judged.layout.base.size), np.zeros(3)
    found = sizes(monkeypatch, lambda: judging._validate_base(judged, at, rate, at.v, none))
    momentum = INERTIA[2, 2] * SPIN
    fast = np.abs(np.linalg.inv(INERTIA)).sum() * momentum + SPIN
    expected = MASS * G * REACH + 3.0 * momentum * fast
    assert found["rate of the angular momentum"] == pytest.approx([expected] * 3)


CART, POLE, HALF = 2.0, 1.0, 0.5  # of robots/cartpole.urdf, SI


def accelerated(
    monkeypatch: pytest.MonkeyPatch, **options: Any
) -> tuple[Kernel, ReferenceState, dict[str, Array]]:
    """Return a state of the cart and pole, and what accelerations and torques are sums of."""
    scene = pinred.Scene(system=pinred.load("cartpole"), seed=0, **options)
    judged = kernel_of(plan_of(scene), zero_momentum=False)
    at = drawn(judged)
    return judged, at, sizes(monkeypatch, lambda: judging._validate_at(judged, at))


def test_terms_of_accelerations(monkeypatch: pytest.MonkeyPatch) -> None:
    """H⁻¹ of inertial forces, torques, weights and H a; what is prescribed is known."""
    torque = forces.Torque(lambda *_: [40.0])
    _, at, found = accelerated(monkeypatch, forces=torque)
    a, given = np.abs(found["expected acceleration"]), np.array([0.0, 40.0])
    sums = at.force_terms + given + at.gravity_terms + np.abs(at.H) @ a
    assert found["acceleration"] == pytest.approx(np.abs(np.linalg.inv(at.H)) @ sums)
    plan = {"pole_pivot": pinred.signals.Expression("20*t**2")}
    _, at, found = accelerated(monkeypatch, prescribed=plan)
    a = np.abs([found["expected acceleration"][0], 2.0 * at.force_parameters[0]])  # of t²
    sums = at.force_terms[0] + at.gravity_terms[0] + np.abs(at.H[0]) @ a
    assert found["acceleration"] == pytest.approx([sums / (CART + POLE)])


def test_accelerations_beside_a_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a tree whose second joint follows one: H a + b = 0 in all other rows."""
    system = pinred.load(random_model("SE3", 3, 1))
    plan = {system.shape_names[1]: pinred.signals.Expression("20*t**2")}
    scene = pinred.Scene(system=system, seed=0, prescribed=plan)
    judged = kernel_of(plan_of(scene), zero_momentum=False)
    at = drawn(judged)
    found = sizes(monkeypatch, lambda: judging._validate_at(judged, at))
    data = at.model.createData()
    upper = np.triu(pin.crba(at.model, data, at.q))
    whole = upper + np.triu(upper, 1).T
    bias = pin.nonLinearEffects(at.model, data, at.q, at.v)
    free, planned = [k for k in range(9) if k != 7], 2.0 * at.force_parameters[0]  # of t²
    a = np.linalg.solve(whole[np.ix_(free, free)], -(bias[free] + whole[free, 7] * planned))
    assert found["expected acceleration"] == pytest.approx(a)


def test_terms_of_inverse_dynamics(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of the joint's own row, and of the cart's as far as that carries it along."""
    held = forces.ComputedTorque({"pole_pivot": 0.1}, kp=400.0, kd=20.0)
    judged, at, found = accelerated(monkeypatch, forces=held)
    coupled, moment = -POLE * HALF * np.cos(at.x[0]), 0.09 + POLE * HALF**2
    assert judged.forces is not None
    (((wanted,), _),) = judged.forces.required(*judging._force_arguments(at, at.v))
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
def test_what_is_allowed(part: float, passes: bool) -> None:
    """1e-10 of the largest that is expected, and 1e-13 of the terms, of each for itself."""
    expected = np.array([0.0, -20.0, 5.0])
    for terms in (np.zeros(3), np.array([1e6, 0.0, 1e5])):
        allowed = 1e-10 * 20.0 + 1e-13 * terms
        for sign in (-1.0, 1.0):
            for k, error in enumerate(part * sign * allowed):
                found = expected.copy()
                found[k] += error
                if passes:
                    judging.require_agreement("it", "this", found, expected, terms)
                    continue
                off = abs(found[k] - expected[k])
                words = f"it disagrees with Pinocchio: this is off by {off:.3g} of 20\n"
                with pytest.raises(pinred.KernelMismatch, match=words):
                    judging.require_agreement("it", "this", found, expected, terms)
    judging.require_agreement("it", "this", np.zeros(0), np.zeros(0), 0.0)


def test_where_forces_are_not_defined(monkeypatch: pytest.MonkeyPatch) -> None:
    """Smaller states are tried, down to a thousandth; the first three defined are judged."""
    tried: list[float] = []
    judged, judge_at = pushed(), judging._validate_at
    seen: list[ReferenceState] = []

    def smaller(_kernel: Kernel, rng: np.random.Generator, reach: float) -> ReferenceState | None:
        tried.append(reach)
        return random_state(judged, rng, 1.0) if reach < most else None

    def noted(found: Kernel, at: ReferenceState) -> None:
        judge_at(found, at)
        seen.append(at)

    monkeypatch.setattr(judging, "random_state", smaller)
    monkeypatch.setattr(judging, "_validate_at", noted)
    most = 0.0
    with pytest.raises(pinred.InputError, match="not finite at 80 of 80 random states"):
        judging.validate_kernel(judged)
    assert tried[:4] == [1.0] * 4
    ratios = np.array(tried[4:]) / tried[3:-1]
    assert ratios == pytest.approx(0.9)
    assert tried[-1] < 1e-3
    tried, most = [], 0.5
    judging.validate_kernel(judged)
    assert len(seen) == 3
    assert sum(reach < most for reach in tried) == 3
    most, seen = 1.001 * 0.9**76, []
    with pytest.raises(pinred.InputError, match="not finite at 79 of 80 random states"):
        judging.validate_kernel(judged)
    assert len(seen) == 1
