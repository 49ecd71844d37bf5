"""Random robots with springs, dampers and held joints, as scenes for the choice of a method."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ...forces.force import Force
from ...forces.kinds import PD, Damper, Spring
from ...scene.scene import Scene
from ...system.load import load
from ...system.system import System

_ROOTS = (pin.JointModelPlanar, pin.JointModelFreeFlyer)
_JOINTS = (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ)
_MOST_JOINTS = 8
_STIFFNESS = (-1.0, 4.0)  # decimal exponents of stiffnesses [N·m/rad]
_RATIO = (-3.0, 0.5)  # decimal exponents of damping divided by stiffness [s]


def held_robot(seed: int, duration: float = 2.0) -> Scene:
    """Return a random robot from a random initial state, with forces at most of its joints.

    Args:
        seed: Seed of the robot, its forces and its initial state.
        duration: Duration of the scene [s].
    Returns:
        The scene, which reports its end only.
    """
    rng = np.random.default_rng(seed)
    system = _tree(rng, seed)
    forces: list[Force] = []
    for name in system.shape_names:
        stiffness = float(10.0 ** rng.uniform(*_STIFFNESS))
        damping = stiffness * float(10.0 ** rng.uniform(*_RATIO))
        kind = rng.integers(4)
        if kind == 0:
            forces.append(Spring(name, stiffness, 0.1))
        elif kind == 1:
            forces.append(Damper(name, damping))
        elif kind == 2:
            forces.append(PD({name: float(rng.uniform(-0.5, 0.5))}, stiffness, damping))
    x0, xdot0 = rng.normal(scale=(0.3, 1.0), size=(system.m, 2)).T
    xi0 = rng.normal(scale=0.3, size=system.r)
    return Scene(system=system, x0=x0, xdot0=xdot0, xi0=xi0, times=[duration], forces=forces)


def _tree(rng: np.random.Generator, seed: int) -> System:
    """Return a random tree of 1 to _MOST_JOINTS hinges on a free base."""
    model = pin.Model()
    model.name, model.gravity = f"held{seed}", pin.Motion.Zero()
    planar = rng.random() < 0.3
    bodies = [model.addJoint(0, _ROOTS[not planar](), pin.SE3.Identity(), "base")]
    model.appendBodyToJoint(bodies[0], _body(rng, 5.0), pin.SE3.Identity())
    for k in range(int(rng.integers(1, _MOST_JOINTS + 1))):
        joint = _JOINTS[2 if planar else int(rng.integers(3))]()
        lever = rng.uniform(-0.4, 0.4, 3) * ([1.0, 1.0, 0.0] if planar else [1.0, 1.0, 1.0])
        parent = bodies[-1] if rng.random() < 0.7 else bodies[int(rng.integers(len(bodies)))]
        bodies.append(model.addJoint(parent, joint, pin.SE3(np.eye(3), lever), f"joint{k}"))
        model.appendBodyToJoint(bodies[-1], _body(rng, 1.0), pin.SE3.Identity())
    return load(model)


def _body(rng: np.random.Generator, scale: float) -> pin.Inertia:
    """Return a random box whose mass is about `scale` [kg]."""
    mass, sides = scale * float(rng.uniform(0.5, 2.0)), rng.uniform(0.1, 0.5, 3)
    moments = mass / 12.0 * (sides @ sides - sides**2)
    return pin.Inertia(mass, rng.uniform(-0.1, 0.1, 3) * [1.0, 1.0, 0.0], np.diag(moments))
