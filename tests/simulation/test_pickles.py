"""What travels to other processes: robots, scenes, motions, flows."""

from __future__ import annotations

import copy
import pickle
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
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
