"""How large the terms are of which a kernel's numbers are sums: a cart and pole in closed form."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from trees import random_model

import pinred
from pinred import forces
from pinred.kernels.reference_state import ReferenceState, random_state
from pinred.simulation.compiled.compiled_flow import kernel_of
from pinred.simulation.plan import plan_of

CART, POLE, LEVER, MOMENT, G = 2.0, 1.0, 0.5, 0.09, 9.81  # of robots/cartpole.urdf, SI
REACH = LEVER + np.sqrt(0.19 / POLE)  # of the pole: its centre of mass and radius of gyration


def state() -> ReferenceState:
    """A random one, with a velocity of its own: that of the judge has no momentum along R."""
    system = pinred.load("cartpole")
    kernel = kernel_of(plan_of(pinred.Scene(system=system, seed=0)), zero_momentum=False)
    at = random_state(kernel, np.random.default_rng(3), 1.0)
    assert at is not None
    return at


def test_terms() -> None:
    """Of momenta, velocities, forces and weights, before anything cancels."""
    at = state()
    coupled = -POLE * LEVER * np.cos(at.x[0])
    H = np.array([[CART + POLE, coupled], [coupled, MOMENT + POLE * LEVER**2]])
    assert pytest.approx(H) == at.H
    assert at.reach == pytest.approx(REACH)
    v = np.abs(at.v)
    momentum = np.abs(H) @ v
    assert at.momentum_terms == pytest.approx(momentum)
    inverse = np.abs(np.linalg.inv(H))
    assert at.velocity_terms == pytest.approx(inverse @ momentum + v)
    assert at.solved_terms(np.array([2.0, 3.0])) == pytest.approx(inverse @ [2.0, 3.0])
    speed = v[0] + REACH * v[1]
    moving = np.array([(CART + POLE) * speed * v[1], POLE * speed**2])
    assert at.force_terms == pytest.approx(v[1] * momentum + moving)
    assert at.gravity_terms == pytest.approx([(CART + POLE) * G, POLE * G * REACH])


def test_states_are_far_apart() -> None:
    """Joints go round, and velocities are those of a motion; what cannot be moves nothing."""
    system = pinred.load("planar_chain5")
    kernel = kernel_of(plan_of(pinred.Scene(system=system, seed=0)), zero_momentum=False)
    rng = np.random.default_rng(0)
    states = [random_state(kernel, rng, 1.0) for _ in range(20)]
    x = np.array([at.x for at in states if at is not None])
    v = np.array([at.v for at in states if at is not None])
    assert 1.9 < np.abs(x).max() <= 2.0
    assert 0.5 < v[:, 3:].std() < 2.0
    turns = np.array([at.pose[2] for at in states if at is not None])
    assert 0.3 < np.abs(turns).max() <= 1.0
    # The momentum of the base's translation is none, in all terms of its three components.
    at = states[0]
    assert at is not None
    assert at.mu[:2] == pytest.approx([0.0, 0.0])
    terms = np.abs(at.H) @ np.abs(at.v)
    terms[:2] = terms[:2].max()
    assert at.momentum_terms == pytest.approx(terms)


def test_terms_grow_with_velocities() -> None:
    """Momenta as they do, forces as their square, however small they are."""
    at = state()
    slow = replace(at, v=1e-6 * at.v)
    assert slow.momentum_terms == pytest.approx(1e-6 * at.momentum_terms, rel=1e-9, abs=0.0)
    assert slow.velocity_terms == pytest.approx(1e-6 * at.velocity_terms, rel=1e-9, abs=0.0)
    assert slow.force_terms == pytest.approx(1e-12 * at.force_terms, rel=1e-9, abs=0.0)


def test_reach() -> None:
    """Of the joint that is farthest from the root with its body, wherever the root stands."""
    model = random_model("SE3", 4, 2)
    system = pinred.load(model)
    kernel = kernel_of(plan_of(pinred.Scene(system=system, seed=0)), zero_momentum=False)
    at = random_state(kernel, np.random.default_rng(3), 1.0)
    assert at is not None
    pin.forwardKinematics(at.model, at.data, pin.neutral(at.model))  # as others leave it
    whole, data = [], system.model.createData()
    pin.forwardKinematics(system.model, data, at.q)
    for joint, body in list(zip(data.oMi, system.model.inertias, strict=True))[1:]:
        size = np.linalg.norm(body.lever) + np.sqrt(np.trace(body.inertia) / body.mass)
        whole.append(np.linalg.norm(joint.translation - data.oMi[1].translation) + size)
    assert at.reach == pytest.approx(max(whole))


def test_states_of_a_size() -> None:
    """Smaller ones have all of shape and velocity smaller, for momentum is linear in it."""
    system = pinred.load("planar_chain5")
    kernel = kernel_of(plan_of(pinred.Scene(system=system, seed=0)), zero_momentum=False)
    whole, part = (random_state(kernel, np.random.default_rng(0), size) for size in (1.0, 0.1))
    assert whole is not None
    assert part is not None
    assert part.x == pytest.approx(0.1 * whole.x)
    assert part.v[3:] == pytest.approx(0.1 * whole.v[3:])


def test_states_lie_on_all_sides() -> None:
    """Of angles and shapes both signs, of times all from 0 to 1 s, or of a table's."""
    system = pinred.load("planar_chain5")
    name = system.shape_names[0]

    def drawn(**options: Any) -> list[ReferenceState]:
        scene = pinred.Scene(system=system, seed=0, duration=0.5, **options)
        kernel, rng = kernel_of(plan_of(scene), zero_momentum=False), np.random.default_rng(0)
        return [at for _ in range(60) if (at := random_state(kernel, rng, 1.0)) is not None]

    states = drawn()
    x, turns = np.array([at.x for at in states]), np.array([at.pose[2] for at in states])
    times = np.array([at.time for at in states])
    for values, low, high in ((x, -2.0, 2.0), (turns, -1.0, 1.0), (times, 0.0, 1.0)):
        margin = 0.07 * (high - low)
        assert low <= values.min() < low + margin
        assert high - margin < values.max() <= high
    for first, last, count in ((-3.0, 0.7, 5), (0.0, 0.6, 6)):  # kernels of the same kind are one
        knots = np.linspace(first, last, count)
        torque = forces.Torque({name: pinred.signals.Spline(knots, np.sin(knots))})
        times = np.array([at.time for at in drawn(forces=torque)])
        assert 0.0 <= times.min() < 0.1
        assert 0.8 * last < times.max() <= last


def test_no_state_where_a_plan_is_not_defined() -> None:
    """Others are drawn instead."""
    system = pinred.load("planar_chain5")
    plan = {system.shape_names[1]: pinred.signals.Expression("sqrt(0.3 - t)")}
    scene = pinred.Scene(system=system, seed=0, prescribed=plan, duration=0.1)
    kernel, rng = kernel_of(plan_of(scene), zero_momentum=False), np.random.default_rng(0)
    states = [random_state(kernel, rng, 1.0) for _ in range(30)]
    found = [at for at in states if at is not None]
    assert 5 < len(found) < 25
    for at in found:
        assert at.time < at.force_parameters[0] if at.force_parameters.size else at.time < 0.3
        assert np.isfinite([*at.x, *at.v, *at.accelerations]).all()
