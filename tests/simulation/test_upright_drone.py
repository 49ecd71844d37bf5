"""ℝ × SE(2): the yaw of an upright drone follows its boom, and its base is in free fall."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad

import pinred
from pinred.cli.command_line import main
from pinred.forces import Wrench
from pinred.scene.scene import ENGINES, Engine
from pinred.signals import Fourier
from pinred.system.find_robot_files import bundled_folder

G = 9.81


def arm(lift: float) -> float:
    """Return the moment J of the arm about the drone's axis, with the centre of mass at rest."""
    return float(0.03 + 0.12 * np.cos(lift) ** 2)


@pytest.mark.parametrize("lift", [0.0, 0.7, -1.3])
@pytest.mark.parametrize("swivel", [0.0, 2.0])
def test_connection_and_metric_agree_with_closed_form(swivel: float, lift: float) -> None:
    """A and M agree with the catalogue, and the yaw curvature with the derivative of A."""
    at = pinred.Reduction(pinred.load("upright_drone")).at([swivel, lift])
    J, slope = arm(lift), -0.12 * np.sin(2 * lift)
    yaw = J / (0.06 + J)
    c = np.cos(lift) ** 2
    assert yaw == pytest.approx((1 + 4 * c) / (3 + 4 * c), abs=1e-15)
    np.testing.assert_allclose(at.local_connection[3], [yaw, 0.0], atol=1e-15)
    np.testing.assert_allclose(at.reduced_metric, np.diag([0.06 * yaw, 0.14]), atol=1e-15)
    B = slope * 0.06 / (0.06 + J) ** 2  # ∂A/∂raise
    np.testing.assert_allclose(at.curvature[3], [[0.0, -B], [B, 0.0]], atol=1e-14)
    # The climb: the boom's centre of mass is 0.4 m out, a quarter of the mass.
    climb = [0.0, 0.1 * np.cos(lift)]
    np.testing.assert_allclose(at.local_connection[0], climb, atol=1e-15)


@pytest.mark.by_hand
@pytest.mark.parametrize("engine", ENGINES)
def test_closed_boom_path_yaws_the_drone(engine: Engine) -> None:
    """Without momentum the yaw is −∮ A dα, and only free fall changes height and drift."""
    system, T = pinred.load("upright_drone"), 2.0
    loop = {"swivel": Fourier(0.0, [0.6], [], T), "raise": Fourier(0.2, [], [0.9], T)}
    traj = pinred.simulate(system, prescribed=loop, momentum=0, duration=T, engine=engine)

    def rate(t: float) -> float:
        w = 2 * np.pi / T
        J = arm(0.2 + 0.9 * np.sin(w * t))
        return float(J / (0.06 + J) * 0.6 * w * np.sin(w * t))

    turned = quad(rate, 0.0, T, epsabs=1e-13, epsrel=1e-13)[0]
    assert abs(turned) > 0.1
    z, *place, yaw = traj.pose[-1] - traj.pose[0]
    assert yaw == pytest.approx(turned, abs=1e-9)
    # The centre of mass, 0.1 m towards the boom, falls freely from rest.
    com = [0.1 * np.cos(0.2) * np.array([np.cos(a), np.sin(a)]) for a in (0.6, 0.6 + yaw)]
    np.testing.assert_allclose(place, com[0] - com[1], atol=1e-9)
    v0 = -0.1 * np.cos(0.2) * 0.9 * np.pi  # the drone's own, as the boom begins to rise
    assert traj.xi[0, 0] == pytest.approx(v0, abs=1e-12)
    assert z == pytest.approx(-0.5 * G * T**2, abs=1e-9)
    assert pinred.compare(traj).passed


@pytest.mark.parametrize("engine", ENGINES)
def test_thrust_equal_to_gravity_keeps_height(engine: Engine) -> None:
    """The first entry of the wrench is a thrust m g along the climb."""
    system = pinred.load("upright_drone", lock=["raise", "swivel"])
    hover = Wrench([4.0 * G, 0.0, 0.0, 0.05])
    traj = pinred.simulate(
        system, pose0=[2.0, 0.0, 0.0, 0.0], momentum=0, duration=3.0, forces=[hover], engine=engine
    )
    np.testing.assert_allclose(traj.pose[:, 0], 2.0, atol=1e-10)
    # About the axis through the centre of mass, 0.1 m away, J + 0.06 turns, driven by 0.05 N m.
    expected = 0.5 * 0.05 / (0.06 + arm(0.0)) * traj.t**2
    np.testing.assert_allclose(traj.pose[:, 3], expected, atol=1e-9)


def test_gravity_does_not_affect_shape_and_yaw() -> None:
    """Gravity acts along the climb and across it."""
    motions = []
    for gravity in ((0.0, 0.0, 0.0), (1.0, -2.0, -9.0)):
        system = pinred.load("upright_drone", gravity=gravity)
        motions.append(pinred.simulate(system, seed=4, duration=2.0))
    still, falling = motions
    np.testing.assert_allclose(falling.x, still.x, atol=1e-14)
    np.testing.assert_allclose(falling.pose[:, 3], still.pose[:, 3], atol=1e-14)
    fall = 0.5 * still.t[:, None] ** 2 * np.array([-9.0, 1.0, -2.0])
    np.testing.assert_allclose((falling.pose - still.pose)[:, :3], fall, atol=1e-12)


@pytest.mark.slow
def test_group_is_restored_from_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command line, scene files and recordings state the group."""
    urdf = bundled_folder() / "upright_drone.urdf"
    assert pinred.load(urdf).group.name == "SE3"
    assert main(["compare", str(urdf), "--group", "RxSE2", "--seed", "1", "--duration", "0.5"]) == 0
    assert "upright_drone: RxSE2 × 2 joints" in capsys.readouterr().out
    path = tmp_path / "hover.toml"
    path.write_text(
        f"robot = '{urdf}'\nload = {{ group = 'RxSE2', lock = ['swivel', 'raise'] }}\n"
        "start = { pose0 = [2, 0, 0, 0.5], momentum = 0 }\nrun = { duration = 1.0 }\n"
        "[[forces]]\nkind = 'wrench'\nfunction = [39.24, 0, 0, '-0.3*mu[3]']\n",
        encoding="utf-8",
    )
    traj = pinred.simulate(pinred.load_scene(path))
    np.testing.assert_allclose(traj.pose - [2.0, 0.0, 0.0, 0.5], 0.0, atol=1e-12)
    traj.save(tmp_path / "hover.npz")
    kept = pinred.read_recording(tmp_path / "hover.npz")
    assert kept.system.group is traj.system.group
    np.testing.assert_array_equal(kept.pose, traj.pose)
