"""Gravity loads in closed form, and motions so small that gravity loads dominate."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.judge.audit import audit_states, audit_trajectory, equation_errors
from pinred.judge.full_system import gravity_load_sizes
from pinred.judge.reference_solution import FullState

MASS, LEVER, MOMENTS, G = 2.0, 0.3, (0.02, 0.03, 0.01), 9.81


@cache
def pendulum() -> pinred.System:
    """Build a body on a pivot that hangs along −z."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -G])
    body = pin.Inertia(MASS, np.array([0.0, 0.0, -LEVER]), np.diag(MOMENTS))
    root = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "pivot")
    model.appendBodyToJoint(root, body, pin.SE3.Identity())
    return pinred.load(model)


def swing(angle: float) -> pinred.Trajectory:
    """Simulate a swing of the given amplitude [rad]."""
    pose0 = [np.sin(0.5 * angle), 0.0, 0.0, np.cos(0.5 * angle)]
    spin = [0.0, 0.3 * angle, 0.0]
    return pinred.simulate(pendulum(), pose0=pose0, xi0=spin, rtol=1e-9, duration=2.0)


@pytest.mark.parametrize("angle", [1e-7, 1e-5, 1e-3, 1.0])
@pytest.mark.sampled
def test_compare_of_small_swings_passes(angle: float) -> None:
    """The gravity moment consists of cancelling numbers; rotations have an accuracy of rtol."""
    report = pinred.compare(swing(angle))
    assert report.passed, str(report)


def test_compare_of_small_swings_of_joints_passes() -> None:
    """A double pendulum near its hanging state."""
    system = pinred.load("double_spherical_pendulum")
    for size in (1e-6, 1e-4):
        x0 = size * np.array([1.0, -0.5, 0.3, 0.8])[: system.m]
        report = pinred.compare(pinred.simulate(system, x0=x0, duration=2.0))
        assert report.passed, f"{size}: {report}"


def test_compare_of_small_swings_with_wrong_centre_of_mass_fails() -> None:
    """The centre of mass is wrong by 1e-9 of the lever."""
    model = pendulum().model.copy()
    model.inertias[1].lever = np.array([0.0, 3e-9, -LEVER])
    traj = swing(1e-5)
    wrong = FullState(pinred.Scene(system=pinred.load(model), xi0=np.zeros(3), duration=2.0))
    assert equation_errors(traj, wrong, traj.t).max() > 1e-10


def test_gravity_loads_do_not_cancel() -> None:
    """Two balanced bodies on a hinge both count; prismatic joints count the mass alone."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 3.0, -4.0])
    slide = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    beam = model.addJoint(slide, pin.JointModelRY(), pin.SE3.Identity(), "beam")
    tip = model.addJoint(
        beam, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.4, 0.0, 0.0])), "tip"
    )
    for joint, mass, lever in ((slide, 7.0, 0.0), (beam, 2.0, -0.2), (tip, 1.0, 0.0)):
        body = pin.Inertia(mass, np.array([lever, 0.0, 0.0]), 0.01 * np.eye(3))
        model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    data, q = model.createData(), pin.neutral(model)
    assert pin.computeGeneralizedGravity(model, data, q)[1] == pytest.approx(0.0, abs=1e-15)
    (result,) = gravity_load_sizes(model, data, q[None])
    assert result == pytest.approx([10.0 * 5.0, 5.0 * (2.0 * 0.2 + 1.0 * 0.4), 0.0])
    model.gravity.linear = np.zeros(3)
    assert not gravity_load_sizes(model, data, q[None]).any()


def drift_after_work(traj: pinred.Trajectory, work: float) -> float:
    """Return the energy drift after artificial work at the end."""
    done = np.append(np.zeros(len(traj.t) - 1), work)
    return float(audit_states(FullState(traj.scene), traj.states, done, None).energies[-1])


def test_energy_unit_of_pendulum_is_gravity_moment() -> None:
    """The unit is the kinetic energy, or the largest gravity moment times 1 rad if larger."""
    for angle in (1e-4, 1.0):
        traj = swing(angle)
        states = traj.states
        inertia = np.diag(MOMENTS) + MASS * LEVER**2 * np.diag([1.0, 1.0, 0.0])
        kinetic = 0.5 * np.einsum("ti,ij,tj->t", states.xi, inertia, states.xi).max()
        x, y, z, w = states.pose.T
        down = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x)])  # components of the body's axes
        slopes = MASS * G * LEVER * np.abs(down).sum(axis=0).max()
        unit = max(kinetic, slopes)
        assert drift_after_work(traj, 1e-3 * unit) == pytest.approx(-1e-3, rel=1e-3)


def test_energy_unit_of_spring_is_stiffness() -> None:
    """For a pole on a spring without gravity the unit is its slope at the position times 1 rad."""
    system = pinred.load("cartpole", gravity=np.zeros(3))
    for aside, rate in ((1e-4, 0.0), (1e-4, 5.0)):
        spring = {system.shape_names[0]: (3.0, 0.5)}
        traj = pinred.simulate(
            system, x0=[0.5 + aside], xdot0=[rate], xi0=[0.0], springs=spring, times=[0.0, 1e-3]
        )
        internal = (
            0.5 * (0.09 + 0.25 - 0.25 / 3.0 * np.cos(0.5) ** 2) * rate**2
        )  # data of robots/cartpole
        slope = 3.0 * np.abs(traj.x[:, 0] - 0.5).max()
        unit = max(internal, slope)
        assert drift_after_work(traj, 1e-3 * unit) == pytest.approx(-1e-3, rel=2e-2)


def test_energy_unit_of_falling_robot_ignores_gravity() -> None:
    """A slow internal motion is measured by its kinetic energy, whatever the mass."""
    cat = pinred.load("falling_cat", gravity=[1.0, -2.0, -9.0])
    slow = 1e-2 * np.ones(cat.m)
    traj = pinred.simulate(
        cat, x0=np.full(cat.m, 0.4), xdot0=slow, xi0=np.zeros(6), times=[0, 1e-3]
    )
    states, model, data = traj.states, cat.model, cat.model.createData()
    pin.ccrba(model, data, states.q[0], states.v[0])
    carried = 0.5 * float(data.hg.linear @ data.hg.linear) / data.Ig.mass
    internal = pin.computeKineticEnergy(model, data, states.q[0], states.v[0]) - carried
    assert internal < 1e-3
    assert drift_after_work(traj, 1e-2 * internal) == pytest.approx(-1e-2, rel=1e-2)


def test_energy_drift_ignores_round_off_of_height() -> None:
    """Far up, 6e-14 of the potential energy counts as zero."""
    cat = pinred.load("falling_cat", gravity=[0.0, 0.0, -9.81])
    pose0 = [0.0, 0.0, 1e6, 0.0, 0.0, 0.0, 1.0]
    traj = pinred.simulate(cat, pose0=pose0, xdot0=np.ones(cat.m), times=[0.0, 1e-3])
    height = cat.mass * 9.81 * 1e6
    assert drift_after_work(traj, 0.8 * 6e-14 * height) == 0.0
    assert drift_after_work(traj, 1.2 * 6e-14 * height) != 0.0


def test_momentum_unit_of_pendulum_is_gravity_impulse() -> None:
    """√(m W) times the radius of gyration, or W times the duration if smaller."""
    weight, radius = MASS * G * LEVER, np.sqrt(sum(MOMENTS) / MASS)
    for duration, expected in ((2.0, radius * np.sqrt(MASS * weight)), (1e-3, weight * 1e-3)):
        traj = swing(1e-5)
        times = np.linspace(0.0, duration, 5)
        states = traj(times)
        impulse = np.zeros((5, 3))
        impulse[-1, 0] = 1e-4 * expected
        values = states.spatial_momentum - states.spatial_momentum[0]
        result = audit_states(FullState(traj.scene), states, np.zeros(5), values + impulse).momenta
        assert result[-1, 0] == pytest.approx(-1e-4, rel=1e-6)
    assert audit_trajectory(swing(1e-5), swing(1e-5).states).momentum < 1e-7
