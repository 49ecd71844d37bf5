"""Copies and pickles of robots, scenes, motions and flows, and motions as labelled arrays."""

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
    """Return a scene with forces, parameters and changed inertias."""
    gain = Parameter("gain", 2.0)
    plan = Fourier(0.1, [Parameter("high", 0.2)], [], 1.0)
    return pinred.Scene(
        system=pinred.load("falling_cat"), seed=1, duration=0.2, rtol=1e-8,
        forces=[PD({"bend": plan}, kp=gain, kd=gain)], prescribed={"twist": "0.2*sin(t)"},
        parameters={"high": 0.3, "back.mass": 2.0},
    )  # fmt: skip


@pytest.mark.by_hand("deepcopy")
@pytest.mark.parametrize("copy_of", COPIES)
def test_copies_give_equal_numbers(copy_of: Any) -> None:
    """Copies of robots, scenes, motions and flows give the same numbers to the last bit."""
    original = scene()
    traj = pinred.simulate(original)
    robot = copy_of(pinred.load("falling_cat"))
    same = pinred.simulate(robot, seed=1, duration=0.1)
    fresh = pinred.simulate(pinred.load("falling_cat"), seed=1, duration=0.1)
    np.testing.assert_array_equal(same.x, fresh.x)
    again = pinred.simulate(copy_of(original))
    np.testing.assert_array_equal(again.x, traj.x)
    other = copy_of(traj)
    np.testing.assert_array_equal(other.pose, traj.pose)
    np.testing.assert_array_equal(other(0.123).x, traj(0.123).x)
    assert other.run.steps == traj.run.steps
    flow = pinred.flow(original, wrt=["x0", "gain", "back.mass"], method="DOP853")
    twin = copy_of(flow)
    for name, jacobian in twin.jacobian(gain=2.5).items():
        np.testing.assert_array_equal(jacobian, flow.jacobian(gain=2.5)[name])
    assert not traj.x.flags.writeable


@pytest.mark.parametrize("copy_of", COPIES)
@pytest.mark.sampled
def test_copies_of_members_keep_states_and_failures(copy_of: Any) -> None:
    """Members of every form keep their states, scenes and failures."""
    cat, original = pinred.load("falling_cat"), scene()
    for many in (
        pinred.simulate_many(cat, seeds=[1, 2], duration=0.1, times=[0.05, 0.1]),
        pinred.simulate_many(cat, members={"back.mass": [1.0, 2.0]}, seed=1, duration=0.1),
        pinred.simulate_many([original, original]),
    ):
        twin = copy_of(many)
        for name in ("x", "pose", "energy", "y"):
            np.testing.assert_array_equal(getattr(twin, name), getattr(many, name))
        np.testing.assert_array_equal(twin[1](0.07).x, many[1](0.07).x)
        assert twin[1].scene.parameters == many[1].scene.parameters
        assert twin.failures == many.failures
        assert not twin.x.flags.writeable


def end_of(task: Any) -> Any:
    """Return the end of a motion; runs in another process."""
    kind, value = task
    if kind == "flow":
        return value.jacobian()["gain"]
    if kind == "members":
        return value.x[:, -1]
    if kind == "robot":
        return value.model.inertias[1].matrix()
    return pinred.simulate(value).x[-1] if kind == "scene" else value(0.05).x


@pytest.mark.by_hand
def test_pickles_work_in_spawned_processes() -> None:
    """Scenes, flows and motions give the same numbers in spawned processes."""
    original = scene()
    flow, traj = pinred.flow(original, wrt=["gain"], method="DOP853"), pinred.simulate(original)
    many = pinred.simulate_many(original, members={"gain": [1.0, 2.0]})
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        tasks = [("scene", original), ("flow", flow), ("motion", traj)]
        results = list(pool.map(end_of, [*tasks, ("members", many), ("robot", original.system)]))
    expected = [traj.x[-1], flow.jacobian()["gain"], traj(0.05).x, many.x[:, -1]]
    expected.append(original.system.model.inertias[1].matrix())
    for one, other in zip(results, expected, strict=True):
        np.testing.assert_array_equal(one, other)


def test_local_functions_cannot_be_pickled() -> None:
    """A scene with a local function raises pickle's error."""
    local = pinred.Scene(
        system=pinred.load("falling_cat"), forces=[pinred.forces.Torque(lambda *_: {"bend": 0.0})]
    )
    with pytest.raises((pickle.PicklingError, AttributeError)):
        pickle.dumps(local)


def test_labelled_arrays_of_trajectory() -> None:
    """Xarray and pandas name joints and coordinates; missing packages raise an error."""
    traj = pinred.simulate(scene())
    for package, method in (("xarray", traj.to_xarray), ("pandas", traj.to_pandas)):
        try:
            __import__(package)
        except ImportError:
            with pytest.raises(pinred.MissingPackageError, match=f"needs {package}"):
                method()
            continue
        table = method()
        if package == "xarray":
            np.testing.assert_array_equal(table.x.sel(joint="bend"), traj.x[:, 0])
            assert table.pose.dims == ("t", "coordinate")
        else:
            np.testing.assert_array_equal(table["x.bend"], traj.x[:, 0])


@pytest.mark.parametrize("outputs", ["all", "shape"])
def test_labelled_arrays_of_members(outputs: Any, tmp_path: Path) -> None:
    """Tables over member and time, with and without the base."""
    many = pinred.simulate_many(
        pinred.load("falling_cat"), seeds=range(3), times=[0.0, 0.1], duration=0.1, outputs=outputs
    )
    xarray, pandas = pytest.importorskip("xarray"), pytest.importorskip("pandas")
    arrays = many.to_xarray()
    assert arrays.x.dims == ("member", "t", "joint")
    np.testing.assert_array_equal(arrays.x.sel(member=2, joint="bend"), many.x[2, :, 0])
    np.testing.assert_array_equal(arrays.energy.sel(member=1), many.energy[1])
    table = many.to_pandas()
    assert isinstance(arrays, xarray.Dataset)
    assert isinstance(table, pandas.DataFrame)
    np.testing.assert_array_equal(table.loc[2]["x.bend"], many.x[2, :, 0])
    assert table.shape[0] == 6
    many[0].save(tmp_path / "one.npz")
    if outputs == "all":
        recording = pinred.read_recording(tmp_path / "one.npz")
        np.testing.assert_array_equal(recording.to_xarray().pose, many.pose[0])


def test_zarr_has_the_arrays_of_npz(tmp_path: Path) -> None:
    """Trajectories and recordings write the same zarr folder."""
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
