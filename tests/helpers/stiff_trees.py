"""Random stiff trees: dampers, springs or PD control on light links, at 1e2 to 1e6 per second."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from trees import random_model

import pinred
from pinred.forces import PD, Damper, Force, Spring
from pinred.reduction.pointwise_reduction import PointwiseReduction

RATES = (2.0, 6.0)  # log10 of the least and the largest rate [1/s]
KINDS = ("damper", "spring", "pd")
GROUPS = ("SE3", "SO3", "SE2", "SO2", "R")
_OSCILLATIONS = 60.0  # largest number of radians of an undamped spring


@dataclass(frozen=True)
class StiffTree:
    """The scene of a seed.

    Attributes:
        scene: The scene.
        about: Description in one line.
    """

    scene: pinred.Scene
    about: str


def stiff_tree(seed: int) -> StiffTree:
    """Return the scene of a seed."""
    rng = np.random.default_rng([7, seed])
    group, kind = GROUPS[seed % len(GROUPS)], KINDS[seed % len(KINDS)]
    joints = int(rng.integers(1, 4))
    model = random_model(group, joints, int(rng.integers(2**31)), armature=False)
    ratio = 10.0 ** -rng.uniform(0.0, 5.0)
    tip = model.inertias[model.njoints - 1]
    model.inertias[model.njoints - 1] = pin.Inertia(
        ratio * tip.mass, tip.lever, ratio * tip.inertia
    )
    system = pinred.load(model)
    x0 = rng.uniform(-1.0, 1.0, joints)
    inverse = np.linalg.inv(PointwiseReduction(system).at(x0).reduced_metric)
    rate = 10.0 ** rng.uniform(*RATES)
    stiff = [joints - 1, *(k for k in range(joints - 1) if rng.random() < 0.2)]
    duration = float(rng.choice([0.3, 1.0, 2.0]))
    forces: list[Force] = []
    for k in stiff:
        name, inertia = system.shape_names[k], 1.0 / inverse[k, k]
        if kind == "damper":
            forces.append(Damper(name, rate * inertia))
        elif kind == "spring":  # with a ratio of damping between none and aperiodic
            zeta = rng.choice([0.0, 0.1, 0.7, 3.0])
            forces.append(Spring(name, rate**2 * inertia, x0[k] + 0.01 * rng.normal()))
            if zeta:
                forces.append(Damper(name, 2.0 * zeta * rate * inertia))
            else:
                duration = min(duration, _OSCILLATIONS / rate)
        else:
            goal = {name: float(x0[k] + 0.1 * rng.normal())}
            zeta = float(rng.choice([0.7, 1.0, 3.0]))
            gain = {name: rate**2 * inertia}
            forces.append(PD(goal, gain, {name: 2.0 * zeta * rate * inertia}, name=f"pd{k}"))
    options: dict[str, Any] = {
        "x0": x0,
        "xdot0": rng.normal(size=joints),
        "xi0": rng.normal(size=system.r),
        "forces": forces,
        "duration": duration,
        "times": [0.0, duration],
    }
    about = f"{seed}: {model.name} {kind} {rate:.1e}/s, tip {ratio:.0e}, {duration:g} s"
    return StiffTree(pinred.Scene(system=system, **options), about)


def damped_hinge(mass: float, coefficient: float) -> pinred.Scene:
    """Return a light link on a damped hinge of a heavy body that rotates about a fixed axis.

    Args:
        mass: Mass of the link [kg]; its inertia about the hinge is 0.0325 m² times this.
        coefficient: Damping of the hinge [N·m·s/rad].
    """
    model = pin.Model()
    root = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "root")
    body = pin.Inertia(2.0, np.array([0.1, 0.0, 0.0]), np.diag([0.1, 0.2, 0.3]))
    model.appendBodyToJoint(root, body, pin.SE3.Identity())
    model.gravity.setZero()
    place = pin.SE3(np.eye(3), np.array([0.2, 0.0, 0.0]))
    link = model.addJoint(root, pin.JointModelRY(), place, "a")
    light = pin.Inertia(mass, np.array([0.1, 0.0, 0.05]), 0.02 * mass * np.eye(3))
    model.appendBodyToJoint(link, light, pin.SE3.Identity())
    return pinred.Scene(
        system=pinred.load(model), x0=[0.4], xdot0=[0.7], xi0=[0.5], duration=2.0,
        forces=[Damper("a", coefficient)], times=[0.0, 2.0],
    )  # fmt: skip
