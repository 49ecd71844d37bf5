"""Tests of random states, and of the magnitudes of summed terms for a cart and pole."""

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


def random_cartpole_state() -> ReferenceState:
    """Return a random state of the cart and pole, with momentum along the slide."""
    system = pinred.load("cartpole")
    kernel = kernel_of(plan_of(pinred.Scene(system=system, seed=0)), zero_momentum=False)
    at = random_state(kernel, np.random.default_rng(3), 1.0)
    assert at is not None
    return at


def test_terms_equal_closed_form() -> None:
    """Terms of momenta, velocities, forces and gravity, before cancellation."""
    at = random_cartpole_state()
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


def test_random_states_cover_shapes_and_velocities() -> None:
    """Joints rotate fully, and the base has zero linear momentum."""
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
    # The linear momentum is zero, and its components share the largest terms.
    at = states[0]
    assert at is not None
    assert at.mu[:2] == pytest.approx([0.0, 0.0])
    terms = np.abs(at.H) @ np.abs(at.v)
    terms[:2] = terms[:2].max()
    assert at.momentum_terms == pytest.approx(terms)


def test_terms_scale_with_velocity() -> None:
    """Momenta scale linearly and forces quadratically, however small they are."""
    at = random_cartpole_state()
    slow = replace(at, v=1e-6 * at.v)
    assert slow.momentum_terms == pytest.approx(1e-6 * at.momentum_terms, rel=1e-9, abs=0.0)
    assert slow.velocity_terms == pytest.approx(1e-6 * at.velocity_terms, rel=1e-9, abs=0.0)
    assert slow.force_terms == pytest.approx(1e-12 * at.force_terms, rel=1e-9, abs=0.0)


def test_reach_is_largest_distance_from_root() -> None:
    """The reach is that of the farthest joint with its body, for any position of the root."""
    model = random_model("SE3", 4, 2)
    system = pinred.load(model)
    kernel = kernel_of(plan_of(pinred.Scene(system=system, seed=0)), zero_momentum=False)
    at = random_state(kernel, np.random.default_rng(3), 1.0)
    assert at is not None
    pin.forwardKinematics(
        at.model, at.data, pin.neutral(at.model)
    )  # other functions overwrite this data
    whole, data = [], system.model.createData()
    pin.forwardKinematics(system.model, data, at.q)
    for joint, body in list(zip(data.oMi, system.model.inertias, strict=True))[1:]:
        size = np.linalg.norm(body.lever) + np.sqrt(np.trace(body.inertia) / body.mass)
        whole.append(np.linalg.norm(joint.translation - data.oMi[1].translation) + size)
    assert at.reach == pytest.approx(max(whole))


def test_random_state_scales_shape_and_velocity() -> None:
    """A smaller state has proportionally smaller shape and velocity."""
    system = pinred.load("planar_chain5")
    kernel = kernel_of(plan_of(pinred.Scene(system=system, seed=0)), zero_momentum=False)
    whole, part = (random_state(kernel, np.random.default_rng(0), size) for size in (1.0, 0.1))
    assert whole is not None
    assert part is not None
    assert part.x == pytest.approx(0.1 * whole.x)
    assert part.v[3:] == pytest.approx(0.1 * whole.v[3:])


def test_random_states_cover_both_signs_and_the_time_span() -> None:
    """Angles and shapes have both signs; times cover 0 to 1 s or the span of a table."""
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
    # Tables of one kind share a kernel, whose states belong to the first of them.
    for table, first, last in (
        (pinred.signals.Spline, -3.0, 0.7),
        (pinred.signals.Linear, 0.0, 0.6),
    ):
        knots = np.linspace(first, last, 5)
        torque = forces.Torque({name: table(knots, np.sin(knots))})
        times = np.array([at.time for at in drawn(forces=torque)])
        assert 0.0 <= times.min() < 0.1
        assert 0.8 * last < times.max() <= last


def test_random_state_undefined_prescription_returns_none() -> None:
    """States at which a prescribed motion is undefined are skipped."""
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
