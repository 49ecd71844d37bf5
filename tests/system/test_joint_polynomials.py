"""Joint equalities of MJCF with polynomials of higher degree, against MuJoCo's own constraint."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import pinred
from pinred.common.arrays import Array
from pinred.common.errors import InputError
from pinred.system.loops.kinematics import loop_jacobian, loop_kinematics, loop_values
from pinred.system.loops.loop import JointPolynomial

KNEE = """
<mujoco model="knee">
  <compiler angle="radian"/>
  <option gravity="0 0 0"><flag contact="disable"/></option>
  <worldbody>
    <body name="base"><freejoint name="float"/><geom size=".1" mass="2"/>
      <body name="thigh" pos=".1 0 0"><joint name="hip" axis="0 1 0" ref=".2"/>
        <geom size=".05" pos="0 .02 -.2" mass="1"/>
        <body name="shin" pos="0 0 -.4">
          <joint name="glide" type="slide" axis="1 0 .2" ref=".1"/>
          <joint name="knee" axis="0 1 .1" ref="-.3"/>
          <geom size=".04" pos=".01 0 -.2" mass=".7"/>
          <body name="cap" pos="0 .05 0"><joint name="cap" axis="0 0 1"/>
            <geom size=".03" pos=".06 0 0" mass=".2"/></body>
        </body>
      </body>
    </body>
  </worldbody>
  <equality>
    <joint name="glides" joint1="glide" joint2="knee" polycoef=".02 .05 .1 -.04 .03"/>
    <joint name="caps" joint1="cap" joint2="knee" polycoef="0 .5 .2"/>
    {more}
  </equality>
</mujoco>
"""


def knee(more: str = "") -> tuple[mujoco.MjModel, pinred.System]:
    """Return the leg in MuJoCo, and as a system."""
    model = mujoco.MjModel.from_xml_string(KNEE.format(more=more))
    return model, pinred.load(model)


def mujoco_state(model: mujoco.MjModel, system: pinred.System, x: Array) -> mujoco.MjData:
    """Return MuJoCo's data at a shape, with the base at the identity."""
    data = mujoco.MjData(model)
    for name, value in zip(system.shape_names, x, strict=True):
        data.qpos[model.joint(name).qposadr] = value
    mujoco.mj_forward(model, data)
    return data


def test_polynomial_of_joints_has_mujocos_residual_and_jacobian() -> None:
    """At random states; φ counts from the reference configuration."""
    model, system = knee()
    assert system.closure is not None
    assert [loop.name for loop in system.loops] == ["glides", "caps"]
    assert (system.m, system.closure.rank, system.shape_dim) == (4, 2, 2)
    rng, h = np.random.default_rng(0), 1e-5
    at = [int(model.joint(name).dofadr[0]) for name in system.shape_names]
    for _ in range(5):
        x, xdot = rng.uniform(-1.0, 1.0, (2, system.m))
        data = mujoco_state(model, system, x)
        J = data.efc_J.reshape(-1, model.nv)[:, at]
        np.testing.assert_allclose(loop_values(system, x), data.efc_pos, atol=1e-15)
        np.testing.assert_allclose(loop_jacobian(system, x), J, atol=1e-15)
        before, after = (
            mujoco_state(model, system, x + s * h * xdot).efc_J.reshape(-1, model.nv)[:, at]
            for s in (-1.0, 1.0)
        )
        q, v = system.q([0] * 6 + [1], x), np.append(np.zeros(6), xdot)
        rate = loop_kinematics(system).jacobian_rate(q, v)[:, 6:]
        np.testing.assert_allclose(rate, (after - before) / (2.0 * h), atol=1e-9)


def test_motion_with_polynomial_passes_compare_and_has_its_force() -> None:
    """The force on the follower is that of MuJoCo's hard constraint."""
    model, system = knee()
    traj = pinred.simulate(
        system, x0={"knee": 0.4, "hip": 0.1}, xdot0={"knee": 2.0, "hip": -1.0}, duration=0.5
    )
    report = pinred.compare(traj)
    assert report.passed, str(report)
    assert "glides: glide is a polynomial of degree 4 in knee" in str(pinred.inspect(system))
    data = mujoco.MjData(model)
    data.qpos[:] = np.concatenate([traj.q[-1][:3], np.roll(traj.q[-1][3:7], 1), traj.q[-1][7:]])
    # MuJoCo's linear velocity of a free joint is in world axes, Pinocchio's in body axes.
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, data.qpos[3:7])
    data.qvel[:] = np.concatenate([R.reshape(3, 3) @ traj.v[-1][:3], traj.v[-1][3:]])
    mujoco.mj_forward(model, data)
    H, J, h = np.zeros((model.nv, model.nv)), data.efc_J.reshape(2, -1).copy(), 1e-6
    mujoco.mj_fullM(model, data, H)
    speed, bias = data.qvel.copy(), data.qfrc_bias.copy()
    mujoco.mj_integratePos(model, data.qpos, speed, h)
    mujoco.mj_forward(model, data)
    drift = (data.efc_J.reshape(2, -1) - J) @ speed / h
    response = np.linalg.solve(H, np.column_stack([bias, J.T]))
    forces = np.linalg.solve(J @ response[:, 1:], J @ response[:, 0] - drift)
    found = np.concatenate([traj.loop_forces[name][-1] for name in ("glides", "caps")])
    np.testing.assert_allclose(found, forces, rtol=1e-5)


def test_polynomials_of_a_call_name_unknown_joints() -> None:
    """A JointPolynomial can be passed to load like a Loop; degree one stays a coupling."""
    laws = [JointPolynomial("twist", "bend", (0.0, 0.0, 0.5))]
    cat = pinred.load("falling_cat", loops=laws)
    x = np.array([0.3, 0.4, 0.5])
    names = dict(zip(cat.shape_names, x, strict=True))
    assert loop_values(cat, x) == pytest.approx([names["twist"] - 0.5 * names["bend"] ** 2])
    with pytest.raises(InputError, match=r"'f' needs a hinge or slide 'bent' .*mean 'bend'"):
        pinred.load("falling_cat", loops=[JointPolynomial("twist", "bent", (0, 0, 1), name="f")])
    _, system = knee('<joint joint1="hip" joint2="knee" polycoef=".1 .5"/>')
    assert (len(system.couplings), system.shape_dim) == (1, 1)
