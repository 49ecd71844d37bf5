"""Forces that act by the robot are judged by Pinocchio alone: where they pull, and its dynamics."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from trees import placement, random_model

import pinred
from pinred.forces import ComputedTorque, Wrench, force_model, inverse_dynamics
from pinred.forces.force_model import ForceModel
from pinred.forces.robot_symbols import RobotSymbols
from pinred.kernels.build import build_kernel
from pinred.kernels.layout import Structure
from pinred.kernels.object_cache import ObjectCache
from pinred.reduction.tree.free_bodies import Freed

FAULT = 1.0 + 3e-10  # three times what passes


@pytest.fixture(autouse=True)
def empty_cache(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have every kernel built."""
    monkeypatch.setenv("PINRED_CACHE_DIR", str(tmp_path))


def tree(ratio: float = 1.0, group: str = "SE3") -> pinred.System:
    """Return a tree with a link on its last body, which is lighter by a ratio."""
    model, rng = random_model(group, 2, 1), np.random.default_rng(0)
    light, last = model.inertias[3], pin.Frame("tip", 3, 0, placement(rng), pin.FrameType.BODY)
    model.inertias[3] = pin.Inertia(ratio * light.mass, light.lever, ratio * light.inertia)
    model.addFrame(last, False)
    return pinred.load(model)


def pulled(size: float = 1e3) -> Wrench:
    """Return a pull at a point of that link, which outweighs all else."""
    pull = [size, 0.5 * size, -size, 0.1 * size, 0.0, 0.2 * size]
    return Wrench(pull, link="tip", at=[0.1, 0.2, 0.3], frame="world")


def held(system: pinred.System) -> ComputedTorque:
    """Return what holds the joints."""
    return ComputedTorque(dict.fromkeys(system.shape_names, 0.1), kp=4.0, kd=2.0)


def build_with(system: pinred.System, force: Any, freed: Freed | None = None) -> None:
    """Build the kernel of a force; freed: what of the robot its expressions do not know to vary."""
    free = Freed() if freed is None else freed
    forces = ForceModel(system, [force], {})
    build_kernel(system, Structure(zero_momentum=False, freed=free), forces, ObjectCache())


def test_a_wrong_pull_on_a_link_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a wrench on a link is to the joints, off by three times what may be."""
    system, right = tree(), vars(force_model)["of_load"]
    build_with(system, pulled())

    def wrong(*arguments: Any) -> Any:
        found = right(*arguments)
        return type(found)(found.torque * FAULT, found.wrench)

    monkeypatch.setattr(force_model, "of_load", wrong)
    with pytest.raises(pinred.KernelMismatch, match="Pinocchio: acceleration is"):
        build_with(system, pulled())


def test_wrong_inverse_dynamics_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Torques for accelerations, off by three times what may be."""
    system, right = tree(), vars(inverse_dynamics)["required_torque"]
    build_with(system, held(system))
    monkeypatch.setattr(inverse_dynamics, "required_torque", lambda *a: right(*a) * FAULT)
    with pytest.raises(pinred.KernelMismatch, match="Pinocchio: inverse dynamics is"):
        build_with(system, held(system))


@pytest.mark.parametrize("freed", [Freed(steps=((2, "x" * 8),)), Freed(inertias=(2,))])
def test_numbers_that_do_not_vary_with_the_robot_are_found(freed: Freed) -> None:
    """Expressions that have kept the robot's own numbers, where the kernel takes others."""
    system = tree()
    force = pulled() if freed.steps else held(system)
    words = "rate of the angular momentum" if freed.steps else "inverse dynamics"
    with pytest.raises(pinred.KernelMismatch, match=f"Pinocchio: {words} is"):
        build_with(system, force, freed)


def test_gravity_that_does_not_vary_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Inverse dynamics that has kept the gravity that the robot has."""
    pole, given = pinred.load("cartpole"), vars(RobotSymbols)["gravity"].fget
    own = [0.0, 0.0, -9.81]
    options: dict[str, Any] = {"forces": [held(pole)], "parameters": {"pole.mass": 1.1}}
    scene = {"system": pole, "seed": 1, "duration": 0.1, **options}
    pinred.simulate(pinred.Scene(**scene))

    def kept(self: RobotSymbols) -> Any:
        given(self)
        return list(own)

    monkeypatch.setattr(RobotSymbols, "gravity", property(kept))
    again = scene | {"forces": [held(pole)]}
    with pytest.raises(pinred.KernelMismatch, match="Pinocchio: inverse dynamics is"):
        pinred.simulate(pinred.Scene(**again))


def test_light_bodies_raise_no_alarm() -> None:
    """However light the body that is pulled or held is."""
    system = tree(1e-12)
    build_with(system, pulled(1e-12))
    build_with(system, held(system))
