"""Springs, dampers and friction of a file, against MuJoCo, closed forms and ABA."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from aba import integrate, max_difference
from passive_trees import MujocoForces, passive_tree

import pinred
from pinred.common.arrays import Array
from pinred.forces import Damper, Force, Friction, Spring
from pinred.forces.force_model import ForceModel
from pinred.forces.force_numbers import ForceInputs

WIDTH = 0.05


def loaded(text: str) -> pinred.System:
    """Return the system of an MJCF text."""
    return pinred.load(mujoco.MjSpec.from_string(text))


def torque(system: pinred.System, forces: tuple[Force, ...], x: Array, xdot: Array) -> Array:
    """Return the joint torques of a system's forces, as simulations use them."""
    model, zero = ForceModel(system, forces, {}), np.zeros(system.r)
    return model.acting(ForceInputs(0.0, x, xdot, zero, zero, model.numbers)).torque


def without_friction(system: pinred.System) -> tuple[Force, ...]:
    """Return the springs and dampers of a file."""
    return tuple(force for force in system.passive if not isinstance(force, Friction))


def error(system: pinred.System, forces: tuple[Force, ...], judge: MujocoForces) -> float:
    """Return the largest difference from MuJoCo at random states, relative to the largest force."""
    rng, worst = np.random.default_rng(1), 0.0
    for _ in range(4):
        x, xdot = rng.normal(size=(2, system.m))
        expected = judge.at(x, xdot)
        result = torque(system, forces, x, xdot)
        worst = max(worst, float(np.abs(result - expected).max() / np.abs(expected).max()))
    return worst


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.sampled(3)
def test_springs_and_dampers_equal_mujoco(seed: int) -> None:
    """With polynomials, springref and ref, of hinges and slides, at random states."""
    text = passive_tree(seed)
    system = loaded(text)
    judge = MujocoForces(text, system.shape_names)
    assert error(system, without_friction(system), judge) < 1e-12
    loss = {force.joint: force.most for force in system.passive if isinstance(force, Friction)}
    losses = zip(system.shape_names, judge.frictionloss().tolist(), strict=True)
    assert loss == {name: most for name, most in losses if most}


def _planted(force: Force, what: str) -> Force:
    if what == "rest" and isinstance(force, Spring):
        return replace(force, rest=force.rest + 1e-3)
    if what == "sign" and isinstance(force, Damper):
        return replace(force, coefficient=-force.coefficient)
    if what == "power" and isinstance(force, (Spring, Damper)):
        return replace(force, polynomial=tuple(1.001 * k for k in force.polynomial))
    return force


@pytest.mark.parametrize("what", ["rest", "sign", "power"])
@pytest.mark.sampled
def test_planted_errors_are_detected(what: str) -> None:
    """A wrong rest position, a negative damper, a power wrong by a thousandth."""
    text = passive_tree(3)
    system = loaded(text)
    forces = tuple(_planted(force, what) for force in without_friction(system))
    assert forces != without_friction(system)
    assert error(system, forces, MujocoForces(text, system.shape_names)) > 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["compiled", "pinocchio"])
@pytest.mark.sampled
def test_passive_motion_equals_aba_with_mujoco_forces(engine: Any) -> None:
    """The motion with passive=True, against ABA under MuJoCo's torques."""
    text = passive_tree(5, smooth=True)
    system = loaded(text)
    judge = MujocoForces(text, system.shape_names)
    times = np.linspace(0.0, 1.0, 5)
    loss = judge.frictionloss()
    scene = pinred.Scene(system=system, seed=2, times=times, passive=True, friction=WIDTH)
    traj = pinred.simulate(scene, engine=engine)

    def tau(_t: float, q: Array, v: Array) -> Array:
        x, xdot = system.configuration(q).x, v[system.r :]
        dry = -loss * np.tanh(xdot / WIDTH)
        return np.concatenate([np.zeros(system.r), judge.at(x, xdot) + dry])

    start = scene.start
    q, v = integrate(
        system.model, system.q(start.pose, start.x), system.v(start.xi, start.xdot), times, tau
    )
    assert max_difference(system.model, traj.states.q, q) < 1e-7
    np.testing.assert_allclose(traj.states.v, v, atol=1e-7)
    without = pinred.simulate(replace(scene, passive=False, friction=None), engine=engine)
    assert np.abs(without.states.x - traj.states.x).max() > 1e-2


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, pytest.param(7, marks=pytest.mark.by_hand)])
def test_compare_and_balances_pass_with_passive_forces(seed: int) -> None:
    """Energy decreases by dampers and friction; momentum is constant."""
    system = loaded(passive_tree(seed, joints=4, smooth=True))
    traj = pinred.simulate(
        system, seed=1, duration=1.0, passive=True, friction=WIDTH, rtol=1e-9, atol=1e-11
    )
    report = pinred.compare(traj)
    assert report.passed, str(report)
    balance = traj.energy_balance
    dissipating = [f.label for f in system.passive if not isinstance(f, Spring)]
    assert sorted(balance.labels) == sorted(dissipating)
    assert (balance.work[-1] < 0.0).all()
    assert balance.energy[-1] < balance.energy[0] - 1e-3
    assert np.abs(balance.residual).max() < 1e-8 * balance.energy[0]
    np.testing.assert_allclose(
        traj.states.spatial_momentum, np.tile(traj.states.spatial_momentum[0], (201, 1)), atol=1e-9
    )


def sliders(dynamics: str) -> pinred.System:
    """Two masses on a line, one on the other: the reduced mass is 2·3/(2 + 3) kg."""
    link = (
        '<link name="{}"><inertial><mass value="{}"/><inertia ixx="1" iyy="1" izz="1" '
        'ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    text = (
        f'<robot name="sliders">{link.format("a", 2)}{link.format("b", 3)}'
        '<joint name="slide" type="prismatic"><parent link="a"/><child link="b"/>'
        f'<axis xyz="1 0 0"/><limit effort="1" velocity="1"/>{dynamics}</joint></robot>'
    )
    return pinred.load(pin.buildModelFromXML(text), group="R", gravity=[0, 0, 0])


@pytest.mark.parametrize("engine", ["compiled", "pinocchio"])
@pytest.mark.sampled
def test_friction_equals_closed_form(engine: Any) -> None:
    """For M v̇ = −f tanh(v/w), sinh(v/w) = exp(−f t/(M w)) from 3 w down to w/100."""
    system = sliders('<dynamics friction="0.5"/>')
    assert system.passive == (Friction("slide", 0.5),)
    M, f, w = 1.2, 0.5, 0.2
    times = np.linspace(0.0, 3.5, 9)
    traj = pinred.simulate(
        system, x0=[0.0], xdot0=[3.0 * w], times=times, friction=w, engine=engine
    )
    expected = w * np.arcsinh(np.sinh(3.0) * np.exp(-f * times / (M * w)))
    assert expected[-1] < 0.01 * w
    np.testing.assert_allclose(traj.states.xdot[:, 0], expected, atol=1e-9)
    balance = traj.energy_balance
    assert balance.labels == ("friction slide",)
    np.testing.assert_allclose(
        balance.work[:, 0], 0.5 * M * (expected**2 - expected[0] ** 2), atol=1e-9
    )


def test_damping_equals_closed_form() -> None:
    """For M v̇ = −c v, v = exp(−c t/M); friction is off by default."""
    system = sliders('<dynamics damping="0.7" friction="0.5"/>')
    times = np.linspace(0.0, 2.0, 5)
    traj = pinred.simulate(system, x0=[0.0], xdot0=[1.0], times=times, passive=True)
    np.testing.assert_allclose(traj.states.xdot[:, 0], np.exp(-0.7 * times / 1.2), atol=1e-9)
    assert "friction=WIDTH uses it" in traj.scene.left_out


def test_passive_forces_load_drive_of_prescribed_joint() -> None:
    """At other joints they act on the motion."""
    text = passive_tree(5, smooth=True)
    system = loaded(text)
    plan = {"j0": "0.3*sin(2*t)"}
    common: dict[str, Any] = {"seed": 2, "duration": 1.0, "prescribed": plan}
    traj = pinred.simulate(system, passive=True, **common)
    np.testing.assert_allclose(traj.states.x[:, 0], 0.3 * np.sin(2.0 * traj.t), atol=1e-12)
    assert np.abs(traj.energy_balance.residual).max() < 1e-8
    joint_forces = [
        force for force in without_friction(system) if getattr(force, "joint", "") != "j0"
    ]
    assert len(joint_forces) < len(without_friction(system))
    other = pinred.simulate(system, forces=joint_forces, **common)
    np.testing.assert_allclose(traj.states.x, other.states.x, atol=1e-8)


def test_polynomial_springs_and_dampers() -> None:
    """A spring with powers, and a damper whose even powers are odd in v."""
    cat = pinred.load("falling_cat")
    x, v = np.array([0.5, -0.2, 0.1]), np.array([-0.4, 0.3, 0.2])
    spring = Spring("bend", 2.0, 0.1, to="twist", polynomial=(0.5, 0.25, 0.125))
    a, b = (cat.shape_names.index(name) for name in ("bend", "twist"))
    y = x[a] - x[b] - 0.1
    expected = np.zeros(3)
    expected[a] = -(2.0 * y + 0.5 * y**2 + 0.25 * y**3 + 0.125 * y**4)
    expected[b] = -expected[a]
    np.testing.assert_allclose(torque(cat, (spring,), x, v), expected, rtol=1e-14)
    damper = Damper("bend", 2.0, polynomial=(0.5, 0.25, 0.125))
    u = v[a]
    expected = np.zeros(3)
    expected[a] = -u * (2.0 + 0.5 * abs(u) + 0.25 * u**2 + 0.125 * abs(u) ** 3)
    np.testing.assert_allclose(torque(cat, (damper,), x, v), expected, rtol=1e-14)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Friction("bend", -1.0), "must not be negative"),
        (lambda: Friction("bend", 1.0, 0.0), "width of a friction bend"),
        (lambda: Friction("bend", np.nan), "most of a friction bend must be finite"),
        (lambda: Spring("bend", 1.0, polynomial="12"), "must be a list of numbers"),  # type: ignore[arg-type]
        (lambda: Damper("bend", 1.0, polynomial=3.0), "must be a list of numbers"),  # type: ignore[arg-type]
        (lambda: Damper("bend", 1.0, polynomial=(np.inf,)), "must be finite"),
    ],
)
def test_invalid_passive_forces_are_rejected(make: Any, said: str) -> None:
    """The message has the name of the force."""
    with pytest.raises(pinred.InputError, match=said):
        make()


def test_friction_without_width_warns() -> None:
    """The message states the missing width."""
    with pytest.raises(pinred.InputError, match=r"friction bend has no width.*friction=0\.01"):
        pinred.Scene(system=pinred.load("falling_cat"), forces=Friction("bend", 1.0))
