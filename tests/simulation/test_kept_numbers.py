"""Parameters of a robot are kept in other scenes, members, files and flows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred import InputError

VALUES: dict[str, Any] = {
    "back.mass": 3.0,
    "bend.placement": [0.1, 0.0, 0.3, 0.2, -0.4, 0.7],
    "gravity": [0.0, 0.0, -3.7],
}


def by_pinocchio() -> pinred.System:
    """The falling cat with these numbers, as Pinocchio changes its model."""
    model = pinred.load("falling_cat", gravity=VALUES["gravity"]).model.copy()
    back = int(model.frames[model.getFrameId("back")].parentJoint)
    model.inertias[back] = pin.Inertia(
        3.0, model.inertias[back].lever, model.inertias[back].inertia
    )
    place = np.array(VALUES["bend.placement"])
    bend = model.getJointId("bend")
    model.jointPlacements[bend] = pin.SE3(pin.rpy.rpyToMatrix(*place[3:]), place[:3])
    return pinred.load(model)


@pytest.mark.slow
def test_continued_motion_keeps_parameters(tmp_path: Path) -> None:
    """A motion continued from a trajectory, a file or a loaded robot is one motion."""
    times = [0.0, 0.2, 0.4]
    judge = pinred.simulate(by_pinocchio(), seed=1, times=times)
    start: dict[str, Any] = {"q0": judge.q[0], "v0": judge.v[0]}
    first = pinred.simulate(pinred.load("falling_cat"), **start, times=times[:2], parameters=VALUES)
    path = tmp_path / "first.npz"
    first.save(path)
    recorded = pinred.read_recording(path)
    for system in (first.system, first.scene.system, recorded.system):
        rest = pinred.simulate(system, q0=first.q[-1], v0=first.v[-1], duration=0.2)
        np.testing.assert_allclose(rest.q[-1], judge.q[-1], rtol=0, atol=1e-9)
    many = pinred.simulate_many(first.system, members={"xdot0": np.zeros((1, 3))}, duration=0.1)
    assert many[0].scene.parameters["back.mass"] == 3.0
    end: Any = pinred.flow(first.system, **start, duration=0.4, wrt=["back.mass"])()
    np.testing.assert_allclose(end.q, judge.q[-1], rtol=0, atol=1e-9)
    loaded = pinred.load("falling_cat", parameters=VALUES)
    assert loaded.parameters["back.mass"] == 3.0
    red, other = pinred.Reduction(loaded), pinred.Reduction(by_pinocchio())
    x = np.array([0.3, -0.5, 0.4])
    np.testing.assert_allclose(red.mass_matrix(x), other.mass_matrix(x), rtol=0, atol=1e-13)


def test_scene_keeps_parameters_that_are_not_replaced() -> None:
    """New parameters are added, and a complete value replaces its parts."""
    cat = pinred.load("falling_cat")
    own = {"back.mass": 3.0, "bend.translation": [0.1, 0.0, 0.2]}
    scene = pinred.Scene(system=cat, seed=1, duration=0.1, parameters=own)
    traj = pinred.simulate(scene, parameters={"front.mass": 2.0})
    assert traj.scene.parameters["back.mass"] == 3.0
    assert traj.scene.parameters["front.mass"] == 2.0
    turned = pinred.simulate(scene, parameters={"bend.placement": VALUES["bend.placement"]})
    assert "bend.translation" not in turned.scene.parameters
    named = pinred.Scene(system=scene.system, seed=1, parameters=["back.mass", "front.mass"])
    assert named.parameters["back.mass"] == 3.0  # by name alone, they stay as they are
    with pytest.raises(InputError, match="there is no 'gain'; "):
        pinred.load("falling_cat", parameters={"gain": 2.0})
    with pytest.raises(InputError, match=r"parameters must be \{name: value\}"):
        pinred.load("falling_cat", parameters=["back.mass"])  # type: ignore[arg-type]


@pytest.mark.slow
def test_members_replace_parameters_of_scene(tmp_path: Path) -> None:
    """Each member has its gravity, which the file contains."""
    pole = pinred.load("cartpole")
    base = pinred.Scene(system=pole, seed=1, times=[0.2], parameters={
        "gravity": [0.0, 0.0, -9.0], "pole.mass": 2.0,
    })  # fmt: skip
    pulls = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, -2.0]])
    many = pinred.simulate_many(base, members={"gravity": pulls, "cart.mass": [1.0, 1.5]})
    for k in range(2):
        model = pole.model.copy()
        model.gravity.linear = pulls[k]
        for link, mass in (("pole", 2.0), ("cart", [1.0, 1.5][k])):
            i = int(model.frames[model.getFrameId(link)].parentJoint)
            model.inertias[i] = pin.Inertia(
                mass, model.inertias[i].lever, model.inertias[i].inertia
            )
        one = pinred.simulate(pinred.load(model), x0=base.start.x, xdot0=base.start.xdot,
                              xi0=base.start.xi, times=[0.2])  # fmt: skip
        np.testing.assert_allclose(many.q[k], one.q, rtol=0, atol=1e-9)
    path = tmp_path / "many.npz"
    many.save(path)
    with np.load(path) as file:
        np.testing.assert_array_equal(file["gravity"], pulls)
        assert file["parameter_names"].tolist() == ["pole.mass", "cart.mass"]
        np.testing.assert_array_equal(file["parameter_values"], [[2.0, 1.0], [2.0, 1.5]])


def test_files_with_wrong_parameters_are_rejected(tmp_path: Path) -> None:
    """Lengths that do not match and unphysical values are rejected."""
    path = tmp_path / "traj.npz"
    cat = pinred.load("falling_cat")
    pinred.simulate(cat, seed=1, times=[0.1], parameters={"back.mass": 3.0}).save(path)
    with np.load(path) as file:
        content = dict(file)
    for name, value, match in (
        ("parameter_sizes", np.array([2]), "are inconsistent"),
        ("parameter_sizes", np.array([-1]), "are inconsistent"),
        ("parameter_values", np.array([-3.0]), "must be above zero"),
        ("parameter_values", np.array([np.nan]), "must be finite"),
        ("parameter_names", np.array(["bck.mass"]), "no link or joint 'bck'"),
        ("parameter_names", np.array(["gain"]), "there is no 'gain'"),
    ):
        np.savez(path, **{**content, name: value})
        with pytest.raises(pinred.LoadError, match=match):
            _ = pinred.read_recording(path).system
