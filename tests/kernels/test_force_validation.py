"""Tests that Pinocchio validates robot-dependent forces: link wrenches and inverse dynamics."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from trees import placement, random_model

import pinred
from pinred.common.object_cache import ObjectCache
from pinred.forces import ComputedTorque, Wrench, force_model
from pinred.forces.force_model import ForceModel
from pinred.forces.force_numbers import RobotSymbols
from pinred.kernels.build import build_kernel
from pinred.kernels.kernel import Structure
from pinred.reduction.tree.free_bodies import Freed

FAULT = 1.0 + 3e-10  # three times the tolerance


@pytest.fixture(autouse=True)
def empty_cache(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Use an empty cache, so that every kernel is built."""
    monkeypatch.setenv("PINRED_CACHE_DIR", str(tmp_path))


def tree(ratio: float = 1.0, group: str = "SE3") -> pinred.System:
    """Return a tree with a link on its last body, whose mass is scaled by a ratio."""
    model, rng = random_model(group, 2, 1), np.random.default_rng(0)
    light, last = model.inertias[3], pin.Frame("tip", 3, 0, placement(rng), pin.FrameType.BODY)
    model.inertias[3] = pin.Inertia(ratio * light.mass, light.lever, ratio * light.inertia)
    model.addFrame(last, False)
    return pinred.load(model)


def link_wrench(size: float = 1e3) -> Wrench:
    """Return a dominant wrench at a point of this link."""
    pull = [size, 0.5 * size, -size, 0.1 * size, 0.0, 0.2 * size]
    return Wrench(pull, link="tip", at=[0.1, 0.2, 0.3], frame="world")


def holding_controller(system: pinred.System) -> ComputedTorque:
    """Return a controller that holds the joints."""
    return ComputedTorque(dict.fromkeys(system.shape_names, 0.1), kp=4.0, kd=2.0)


def build_with(system: pinred.System, force: Any, freed: Freed | None = None) -> None:
    """Build the kernel of a force; freed: parameters that the force ignores."""
    free = Freed() if freed is None else freed
    forces = ForceModel(system, [force], {})
    build_kernel(system, Structure(zero_momentum=False, freed=free), forces, ObjectCache())


def test_validation_detects_wrong_link_wrench(monkeypatch: pytest.MonkeyPatch) -> None:
    """The joint torques of a link wrench, with three times the allowed error, are rejected."""
    system, right = tree(), vars(force_model)["of_load"]
    build_with(system, link_wrench())

    def wrong(*arguments: Any) -> Any:
        torque, wrench = right(*arguments)
        return torque * FAULT, wrench

    monkeypatch.setattr(force_model, "of_load", wrong)
    with pytest.raises(pinred.KernelMismatch, match="Pinocchio: acceleration is"):
        build_with(system, link_wrench())


def test_validation_detects_wrong_inverse_dynamics(monkeypatch: pytest.MonkeyPatch) -> None:
    """Torques with three times the allowed error are rejected."""
    system, right = tree(), vars(force_model)["required_torque"]
    build_with(system, holding_controller(system))
    monkeypatch.setattr(force_model, "required_torque", lambda *a: right(*a) * FAULT)
    with pytest.raises(pinred.KernelMismatch, match="Pinocchio: inverse dynamics is"):
        build_with(system, holding_controller(system))


@pytest.mark.parametrize("freed", [Freed(steps=((2, "x" * 8),)), Freed(inertias=(2,))])
def test_validation_detects_constants_in_place_of_parameters(freed: Freed) -> None:
    """Expressions with nominal values fail if these are variable parameters of the kernel."""
    system = tree()
    force = link_wrench() if freed.steps else holding_controller(system)
    words = "rate of the angular momentum" if freed.steps else "inverse dynamics"
    with pytest.raises(pinred.KernelMismatch, match=f"Pinocchio: {words} is"):
        build_with(system, force, freed)


def test_validation_detects_constant_gravity(monkeypatch: pytest.MonkeyPatch) -> None:
    """Inverse dynamics with the nominal gravity is rejected."""
    pole, given = pinred.load("cartpole"), vars(RobotSymbols)["gravity"].fget
    own = [0.0, 0.0, -9.81]
    options: dict[str, Any] = {
        "forces": [holding_controller(pole)],
        "parameters": {"pole.mass": 1.1},
    }
    scene = {"system": pole, "seed": 1, "duration": 0.1, **options}
    pinred.simulate(pinred.Scene(**scene))

    def kept(self: RobotSymbols) -> Any:
        given(self)
        return list(own)

    monkeypatch.setattr(RobotSymbols, "gravity", property(kept))
    again = scene | {"forces": [holding_controller(pole)]}
    with pytest.raises(pinred.KernelMismatch, match="Pinocchio: inverse dynamics is"):
        pinred.simulate(pinred.Scene(**again))


def test_light_bodies_pass_validation() -> None:
    """A kernel passes however light the loaded body is."""
    system = tree(1e-12)
    build_with(system, link_wrench(1e-12))
    build_with(system, holding_controller(system))
