"""Entries by joint name in forces and controllers, such as x["bend"]."""

# ruff: noqa: ARG005 (what forces are functions of, used or not)

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from forced_trees import against_aba

import pinred
from pinred.common.arrays import Array
from pinred.forces import Controller, PotentialEnergy, Torque, Wrench
from pinred.forces.columns import Vector
from pinred.forces.force import Force
from pinred.scene.scene import ENGINES, Engine

CAT = pinred.load("falling_cat")
OPTIONS: dict[str, Any] = {"seed": 3, "duration": 0.5, "rtol": 1e-9, "atol": 1e-11}

SIZE = 0.02  # N·m, and so on; the cat is light


def at(q: Array, name: str) -> float:
    """Return the angle of a joint in Pinocchio's q, or its rate in v."""
    return float(q[CAT.model.joints[CAT.model.getJointId(name)].idx_q])


def rate(v: Array, name: str) -> float:
    """Return the rate of a joint in Pinocchio's v."""
    return float(v[CAT.model.joints[CAT.model.getJointId(name)].idx_v])


def unit_torque(name: str, torque: float) -> Array:
    """Return Pinocchio's torques with one at a joint."""
    tau = np.zeros(CAT.model.nv)
    tau[CAT.model.joints[CAT.model.getJointId(name)].idx_v] = torque
    return tau


NAMED: dict[str, tuple[Force, Any]] = {
    "torques": (
        Torque(lambda t, x, xdot, mu: {"twist": SIZE * (x["bend"] * ca.cos(t) - xdot["sway"])}),
        lambda t, q, v: unit_torque("twist", SIZE * (at(q, "bend") * np.cos(t) - rate(v, "sway"))),
    ),
    "a torque": (
        Torque({"sway": lambda t, x, xdot, mu: SIZE * (xdot["twist"] - x["twist"] ** 2)}),
        lambda t, q, v: unit_torque("sway", SIZE * (rate(v, "twist") - at(q, "twist") ** 2)),
    ),
    "a potential": (
        PotentialEnergy(lambda x: 0.5 * SIZE * x["sway"] ** 2 * x["bend"]),
        lambda t, q, v: (
            -SIZE * unit_torque("sway", at(q, "sway") * at(q, "bend"))
            - 0.5 * SIZE * unit_torque("bend", at(q, "sway") ** 2)
        ),
    ),
    "a wrench": (
        Wrench(lambda t, x, xdot, mu: [0, 0, 0, SIZE * x["twist"], 0, -SIZE * xdot["bend"]]),
        lambda t, q, v: np.array(
            [0, 0, 0, SIZE * at(q, "twist"), 0, -SIZE * rate(v, "bend"), 0, 0, 0]
        ),
    ),
    "an entry of a wrench": (
        Wrench([0, 0, 0, 0, lambda t, x, xdot, mu: SIZE * x["sway"], 0]),
        lambda t, q, v: np.array([0, 0, 0, 0, SIZE * at(q, "sway"), 0, 0, 0, 0]),
    ),
}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", NAMED)
@pytest.mark.sampled
def test_forces_by_name_equal_aba(name: str, engine: Engine) -> None:
    """The same law in Pinocchio's own indices gives the same motion."""
    force, tau = NAMED[name]
    traj = pinred.simulate(CAT, forces=[force], engine=engine, **OPTIONS)
    assert against_aba(traj, tau) < 1e-6
    still = pinred.simulate(CAT, **OPTIONS)
    assert np.abs(traj.q - still.q).max() > 1e-4


@pytest.mark.parametrize("period", [0.125])
@pytest.mark.parametrize("engine", ENGINES)
def test_controller_by_name_equals_aba(engine: Engine, period: float) -> None:
    """Commands by name with a zero-order hold, against ABA under constant torques."""
    traj = pinred.simulate(
        CAT,
        forces=[
            Controller(lambda t, x, xdot, mu: {"bend": SIZE * (x["twist"] - xdot["sway"])}, period)
        ],
        engine=engine,
        **OPTIONS,
    )
    samples = period * np.arange(4)
    states = [traj(float(t)) for t in samples]
    commands = [SIZE * (at(s.q, "twist") - rate(s.v, "sway")) for s in states]

    def tau(t: float, q: Array, v: Array) -> Array:  # noqa: ARG001
        return unit_torque("bend", commands[int(t / period)])

    assert against_aba(traj, tau, tuple(samples[1:])) < 1e-6


def test_names_do_not_change_kernels() -> None:
    """Expressions by name and by index are identical, and so is the machine code."""

    def scene(bend: Any, twist: Any) -> pinred.Scene:
        forces: list[Force] = [
            Torque(lambda t, x, xdot, mu: {"sway": x[bend] * xdot[twist] + ca.sumsqr(x)}),
            PotentialEnergy(lambda x: ca.dot(x, x) * x[twist]),
        ]
        return pinred.Scene(system=CAT, forces=forces)

    named, numbered = (scene(*names).force_model for names in (("bend", "twist"), (0, 2)))
    assert named is not None
    assert numbered is not None
    assert named.key == numbered.key
    assert CAT.shape_names == ("bend", "sway", "twist")


UNKNOWN = r"{}: no shape joint 'bnd'; did you mean 'bend'\? the joints are bend, sway, twist"


@pytest.mark.parametrize(
    "force",
    [
        Torque(lambda t, x, xdot, mu: {"sway": x["bnd"]}),
        Torque({"sway": lambda t, x, xdot, mu: x["bnd"]}),
        PotentialEnergy(lambda x: x["bnd"]),
        Wrench(lambda t, x, xdot, mu: [x["bnd"]] * 6),
        Controller(lambda t, x, xdot, mu: {"sway": x["bnd"]}, 0.1),
    ],
    ids=["torques", "torque", "potential", "wrench", "controller"],
)
def test_unknown_joint_names_are_rejected(force: Force) -> None:
    """The message lists the joints, and nothing is simulated."""
    with pytest.raises(pinred.InputError, match=UNKNOWN.format("x")):
        pinred.simulate(CAT, forces=[force], duration=0.3)


def test_unknown_names_state_shape_or_rate() -> None:
    """The message names the array, x or xdot."""
    force = Torque(lambda t, x, xdot, mu: {"sway": xdot["bnd"]})
    with pytest.raises(pinred.InputError, match=UNKNOWN.format("xdot")):
        pinred.Scene(system=CAT, forces=[force])


def test_named_vectors_behave_as_numpy_arrays() -> None:
    """Numbers, slices and NumPy results are plain and have no names."""
    numbers = np.array([3.0, 1.0, 2.0])
    x = Vector.of(numbers, ("a", "b", "c"), "x")
    assert (x["a"], x["b"], x["c"], x[0], x[-1]) == (3.0, 1.0, 2.0, 3.0, 2.0)
    assert type(x["a"]) is type(x[0]) is np.float64
    for derived in (x[1:], x[::-1], x[[0, 1]], x[x > 1], 2 * x, x + x, -x, np.sin(x), np.round(x)):
        assert type(derived) is np.ndarray
    assert type(np.concatenate([x, x])) is np.ndarray
    for number in (x @ x, x.sum(), np.linalg.norm(x)):
        assert isinstance(number, np.float64)
    np.testing.assert_array_equal(2 * x - 1, 2 * numbers - 1)
    assert x.tolist() == numbers.tolist()
    for derived in (np.sort(x), x.copy()):
        with pytest.raises(pinred.InputError, match=r"only the arguments x and xdot, .* 'a'"):
            derived["a"]  # type: ignore[call-overload]
    x += 1.0
    x[0] = 7.0
    assert (x["a"], x["b"]) == (7.0, 2.0)
    np.testing.assert_array_equal(numbers, [3.0, 1.0, 2.0])
    with pytest.raises(pinred.InputError, match="x: no shape joint 'd'; the joints are a, b, c"):
        x["d"]


def test_controller_may_modify_its_arguments() -> None:
    """The arguments are copies, so the motion does not change."""

    def writes(t: float, x: Array, xdot: Array, mu: Array) -> list[float]:  # noqa: ARG001
        x *= 0.0
        xdot[:] = np.nan
        return [0.0, 0.0, 0.0]

    traj = pinred.simulate(CAT, forces=[Controller(writes, 0.25)], **OPTIONS)
    assert against_aba(traj, lambda t, q, v: np.zeros(9)) < 1e-6
    assert pin.isNormalized(CAT.model, traj.q[-1], 1e-9)
