"""Rates, torques, limits of the robot's file, and attitudes in degrees over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from figures import drawn
from scipy.spatial.transform import Rotation

import pinred
from pinred import plots
from pinred.cli.command_line import main
from pinred.system.passive import joint_limits

ARM = """<robot name="arm">
  <link name="hull"><inertial><mass value="4"/>
    <inertia ixx="1" iyy="2" izz="1.5" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="upper"><inertial><origin xyz="0.3 0 0"/><mass value="1"/>
    <inertia ixx="0.1" iyy="0.2" izz="0.2" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0.2 0 0"/><mass value="0.5"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="hull"/><child link="upper"/>
    <origin xyz="0.5 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-0.2" upper="1.0" velocity="2.5" effort="0.8"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.6 0 0"/><axis xyz="0 1 0"/><limit velocity="0" effort="3"/></joint>
</robot>"""


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> pinred.Trajectory:
    """Simulate an arm on a floating hull, with a spring and a prescribed joint."""
    path = tmp_path_factory.mktemp("robot") / "arm.urdf"
    path.write_text(ARM)
    return pinred.simulate(
        pinred.load(path, gravity=(0, 0, 0)), x0=[0.3, 0.0], xdot0=[1.0, 0.4], duration=1.5,
        momentum=[0.1, 0, 0, 1.5, -0.4, 2.0], springs={"shoulder": (2.0, 0.1)},
        prescribed={"elbow": "0.4*t"},
    )  # fmt: skip


def test_limits_of_file_are_those_of_its_text(arm: pinred.Trajectory) -> None:
    """A continuous joint has no position limit; a rate limit of zero is none."""
    limits, inf = joint_limits(arm.system), np.inf
    np.testing.assert_array_equal(limits.position, [[-0.2, 1.0], [-inf, inf]])
    np.testing.assert_array_equal(limits.rate, [[-2.5, 2.5], [-inf, inf]])
    np.testing.assert_array_equal(limits.effort, [[-0.8, 0.8], [-3.0, 3.0]])


def test_rates_and_torques_are_those_of_the_trajectory(arm: pinred.Trajectory) -> None:
    """With units of the joints; the torque of a spring in closed form."""
    (axes,) = plots.rates(arm).axes
    np.testing.assert_array_equal(drawn(axes, "shoulder")[1], arm.xdot[:, 0])
    assert axes.get_ylabel() == "[rad/s]"
    (axes,) = pinred.plot(arm, "torques", joints=["shoulder"]).axes
    expected = 2.0 * (0.1 - arm.x[:, 0])
    np.testing.assert_allclose(drawn(axes, "shoulder")[1], expected, atol=1e-14)
    assert axes.get_ylabel() == "shoulder [N·m]"


def test_limits_are_drawn_as_shares_and_the_largest_is_named(arm: pinred.Trajectory) -> None:
    """Positions from the middle of their range, others from zero; lines at both limits."""
    figure = plots.limits(arm)
    position, rate, torque = figure.axes
    assert [axes.get_ylabel() for axes in figure.axes] == [
        "position / limit", "rate / limit", "torque / limit",
    ]  # fmt: skip
    np.testing.assert_allclose(drawn(position, "shoulder")[1], (arm.x[:, 0] - 0.4) / 0.6)
    np.testing.assert_allclose(drawn(rate, "shoulder")[1], arm.xdot[:, 0] / 2.5)
    np.testing.assert_allclose(drawn(torque, "elbow")[1], arm.torques[:, 1] / 3.0)
    shares = [(arm.x[:, 0] - 0.4) / 0.6, arm.xdot[:, 0] / 2.5, arm.torques[:, 0] / 0.8]
    shares.append(arm.torques[:, 1] / 3.0)
    largest = [float(np.abs(share).max()) for share in shares]
    names = ["position of shoulder", "rate of shoulder", "torque of shoulder", "torque of elbow"]
    words = f"largest {max(largest):.3g} of the limit, {names[int(np.argmax(largest))]}"
    assert figure.get_suptitle() == f"arm: limits of the file ({words})"
    assert max(largest) > 1.0
    assert all({-1.0, 1.0} <= {float(line.get_ydata()[0]) for line in axes.lines}  # type: ignore[index,arg-type]
               for axes in figure.axes)  # fmt: skip
    with pytest.raises(pinred.InputError, match="the file of 'elroys_beanie' states no limits of"):
        plots.limits(pinred.simulate(pinred.load("elroys_beanie"), duration=0.1))


def test_recordings_have_rates_and_limits_but_no_torques(
    arm: pinred.Trajectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A .npz file contains no forces; the command says what to plot instead."""
    robot, file = tmp_path / "arm.urdf", tmp_path / "run.npz"
    robot.write_text(ARM)
    arm.save(file)
    recording = pinred.read_recording(file, str(robot))
    assert len(plots.limits(recording).axes) == 2
    np.testing.assert_array_equal(drawn(plots.rates(recording).axes[0], "elbow")[1], arm.xdot[:, 1])
    words = ["plot", str(file), "--robot", str(robot), "--out", str(tmp_path / "a.png")]
    assert main([*words, "--kind", "torques"]) == 2
    assert "which has no forces" in capsys.readouterr().err
    assert main([*words, "--kind", "base,limits", "--attitude", "rpy"]) == 0


def test_attitude_in_degrees_is_that_of_scipy(arm: pinred.Trajectory) -> None:
    """Rotation vector and roll, pitch and yaw reproduce the rotation matrices."""
    R = Rotation.from_quat(arm.pose[:, 3:])
    figure = plots.base(arm, attitude="rpy")
    angles = [drawn(figure.axes[1], name)[1] for name in ("roll", "pitch", "yaw")]
    again = Rotation.from_euler("ZYX", np.column_stack(angles[::-1]), degrees=True)
    np.testing.assert_allclose(again.as_matrix(), R.as_matrix(), atol=1e-12)
    assert figure.axes[1].get_ylabel() == "attitude [°]"
    assert np.abs(np.diff(angles, axis=1)).max() < 20.0
    figure = plots.base(arm, attitude="vector")
    vector = np.column_stack([drawn(figure.axes[1], name)[1] for name in "xyz"])
    for w, matrix in zip(np.deg2rad(vector), R.as_matrix(), strict=True):
        np.testing.assert_allclose(pin.exp3(w), matrix, atol=1e-12)
    with pytest.raises(pinred.InputError, match="attitude: expected quaternion or vector or rpy"):
        plots.base(arm, attitude="euler")  # type: ignore[arg-type]


def test_attitude_continues_through_full_turns() -> None:
    """Angles beyond 180° do not jump, and a planar angle is in degrees."""
    top = pinred.simulate(
        pinred.load("rigid_body"), xi0=[0.0, 0.0, 9.0], duration=2.0, times=np.linspace(0, 2, 101)
    )
    (axes,) = plots.base(top, attitude="rpy").axes
    np.testing.assert_allclose(drawn(axes, "yaw")[1], np.rad2deg(9.0 * top.t), atol=1e-6)
    (axes,) = plots.base(top, attitude="vector").axes
    np.testing.assert_allclose(drawn(axes, "z")[1], np.rad2deg(9.0 * top.t), atol=1e-6)
    beanie = pinred.simulate(pinred.load("elroys_beanie"), duration=0.5)
    (axes,) = plots.base(beanie, attitude="rpy").axes
    np.testing.assert_allclose(drawn(axes, "θ")[1], np.rad2deg(beanie.pose[:, 0]))
    assert axes.get_ylabel() == "θ: angle [°]"


def test_limits_of_many_joints_name_the_largest_and_draw_all() -> None:
    """The legend of a panel has six joints and the number of the others."""
    pytest.importorskip("example_robot_data")
    solo = pinred.simulate(pinred.load("solo12"), seed=0, duration=0.1, engine="pinocchio")
    position, *_ = plots.limits(solo).axes
    names = [str(line.get_label()) for line in position.lines]
    legend = position.get_legend()
    assert legend is not None
    shown = [text.get_text() for text in legend.get_texts()]
    limits = joint_limits(solo.system).position
    middle, half = limits.mean(axis=1), 0.5 * np.diff(limits, axis=1)[:, 0]
    largest = np.argsort(-np.abs((solo.x - middle) / half).max(axis=0), kind="stable")[:6]
    assert shown == [solo.system.shape_names[k] for k in sorted(largest)] + ["6 others"]
    assert len(names) == 12 + 1 + 2  # the joints, an entry of the legend, and both limits
