"""What a scene's forces cannot be: every message names what was given and what can be."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

import pinred
from pinred.forces import (
    PD,
    ComputedTorque,
    Controller,
    Damper,
    Limit,
    PotentialEnergy,
    Spring,
    Torque,
    Wrench,
)
from pinred.signals import Hold, Linear, Spline

CAT = pinred.load("falling_cat")
JOINT = CAT.shape_names[0]
TEXT: Any = "sin(t)"
LISTED = rf"no shape joint 'knee'; the joints are {', '.join(CAT.shape_names)}"


def scene(*forces: Any, **options: Any) -> pinred.Scene:
    """A scene of the cat with these forces."""
    return pinred.Scene(system=CAT, seed=0, forces=forces, **options)


@pytest.mark.parametrize(
    "make",
    [
        lambda: scene(Spring("knee", 1.0)),
        lambda: scene(Spring(JOINT, 1.0, to="knee")),
        lambda: scene(Damper("knee", 1.0)),
        lambda: scene(Damper(JOINT, 1.0, to="knee")),
        lambda: scene(Torque({"knee": 1.0})),
        lambda: scene(Torque(lambda *_: {"knee": 1.0})),
        lambda: scene(Torque({JOINT: 1.0}, limit=Limit({"knee": 1.0}))),
        lambda: scene(PD({"knee": 0.0}, 1.0, 1.0)),
        lambda: scene(PD({JOINT: 0.0}, {"knee": 1.0}, 1.0)),
        lambda: scene(Controller(lambda *_: [0.0], 0.1, joints=("knee",))),
        lambda: scene(prescribed={"knee": Spline([0, 2], [0, 1])}),
        lambda: pinred.Scene(system=CAT, seed=0, springs={"knee": (1.0, 0.0)}),
    ],
)
def test_joints_that_are_not_there(make: Callable[[], pinred.Scene]) -> None:
    """The joints that are there are listed."""
    with pytest.raises(pinred.InputError, match=LISTED):
        make()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Spring(JOINT, float("nan")), "stiffness of a spring .* must be finite, got nan"),
        (lambda: Damper(JOINT, TEXT), "coefficient .* must be a number, got 'sin.t.'"),
        (lambda: scene(Damper(JOINT, 1.0, to=JOINT)), "both ends are the same joint"),
        (lambda: scene(PotentialEnergy(lambda x: x)), r"must be one value, got shape \(3, 1\)"),
        (lambda: scene(PotentialEnergy(lambda _: None)), r"V\(x\) of potential must be a number"),
        (lambda: scene(PotentialEnergy(lambda _: ca.MX.sym("y"))), "SX expression, got MX"),
        (lambda: scene(Torque(lambda *_: [0.0])), "torque must give 3 values, gave 1"),
        (lambda: scene(Torque({JOINT: TEXT})), "must be a Signal"),
        (lambda: scene(Torque({JOINT: float("inf")})), "inf"),
        (lambda: scene(Torque({JOINT: 1.0}, limit=Limit(0.0))), "limit of torque .* above zero"),
        (lambda: scene(PD({JOINT: 0.0}, float("nan"), 1.0)), "kp of pd must be finite, got nan"),
        (lambda: scene(PD({JOINT: 0.0}, {}, 1.0)), f"kp of pd has no value for '{JOINT}'"),
        (lambda: scene(ComputedTorque({JOINT: 0.0}, 1.0, 1.0)), "has no reference for joint"),
        (lambda: scene(Wrench([0.0] * 5)), "wrench must give 6 values, gave 5"),
        (lambda: Controller(lambda *_: [0.0], 0.0), "period of controller .* above zero"),
        (lambda: Controller(lambda *_: [0.0], float("nan")), "period of controller"),
        (lambda: scene("spring"), "forces must be those of pinred.forces, got 'spring'"),
        (lambda: scene(prescribed={JOINT: 0.3}), "must be a Signal, got 0.3"),
        (lambda: scene(prescribed=[JOINT]), "prescribed must be {joint: Signal}"),
        (lambda: scene(outputs="pose"), "outputs must be one of all, shape, got 'pose'"),
        (lambda: scene(prescribed={JOINT: Hold([0, 3], [0, 1])}), "continuous rate.*Spline"),
        (lambda: scene(prescribed={JOINT: Linear([0, 1, 3], [0, 1, 0])}), "continuous rate"),
        (
            lambda: scene(prescribed={JOINT: Spline([0, 1], [0, 1])}, duration=2.0),
            "defined from 0 to 1 s, but the scene goes from 0 to 2 s",
        ),
        (
            lambda: scene(Torque({JOINT: Spline([0.5, 3], [0, 1])}), duration=2.0),
            "defined from 0.5 to 3 s, but the scene goes from 0 to 2 s",
        ),
        (
            lambda: scene(*(ComputedTorque(dict.fromkeys(CAT.shape_names, 0.0), 1, 1),) * 2),
            "only one force may know all the others",
        ),
    ],
)
def test_values_that_cannot_be_used(make: Callable[[], Any], words: str) -> None:
    """Wrong numbers, counts, kinds and times are refused before anything runs."""
    with pytest.raises(pinred.InputError, match=words):
        make()


def test_one_force_need_not_stand_in_a_list() -> None:
    """forces=Spring(…) is that one force."""
    one = pinred.simulate(CAT, seed=0, duration=0.2, forces=Spring(JOINT, 1.0))
    listed = pinred.simulate(CAT, seed=0, duration=0.2, springs={JOINT: (1.0, 0.0)})
    np.testing.assert_array_equal(one.x, listed.x)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ([0.0, 0.0], "must give 3 finite torques"),
        ([0.0, float("nan"), 0.0], "must give 3 finite torques"),
        (None, "must be numbers|must give 3"),
        ({"knee": 1.0}, "gave a torque for 'knee' at t = 0 s"),
    ],
)
@pytest.mark.parametrize("engine", ["compiled", "pinocchio"])
def test_controllers_that_give_nonsense(given: Any, words: str, engine: Any) -> None:
    """What a controller returns is checked at every sample, and the time is said."""
    with pytest.raises(pinred.InputError, match=words):
        pinred.simulate(
            CAT, seed=0, duration=0.3, forces=Controller(lambda *_: given, 0.1), engine=engine
        )


def test_errors_of_a_controller_come_through() -> None:
    """An exception of the user's function is the user's."""

    def broken(*_: Any) -> Any:
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        pinred.simulate(CAT, seed=0, duration=0.3, forces=Controller(broken, 0.1))


def test_many_refuse_what_stops_an_integration() -> None:
    """Controllers and tables are refused by simulate_many; what has no breaks is not."""
    x0 = np.zeros((2, CAT.m))
    for force in (Controller(lambda *_: [0.0] * 3, 0.1), Torque({JOINT: Hold([0, 1], [0, 1])})):
        with pytest.raises(pinred.InputError, match="no controllers and no signals with breaks"):
            pinred.simulate_many(CAT, x0=x0, duration=2.0, forces=[force])
    many = pinred.simulate_many(CAT, x0=x0, duration=0.5, forces=[Torque({JOINT: 0.1})])
    one = pinred.simulate(CAT, x0=x0[0], duration=0.5, forces=[Torque({JOINT: 0.1})])
    np.testing.assert_array_equal(many[0].q, one.q)


def test_computed_torque_knows_no_pivot_in_gravity() -> None:
    """There the accelerations depend on the attitude, and the error says what to do."""
    top = pinred.load("coupled_spatial", group="SO3", gravity=(0.0, 0.0, -9.81))
    with pytest.raises(pinred.SymmetryError, match="gravity turns the base"):
        pinred.Scene(
            system=top,
            seed=0,
            forces=[ComputedTorque(dict.fromkeys(top.shape_names, 0.0), 1.0, 1.0)],
        )
