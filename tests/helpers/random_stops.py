"""Random scenes with joint stops, for attacks on the judge."""

from __future__ import annotations

from typing import Any

import numpy as np
from coupled_trees import make_case
from loop_robots import five_bar
from trees import random_model

import pinred
from pinred.forces import Torque

ROBOTS = (
    "planar_chain5", "tree", "followers", "loop", "snakeboard", "coupled_planar", "falling_cat",
)  # fmt: skip
GROUPS = ("R", "SO2", "SE2", "SO3", "SE3")
LOOP_STOPS = {
    "left_crank": (-1.0, -0.5), "right_crank": (-1.2, -0.6), "left_coupler": (-1.2, -0.1),
}  # fmt: skip


def random_stops(seed: int) -> tuple[pinred.System, dict[str, Any]]:
    """Return a random system, and the options of its scene with 2 to 6 stopped joints.

    Restitution is 0, 0.3, 1 or mixed, and tolerances go from 1e-6 to 1e-11.
    """
    rng, robot = np.random.default_rng(seed), ROBOTS[seed % len(ROBOTS)]
    if robot == "tree":
        system = pinred.load(random_model(GROUPS[seed % 5], 2 + seed % 4, seed))
    elif robot == "followers":
        system = make_case(GROUPS[seed % 5], 3 + seed % 3, seed).system
    elif robot == "loop":
        model, loops = five_bar()
        system = pinred.load(model, loops=loops)
    else:
        system = pinred.load(robot)
    rtol = 10.0 ** -float(rng.integers(6, 12))
    start: dict[str, Any] = {"rtol": rtol, "atol": 0.1 * rtol, "duration": rng.uniform(0.2, 1.0)}
    mixed = seed // 7 % 4 == 3
    e = rng.choice([0.0, 0.3, 0.6, 1.0], size=9) if mixed else [[0.0, 0.3, 1.0][seed // 7 % 4]] * 9
    if robot == "loop":
        rates = dict(zip(("left_crank", "right_crank"), rng.uniform(-2.0, 2.0, 2), strict=True))
        limits = LOOP_STOPS
        start |= {"xdot0": rates, "forces": [Torque(_spring(system, rng, 0.5))]}
    else:
        x0 = system.space.neutral
        values = dict(zip(system.tree.x_names, system.joint_values(x0), strict=True))
        limits = {
            joint.name: tuple(values[joint.name] + rng.uniform(0.05, 0.4, 2) * [-1.0, 1.0])
            for joint in system.tree.joints
            if system.coupled is None or len(system.coupled.terms(joint.v.start)) == 1
        }
        start |= {"x0": x0, "xdot0": rng.uniform(-3.0, 3.0, system.m)}
        start["xi0"] = 0.5 * rng.normal(size=system.r)
        forces = [[], [_constant(system, rng)], [_spring(system, rng, 3.0)]]
        start["forces"] = list(map(Torque, forces[seed % 3]))
    stops = {
        name: pinred.Stop(float(limit[0]), float(limit[1]), float(restitution))
        for (name, limit), restitution in zip(limits.items(), e, strict=False)
    }
    return system, start | {"stops": stops}


def _constant(system: pinred.System, rng: np.random.Generator) -> Any:
    torques = rng.uniform(-0.5, 0.5, system.m).tolist()
    return lambda *_: list(torques)


def _spring(system: pinred.System, rng: np.random.Generator, stiffness: float) -> Any:
    rest = rng.uniform(-0.2, 0.2, system.m).tolist()
    return lambda _, x, *__: [stiffness * (rest[k] - x[k]) for k in range(system.m)]
