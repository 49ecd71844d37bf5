"""How large the terms are of which a kernel's numbers are sums: a cart and pole in closed form."""

from __future__ import annotations

import numpy as np
import pytest

import pinred
from pinred.kernels.judged_state import JudgedState, random_state
from pinred.simulation.compiled.kernel_of_plan import kernel_of
from pinred.simulation.plan import plan_of

CART, POLE, LEVER, MOMENT, G = 2.0, 1.0, 0.5, 0.09, 9.81  # of robots/cartpole.urdf, SI
REACH = LEVER + np.sqrt(0.19 / POLE)  # of the pole: its centre of mass and radius of gyration


def state() -> JudgedState:
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
    assert at.weight_terms == pytest.approx([(CART + POLE) * G, POLE * G * REACH])


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
