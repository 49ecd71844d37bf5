"""Long checks of robots with balls against independent integrations, run by hand."""

from __future__ import annotations

import time
from typing import Any

import aba
import mujoco
import numpy as np
import pinocchio as pin
import pytest
from ball_trees import ball_tree, joined_bodies, random_body

import pinred
from pinred.forces import BallSpring
from pinred.lie.rotations import quaternion_exp, quaternion_log, quaternion_product, rotation
from pinred.system.system import System

pytestmark = pytest.mark.by_hand

TWO_BODIES = """
<mujoco><option gravity="0 0 0" integrator="RK4" timestep="{h}"/><worldbody><body>
  <freejoint/><inertial pos="0 0 0" mass="2" diaginertia=".4 .5 .7"/>
  <body pos="0 0 .4"><joint type="ball"/>
    <inertial pos=".1 0 .3" mass="1" diaginertia=".2 .3 .4"/></body>
</body></worldbody></mujoco>
"""
START: dict[str, Any] = {
    "x0": {"joint": (0.5, 0.2, 0.1)},
    "xdot0": {"joint": (1.0, -0.5, 0.7)},
    "xi0": np.array([0.0, 0.0, 0.0, 0.3, 0.8, -0.2]),
}


@pytest.mark.parametrize("seed", range(8))
def test_trees_over_two_seconds_equal_aba(seed: int) -> None:
    """SciPy with ABA from an independent code, to 1e-12 of the growth of perturbations."""
    system = ball_tree(seed, 5)
    start = pinred.Scene(system=system, seed=seed, duration=2.0).start
    q0, v0 = system.sorted_q(start.pose, start.x), system.sorted_v(start.xi, start.xdot)
    expected, _ = aba.integrate(system.sorted_model, q0, v0, np.array([0.0, 2.0]), rtol=3e-14)
    traj = pinred.simulate(system, seed=seed, times=[2.0], rtol=1e-13, atol=1e-14)
    error = pin.difference(system.sorted_model, expected[-1], system.sort_q(traj.q[-1]))
    growth = pinred.compare(pinred.simulate(system, seed=seed, duration=2.0, rtol=1e-12)).growth
    assert np.abs(error).max() <= 1e-12 * max(1.0, float(growth[-1]))


def test_energy_drift_of_gauss_4_over_2000_seconds() -> None:
    """Two sprung bodies with the Cayley–Klein pair: 1e-7 between the first and the last 200 s."""
    times = np.linspace(0.0, 2000.0, 4001)
    traj = pinred.simulate(
        joined_bodies(), **START, forces=BallSpring("joint", 2.0, law="cosine"), times=times,
        method="Gauss(0.025, 4)",
    )  # fmt: skip
    error = traj.energy / traj.energy[0] - 1.0
    drift = abs(float(error[-400:].mean() - error[:400].mean()))
    assert drift <= 1e-7


def test_true_double_spherical_pendulum_passes_compare() -> None:
    """Two balls in gravity: the first is the pivot of the base, the second a joint."""
    model, rng = pin.Model(), np.random.default_rng(0)
    root = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "pivot")
    model.appendBodyToJoint(root, random_body(rng)[0], pin.SE3(np.eye(3), np.array([0, 0, -0.5])))
    place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -1.0]))
    ball = model.addJoint(root, pin.JointModelSpherical(), place, "elbow")
    model.appendBodyToJoint(ball, random_body(rng)[0], pin.SE3(np.eye(3), np.array([0, 0, -0.5])))
    system = System(model, name="double spherical pendulum")
    traj = pinred.simulate(
        system, x0={"elbow": (0.4, -0.3, 0.2)}, xdot0={"elbow": (0.5, 0.2, -0.1)},
        xi0=np.array([0.3, -0.6, 0.2]), duration=3.0, rtol=1e-11,
    )  # fmt: skip
    report = pinred.compare(traj)
    assert report.passed, str(report)


def test_two_bodies_take_a_hundredth_of_the_time_of_mujoco() -> None:
    """Both reach 5e-12 after 10 s; the steps of MuJoCo's RK4 are halved until it does."""
    system = joined_bodies()
    start = pinred.Scene(system=system, duration=10.0, **START).start
    q0, v0 = system.sorted_q(start.pose, start.x), system.sorted_v(start.xi, start.xdot)
    exact, _ = aba.integrate(system.sorted_model, q0, v0, np.array([0.0, 10.0]), rtol=3e-14)

    def error(x: np.ndarray, attitude: np.ndarray) -> float:
        sign = np.array([-1.0, -1.0, -1.0, 1.0])
        pairs = ((exact[-1][3:7], attitude), (exact[-1][7:], x))
        return max(
            float(np.abs(quaternion_log(quaternion_product(sign * a, b))).max()) for a, b in pairs
        )

    flow = pinred.flow(system, **START, times=[10.0], method="DOP853", rtol=3e-13, atol=1e-13)
    state: Any = flow()
    assert error(state.x[-1], state.pose[-1, 3:]) <= 5e-12
    rounds = []
    for _ in range(50):
        began = time.perf_counter()
        flow()
        rounds.append(time.perf_counter() - began)
    ours = float(np.median(rounds))
    h, theirs = 0.01, np.inf
    while h > 1e-5:
        model: Any = mujoco.MjModel.from_xml_string(TWO_BODIES.format(h=h))
        data: Any = mujoco.MjData(model)
        data.qpos[3:7], data.qpos[7:11] = np.roll(start.pose[3:], 1), np.roll(start.x, 1)
        data.qvel[:3], data.qvel[3:6] = 0.0, start.xi[3:]
        data.qvel[6:9] = start.xdot
        began = time.perf_counter()
        mujoco.mj_step(model, data, round(10.0 / h))
        theirs = time.perf_counter() - began
        if error(np.roll(data.qpos[7:11], -1), np.roll(data.qpos[3:7], -1)) <= 5e-12:
            break
        h *= 0.5
    else:
        pytest.fail("MuJoCo does not reach 5e-12")
    print(f"pinred {1e3 * ours:.3f} ms, MuJoCo {1e3 * theirs:.1f} ms at h = {h:g}")
    assert ours <= 0.01 * theirs


def test_attitudes_of_flat_rotor_equal_closed_form() -> None:
    """A tri-axial body carries a spherical rotor: it moves as if alone, the rotor spins freely."""
    moments = np.array([[0.4, 0.5, 0.7], [0.2, 0.2, 0.2]])
    system = joined_bodies(moments, np.zeros((2, 3)))
    xi, sigma = np.array([0.0, 0.0, 0.0, 1.0, 2.0, -0.5]), np.array([0.5, -1.5, 2.0])
    traj = pinred.simulate(
        system, xi0=xi, xdot0=sigma, x0=[0, 0, 0, 1], duration=3.0, rtol=1e-13, atol=1e-14
    )
    spin = xi[3:] + sigma  # of the rotor in space, constant
    found = quaternion_product(traj.pose[:, 3:], traj.x)
    expected = quaternion_exp(traj.t[:, None] * spin)
    assert np.abs(rotation(found) - rotation(expected)).max() <= 1e-12
