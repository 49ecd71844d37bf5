"""Named outputs of sweeps: turn, position of a frame, peak torque, excursion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pinred
from pinred.cli.command_line import main
from pinred.sweeps.sweep_outputs import parse_outputs

ARM = """<robot name="arm">
  <link name="hull"><inertial><mass value="4"/>
    <inertia ixx="1" iyy="2" izz="1.5" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="upper"><inertial><origin xyz="0.3 0 0"/><mass value="1"/>
    <inertia ixx="0.1" iyy="0.2" izz="0.2" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tip"/>
  <joint name="shoulder" type="continuous"><parent link="hull"/><child link="upper"/>
    <origin xyz="0.5 0 0"/><axis xyz="0 0 1"/></joint>
  <joint name="end" type="fixed"><parent link="upper"/><child link="tip"/>
    <origin xyz="0.6 0 0.1"/></joint>
</robot>"""
OUTPUTS = [
    "turn",
    "turn.y",
    "position(tip)",
    "position(tip).z",
    "peak_torque",
    "excursion.shoulder",
    "pose",
]


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a robot and its scene with a sweep; return the path of the scene."""
    folder = tmp_path_factory.mktemp("arm")
    (folder / "arm.urdf").write_text(ARM)
    scene = folder / "arm.toml"
    scene.write_text(
        "robot = 'arm.urdf'\nload = { gravity = [0, 0, 0] }\n[springs]\nshoulder = [3.0, 0.2]\n"
        "[start]\nx0 = [0.6]\nmomentum = [0.3, 0, 0.1, 0.2, -0.3, 1.5]\n[run]\nduration = 1.2\n"
        f"samples = 41\n[sweep]\noutputs = {OUTPUTS}\nstore = 'arm.zarr'\n"
        "[sweep.vary]\nx0.shoulder = [0.3, 0.6]\nupper.mass = [0.8, 1.0, -1.0]\n"
    )
    return scene


def test_measures_in_a_file_are_those_of_the_motions(
    arm: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Against SciPy's rotations, kinematics by hand, and the law of the spring."""
    assert main(["sweep", str(arm)]) == 0
    assert "turn [°]" in capsys.readouterr().out
    result = pinred.open_sweep(arm.with_name("arm.zarr"))
    system = pinred.load_scene(arm).system
    for k in np.flatnonzero(result["status"] == 1).tolist():
        traj = result.point(k)
        first, last = Rotation.from_quat(traj.pose[[0, -1], 3:])
        expected = np.rad2deg((first.inv() * last).magnitude())
        np.testing.assert_allclose(result["turn"][k], expected, rtol=1e-10)
        vector = np.rad2deg((first.inv() * last).as_rotvec())
        np.testing.assert_allclose(result["turn.y"][k], vector[1], rtol=0, atol=1e-10)
        pose, x = traj.pose[-1], traj.x[:, 0]
        in_hull = np.array([0.5, 0, 0]) + Rotation.from_rotvec([0, 0, x[-1]]).apply([0.6, 0, 0.1])
        tip = pose[:3] + last.apply(in_hull)
        np.testing.assert_allclose(result["position(tip)"][k], tip, atol=1e-12)
        np.testing.assert_allclose(result["position(tip).z"][k], tip[2], atol=1e-12)
        torque = np.abs(3.0 * (x - 0.2)).max()
        np.testing.assert_allclose(result["peak_torque"][k], torque, rtol=1e-12)
        np.testing.assert_allclose(result["excursion.shoulder"][k], np.abs(x - x[0]).max())
    rejected = result["status"].values == 3
    assert rejected.sum() == 2
    for name in OUTPUTS:
        assert np.isnan(result[name].values[rejected]).all()
        assert not np.isnan(result[name].values[~rejected]).any()
    units = {name: result[name].attrs["units"] for name in OUTPUTS[:6]}
    assert list(units.values()) == ["°", "°", "m", "m", "N·m", "rad"]
    assert system.m == 1


def test_planar_turn_is_signed_and_counts_full_turns() -> None:
    """The unwrapped angle of the base in degrees, in closed form."""
    beanie = pinred.load("elroys_beanie")
    scene = pinred.Scene(system=beanie, x0=[0.0], xdot0=[0.0], xi0=[-9.0], duration=2.0)
    result = pinred.sweep(scene, {"xi0.w": [-9.0, 1.0]}, outputs=["turn"])
    np.testing.assert_allclose(result["turn"], np.rad2deg([-18.0, 2.0]), rtol=1e-9)


def test_rotation_vector_of_a_turn_in_space() -> None:
    """Against SciPy's rotations, and for both quaternions of the first attitude."""
    body = pinred.load("rigid_body")
    start = Rotation.from_euler("xyz", [0.3, -0.8, 2.9]).as_quat()
    outputs = ["turn.x", "turn.y", "turn.z", "turn", "pose"]
    for pose0 in (start, -start):
        scene = pinred.Scene(system=body, pose0=pose0, xi0=[0.2, -0.4, 0.3], duration=2.0)
        result = pinred.sweep(scene, {"xi0.omega2": [-1.5, -0.4, 0.0, 1.2, 1.55]}, outputs=outputs)
        last = Rotation.from_quat(result["pose"].values)
        expected = np.rad2deg((Rotation.from_quat(pose0).inv() * last).as_rotvec())
        for k, name in enumerate(outputs[:3]):
            np.testing.assert_allclose(result[name], expected[:, k], rtol=0, atol=1e-9)
        np.testing.assert_allclose(result["turn"], np.linalg.norm(expected, axis=1), atol=1e-9)
        assert np.abs(expected).max() > 150.0


@pytest.mark.parametrize(
    ("robot", "output", "words"),
    [
        ("falling_cat", "position(hand)", "no frame 'hand'"),
        ("falling_cat", "position", "position(FRAME), peak_torque, excursion"),
        ("falling_cat", "turn.w", "no component 'w'; the components are x, y, z"),
        ("elroys_beanie", "turn.x", "an entry x, y or z only if it turns in space"),
        ("falling_cat", "peak_torque.bent", "no shape joint 'bent'; did you mean 'bend'"),
        ("falling_cat", "position(front).w", "no component 'w'; the components are x, y, z"),
        ("cartpole", "turn", "of a base that can turn"),
        ("rigid_body", "excursion", "'rigid_body' has no joints"),
    ],
)
def test_wrong_measure_is_refused_with_the_valid_names(robot: str, output: str, words: str) -> None:
    """Before anything is computed."""
    scene = pinred.Scene(system=pinred.load(robot), seed=0, duration=0.1)
    with pytest.raises(pinred.InputError) as refused:
        parse_outputs(scene, [output])
    assert words in str(refused.value)


def test_measures_of_the_base_need_the_base() -> None:
    """A scene without the base has excursions only."""
    scene = pinred.Scene(system=pinred.load("falling_cat"), seed=0, duration=0.1, outputs="shape")
    with pytest.raises(pinred.InputError, match="leaves out the base"):
        parse_outputs(scene, ["turn"])
    assert parse_outputs(scene, ["excursion"])[0].unit == "rad"
