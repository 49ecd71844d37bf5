"""Tests of the round-off that validation allows: at least the magnitude of all summed terms.

A sum is never larger than the total magnitude of its terms, whatever cancels.
"""

from __future__ import annotations

from collections.abc import Callable
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
from pinred.kernels.validation import force_inputs
from pinred.simulation.compiled.compiled_flow import kernel_of
from pinred.simulation.plan import plan_of


def kernel(group: str, gravity: float = 0.0, **options: Any) -> Kernel:
    """Return the kernel of a tree with three joints."""
    model = random_model(group, 3, 1)
    model.gravity.linear = gravity * np.array([1.0, -2.0, 3.0])
    scene = pinred.Scene(system=pinred.load(model), seed=0, **options)
    return kernel_of(plan_of(scene), zero_momentum=False)


def cancelling_wrench(force: float) -> Kernel:
    """Return the kernel of a body whose moments about the centre of mass cancel."""
    model = pin.Model()
    at = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    com = np.array([0.3, -0.2, 0.1])
    body = pin.Inertia(1.0, com, np.diag([0.3, 0.4, 0.5]))
    model.appendBodyToJoint(at, body, pin.SE3.Identity())
    model.gravity.setZero()
    F = force * np.array([1.0, 2.0, -1.0])
    whole = [
        *F,
        *np.cross(com, F),
    ]  # a function, because validation replaces numbers by random ones
    wrench = forces.Wrench(lambda _t, _x, _xdot, _mu: whole)
    scene = pinred.Scene(system=pinred.load(model), seed=0, forces=wrench)
    return kernel_of(plan_of(scene), zero_momentum=False)


def large_potential(stiffness: float) -> Kernel:
    """Return the kernel of a tree whose potential exceeds its kinetic energy by far."""
    energy = forces.PotentialEnergy(lambda x: stiffness * (1.0 + x[0] ** 2))
    return kernel("SE3", forces=energy)


def large_acceleration(size: float) -> Kernel:
    """Return the kernel of a tree with a prescribed joint of large acceleration."""
    system = pinred.load(random_model("SE3", 3, 1))
    plan = {system.shape_names[1]: pinred.signals.Expression(f"{size}*t**2")}
    scene = pinred.Scene(system=system, seed=0, prescribed=plan)
    return kernel_of(plan_of(scene), zero_momentum=False)


def forces_before_cancellation(tested: Kernel, at: ReferenceState, a: Array) -> Array:
    """Return |H⁻¹| (|inertial| + |gravity| + |applied| + |H| |a|), by Pinocchio."""
    system, still = tested.system, at.model.copy()
    still.gravity.setZero()
    data, full = still.createData(), system.joint_rates(at.v)
    sizes = np.abs(system.on_shape(pin.nonLinearEffects(still, data, at.q, full)))
    sizes += np.abs(system.on_shape(pin.computeGeneralizedGravity(at.model, data, at.q)))
    if tested.forces is not None:
        acting = tested.forces.acting(force_inputs(at, at.v))
        sizes += np.abs(np.append(acting.wrench, acting.torque))
    whole = np.zeros(system.n)
    whole[at.free] = np.abs(a)
    whole[[system.r + k for k in at.prescribed]] = np.abs(at.accelerations)
    sizes += np.abs(at.H) @ whole
    inverse = np.linalg.inv(at.H[np.ix_(at.free, at.free)])
    return np.asarray(np.abs(inverse) @ sizes[at.free])


KERNELS: list[Callable[[], Kernel]] = [
    lambda: kernel("SE3"),
    lambda: kernel("SE3", 5.0),
    lambda: kernel("SO3", 1e6, outputs="shape"),
    lambda: kernel("RxSE2"),
    lambda: kernel("SE3", forces=forces.Torque(lambda *_: [1e6, 2e6, -1e6])),
    lambda: cancelling_wrench(1e9),
    lambda: large_potential(1e9),
    lambda: large_acceleration(100.0),
]


@pytest.mark.parametrize("make", KERNELS)
def test_terms_bound_all_compared_values(
    make: Callable[[], Kernel], monkeypatch: pytest.MonkeyPatch
) -> None:
    """At all states each compared value is at most the magnitude of its terms."""
    states: list[ReferenceState] = []
    seen: list[tuple[str, Array, Array]] = []
    require_agreement = validation.require_agreement

    def drawn(*arguments: Any) -> ReferenceState | None:
        at = random_state(*arguments)
        states.extend([at] if at is not None else [])
        return at

    def record(
        _: str, what: str, found: Array, expected: Array, terms: Array | float, **kinds: Any
    ) -> None:
        require_agreement("it", what, found, expected, terms, **kinds)
        seen.append((what, expected, np.broadcast_to(terms, expected.shape)))
        if what == "acceleration":
            needed = forces_before_cancellation(tested, states[-1], expected)
            seen.append(("forces", needed, seen[-1][2]))

    tested = make()
    monkeypatch.setattr(validation, "random_state", drawn)
    monkeypatch.setattr(validation, "require_agreement", record)
    validation.validate_kernel(tested)
    assert len(states) == 3
    for what, expected, terms in seen:
        assert (np.abs(expected) <= (1.0 + 1e-9) * terms).all(), what


def test_terms_of_moments_include_cancelling_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """A force without moment about the centre of mass has terms of its lever and its torque."""
    tested, sizes, require_agreement = cancelling_wrench(1e9), [], validation.require_agreement
    states: list[ReferenceState] = []

    def drawn(*arguments: Any) -> ReferenceState | None:
        at = random_state(*arguments)
        states.extend([at] if at is not None else [])
        return at

    def record(
        _: str, what: str, found: Array, expected: Array, terms: Array | float, **kinds: Any
    ) -> None:
        if what == "rate of the angular momentum":
            sizes.append(np.array(terms))
            gyroscopic = np.cross(states[-1].mu[3:], states[-1].v[3:])
            assert np.abs(expected - gyroscopic).max() < 1.0
        require_agreement("it", what, found, expected, terms, **kinds)

    monkeypatch.setattr(validation, "random_state", drawn)
    monkeypatch.setattr(validation, "require_agreement", record)
    validation.validate_kernel(tested)
    c, F = np.array([0.3, 0.2, 0.1]), 1e9 * np.array([1.0, 2.0, 1.0])
    lever = np.abs(pin.skew(c)) @ F
    N = 1e9 * np.abs(np.cross([0.3, -0.2, 0.1], [1.0, 2.0, -1.0]))
    assert len(sizes) == 3
    for terms in sizes:
        assert (terms >= 0.999 * (lever + N)).all()


def test_in_space_agrees_with_pinocchio() -> None:
    """With a wrench and in free fall, centre of mass and momentum agree with Pinocchio."""
    tested = kernel("SE3", 5.0, forces=forces.Wrench([0.3, 0.0, 0.2, 0.0, 0.1, 0.0]))
    at = random_state(tested, np.random.default_rng(2), 1.0)
    assert at is not None
    assert np.abs(at.push).min() > 0.01
    system, base = tested.system, at.in_space(at.v)
    model, data = system.model, system.model.createData()
    q = system.q(base.pose, at.x)
    v = system.joint_rates(np.concatenate([base.xi, at.v[6:]]))
    pin.centerOfMass(model, data, q, v)
    root = model.jointPlacements[1]
    c0, v0, fall = at.com_path.reshape(3, 3)
    t, mass = at.time, sum(body.mass for body in model.inertias)
    com = root.actInv(data.com[0])
    np.testing.assert_allclose(com, c0 + v0 * t + 0.5 * fall * t**2 + at.push[:3], atol=1e-12)
    velocity = root.rotation.T @ data.vcom[0]
    np.testing.assert_allclose(velocity, v0 + fall * t + at.push[3:] / mass, atol=1e-12)
    pin.computeCentroidalMomentum(model, data, q, v)
    linear = root.rotation.T @ data.hg.linear
    angular = root.rotation.T @ data.hg.angular + np.cross(com, linear)
    np.testing.assert_allclose(base.J, np.append(linear, angular), atol=1e-11)
