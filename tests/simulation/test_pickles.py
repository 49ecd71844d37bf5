"""What travels to other processes: robots, scenes, motions, flows."""

from __future__ import annotations

import copy
import pickle
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinred
from pinred import Parameter
from pinred.forces import PD
from pinred.signals import Fourier

COPIES = [lambda value: pickle.loads(pickle.dumps(value)), copy.deepcopy, copy.copy]


def scene() -> pinred.Scene:
    """A scene with forces, parameters and other inertias."""
    gain = Parameter("gain", 2.0)
    plan = Fourier(0.1, [Parameter("high", 0.2)], [], 1.0)
    return pinred.Scene(
        system=pinred.load("falling_cat"), seed=1, duration=0.2, rtol=1e-8,
        forces=[PD({"bend": plan}, kp=gain, kd=gain)], prescribed={"twist": "0.2*sin(t)"},
        parameters={"high": 0.3, "back.mass": 2.0},
    )  # fmt: skip


@pytest.mark.parametrize("how", COPIES)
def test_copies_do_the_same(how: Any) -> None:
    """A copy of a robot, a scene, a motion or a flow gives the same numbers to the bit."""
    made = scene()
    traj = pinred.simulate(made)
    robot = how(pinred.load("falling_cat"))
    same = pinred.simulate(robot, seed=1, duration=0.1)
    own = pinred.simulate(pinred.load("falling_cat"), seed=1, duration=0.1)
    np.testing.assert_array_equal(same.x, own.x)
    again = pinred.simulate(how(made))
    np.testing.assert_array_equal(again.x, traj.x)
    other = how(traj)
    np.testing.assert_array_equal(other.pose, traj.pose)
    np.testing.assert_array_equal(other(0.123).x, traj(0.123).x)
    assert other.run.steps == traj.run.steps
    flow = pinred.flow(made, wrt=["x0", "gain", "back.mass"], method="DOP853")
    twin = how(flow)
    for name, found in twin.jacobian(gain=2.5).items():
        np.testing.assert_array_equal(found, flow.jacobian(gain=2.5)[name])
    assert not traj.x.flags.writeable


@pytest.mark.parametrize("how", COPIES)
def test_copies_of_members(how: Any) -> None:
    """Members travel with their states, scenes and failures, whichever way they were given."""
    cat, made = pinred.load("falling_cat"), scene()
    for many in (
        pinred.simulate_many(cat, seeds=[1, 2], duration=0.1, times=[0.05, 0.1]),
        pinred.simulate_many(cat, members={"back.mass": [1.0, 2.0]}, seed=1, duration=0.1),
        pinred.simulate_many([made, made]),
    ):
        twin = how(many)
        for name in ("x", "pose", "energy", "y"):
            np.testing.assert_array_equal(getattr(twin, name), getattr(many, name))
        np.testing.assert_array_equal(twin[1](0.07).x, many[1](0.07).x)
        assert twin[1].scene.parameters == many[1].scene.parameters
        assert twin.failures == many.failures
        assert not twin.x.flags.writeable


def end_of(given: Any) -> Any:
    """Return the end of a motion, in another process."""
    kind, value = given
    if kind == "flow":
        return value.jacobian()["gain"]
    if kind == "members":
        return value.x[:, -1]
    if kind == "robot":
        return value.model.inertias[1].matrix()
    return pinred.simulate(value).x[-1] if kind == "scene" else value(0.05).x


@pytest.mark.slow
def test_another_process() -> None:
    """Scenes, flows and motions go to processes that are spawned, and come to the same."""
    made = scene()
    flow, traj = pinred.flow(made, wrt=["gain"], method="DOP853"), pinred.simulate(made)
    many = pinred.simulate_many(made, members={"gain": [1.0, 2.0]})
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        asked = [("scene", made), ("flow", flow), ("motion", traj)]
        found = list(pool.map(end_of, [*asked, ("members", many), ("robot", made.system)]))
    expected = [traj.x[-1], flow.jacobian()["gain"], traj(0.05).x, many.x[:, -1]]
    expected.append(made.system.model.inertias[1].matrix())
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


def test_what_cannot_travel_says_so() -> None:
    """A function that has no name elsewhere is what pickle refuses, as ever."""
    made = pinred.Scene(
        system=pinred.load("falling_cat"), forces=[pinred.forces.Torque(lambda *_: {"bend": 0.0})]
    )
    with pytest.raises((pickle.PicklingError, AttributeError)):
        pickle.dumps(made)


def test_labelled_arrays() -> None:
    """Motions as tables of other libraries, where they are installed."""
    traj = pinred.simulate(scene())
    for package, method in (("xarray", traj.to_xarray), ("pandas", traj.to_pandas)):
        try:
            __import__(package)
        except ImportError:
            with pytest.raises(pinred.MissingPackageError, match=f"needs {package}"):
                method()
            continue
        found = method()
        if package == "xarray":
            np.testing.assert_array_equal(found.x.sel(joint="bend"), traj.x[:, 0])
            assert found.pose.dims == ("t", "coordinate")
        else:
            np.testing.assert_array_equal(found["x.bend"], traj.x[:, 0])


@pytest.mark.parametrize("outputs", ["all", "shape"])
def test_labelled_members(outputs: Any, tmp_path: Path) -> None:
    """All members as one table, over member and time; of the shape alone, too."""
    many = pinred.simulate_many(
        pinred.load("falling_cat"), seeds=range(3), times=[0.0, 0.1], duration=0.1, outputs=outputs
    )
    xarray, pandas = pytest.importorskip("xarray"), pytest.importorskip("pandas")
    found = many.to_xarray()
    assert found.x.dims == ("member", "t", "joint")
    np.testing.assert_array_equal(found.x.sel(member=2, joint="bend"), many.x[2, :, 0])
    np.testing.assert_array_equal(found.energy.sel(member=1), many.energy[1])
    table = many.to_pandas()
    assert isinstance(found, xarray.Dataset)
    assert isinstance(table, pandas.DataFrame)
    np.testing.assert_array_equal(table.loc[2]["x.bend"], many.x[2, :, 0])
    assert table.shape[0] == 6
    many[0].save(tmp_path / "one.npz")
    if outputs == "all":
        recording = pinred.read_recording(tmp_path / "one.npz")
        np.testing.assert_array_equal(recording.to_xarray().pose, many.pose[0])


def test_motions_as_zarr(tmp_path: Path) -> None:
    """A Trajectory, and what was read of it, as a folder with the arrays of npz."""
    traj = pinred.simulate(scene())
    if find_spec("zarr") is None:
        with pytest.raises(pinred.MissingPackageError, match=r"pinred\[zarr\]"):
            traj.save(tmp_path / "motion.zarr")
        return
    traj.save(tmp_path / "motion.npz")
    traj.save(tmp_path / "motion.zarr")
    pinred.read_recording(tmp_path / "motion.npz").save(tmp_path / "again.zarr")
    for name in ("motion.zarr", "again.zarr"):
        root = import_module("zarr").open_group(str(tmp_path / name), mode="r")
        np.testing.assert_array_equal(root["pose"][:], traj.pose)
        assert root.attrs["robot"] == "falling_cat"
