"""The forces of a scene together, and functions that are no expressions."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
import pytest
from coupled_trees import make_case
from trees import random_model

import pinred
from pinred.forces import ComputedTorque, PotentialEnergy, Torque, Wrench
from pinred.signals import Fourier


def tree() -> pinred.System:
    """Two joints on a free base."""
    return pinred.load(random_model("SE3", 2, 0))


def test_forces_that_do_work_have_labels() -> None:
    """Torques and wrenches do work; a potential belongs to the energy."""
    forces: list[Any] = [
        PotentialEnergy(lambda x: x[0] ** 2, name="well"),
        Torque(lambda *_: [0.1, 0.0], name="motor"),
        Wrench([0.1, 0.0, 0.0, 0.0, 0.0, 0.0], name="thruster"),
    ]
    model = pinred.Scene(system=tree(), forces=forces, seed=0).force_model
    assert model is not None
    assert list(model.labels) == ["motor", "thruster"]
    assert list(model.acting_on_base) == ["thruster"]
    assert model.has_potential


def test_computed_torque_rejects_followers() -> None:
    """The position of a follower depends on its leader."""
    system = make_case("SE3", 6, 0).system
    names = (*system.shape_names, system.followers[0])
    wave = Fourier(0.0, [0.1], [0.0], 1.0)
    with pytest.raises(pinred.InputError, match=f"'{names[-1]}'.*follows"):
        pinred.Scene(
            system=system, forces=ComputedTorque(dict.fromkeys(names, wave), 1.0, 1.0), seed=0
        )


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (lambda t: np.sin(t), "a function of NumPy was called on a CasADi symbol"),
        (lambda t: t * math.nan, "is NaN at all times"),
    ],
)
def test_python_math_in_forces_is_rejected(given: Any, said: str) -> None:
    """The error is raised even if warnings are ignored."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(pinred.InputError, match=said):
            pinred.Scene(system=tree(), forces=Torque(lambda t, *_: [given(t), 0.0]), seed=0)
