"""Random scenes over the full range of scene options. Their motions are correct."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from forced_trees import GRAVITY
from trees import random_model

import pinred
from pinred import forces
from pinred.common.arrays import Array
from pinred.lie import GROUPS

SCENES_OF_A_TREE = 12  # scenes per tree; several of them share a kernel
TINY = 1e-160  # speed whose square underflows to zero [rad/s | m/s]
FAR = 1e9  # distance at which positions have a round-off of 1e-7 m [m]
_MOST_STEPS = 20_000  # limits scenes with a tiny wheel on a stiff spring
_MOST_SECONDS = 2.0  # longest duration with springs, forces or gravity [s]


@dataclass(frozen=True)
class RandomScene:
    """The scene of a seed.

    Attributes:
        system: The random system.
        engine: Engine of the simulation.
        options: Options of `simulate`.
        about: Description in one line.
    """

    system: pinred.System
    engine: str
    options: dict[str, Any]
    about: str

    def simulate(self) -> pinred.Trajectory:
        """Return the trajectory of the scene."""
        return pinred.simulate(self.system, engine=self.engine, **self.options)  # type: ignore[arg-type]


def random_scene(seed: int) -> RandomScene:
    """Return the scene of a seed: speeds 1e-3 … 1e2, rtol 1e-4 … 1e-11, bases up to 1e6 m away.

    One scene in sixteen has the speed TINY, and one in sixteen has the distance FAR.
    """
    tree = np.random.default_rng([1, seed // SCENES_OF_A_TREE])
    rng = np.random.default_rng([2, seed])
    group = sorted(GROUPS)[seed // SCENES_OF_A_TREE % len(GROUPS)]
    system, heavy = _tree(group, tree)
    speed = 10.0 ** rng.uniform(-3.0, 2.0)
    rtol = 10.0 ** rng.uniform(-11.0, -4.0)
    offset = 10.0 ** rng.uniform(-3.0, 6.0) if rng.random() < 0.5 else 0.0
    speed = TINY if seed % 16 == 7 else speed
    offset = FAR if seed % 16 == 11 else offset
    engine = "pinocchio" if rng.random() < 0.15 else "compiled"
    options: dict[str, Any] = {
        "x0": rng.uniform(-3.0, 3.0, system.m),
        "xdot0": speed * rng.normal(size=system.m),
        "xi0": speed * rng.normal(size=system.r),
        "pose0": _pose(system, rng, offset),
        "rtol": rtol,
        "atol": rtol * 10.0 ** rng.uniform(-3.0, 0.0),
        **_forces(system, tree),
    }
    sprung = heavy or any(options.get(name) for name in ("springs", "prescribed", "forces"))
    seconds = float(10.0 ** rng.uniform(-1.0, 1.0) / speed)
    options["duration"] = min(seconds, _MOST_SECONDS) if sprung or speed == TINY else seconds
    method = "auto"
    if engine == "compiled":
        method = str(rng.choice(["auto", "DOP853", "Tsit5", "AdaptiveGauss", "Radau"]))
        options["method"] = method if method == "auto" else f"{method}(max_steps={_MOST_STEPS})"
    options["times"] = np.linspace(0.0, options["duration"], int(rng.integers(2, 60)))
    kinds = [name for name in ("springs", "prescribed", "forces") if options.get(name)]
    about = (
        f"{system.name}, speed {speed:.1e}, rtol {rtol:.1e}, offset {offset:.1e}, {engine}, "
        f"{method}, {options['duration']:.1e} s {' '.join(kinds)}{' gravity' if heavy else ''}"
    )
    return RandomScene(system, engine, options, about)


def _tree(group: str, rng: np.random.Generator) -> tuple[pinred.System, bool]:
    """Return a random tree, possibly with gravity, spherical bodies, or one light or heavy body."""
    model = random_model(
        group, int(rng.integers(0, 6)), int(rng.integers(2**31)), armature=bool(rng.random() < 0.5)
    )
    heavy = group in GRAVITY and rng.random() < 0.5
    if heavy:
        model.gravity.linear = np.array(GRAVITY[group])
    kind = rng.choice(["as it is", "spheres", "light tip", "heavy base"], p=[0.6, 0.2, 0.1, 0.1])
    if kind == "spheres":
        for i in range(1, model.njoints):
            _become_sphere(model, i, rng)
    elif kind == "light tip":
        _scale(model, model.njoints - 1, 10.0 ** rng.uniform(-4.0, 0.0))
    elif kind == "heavy base":
        _scale(model, 1, 10.0 ** rng.uniform(0.0, 4.0))
    model.name += f" ({kind})"
    return pinred.load(model), bool(heavy)


def _become_sphere(model: pin.Model, i: int, rng: np.random.Generator) -> None:
    mass, radius = float(rng.uniform(0.5, 2.0)), float(rng.choice([1e-3, 0.1, 1.0]))
    lever = rng.choice([0.0, 0.2], 3)
    model.inertias[i] = pin.Inertia(mass, lever, 0.4 * mass * radius**2 * np.eye(3))


def _scale(model: pin.Model, i: int, ratio: float) -> None:
    body = model.inertias[i]
    model.inertias[i] = pin.Inertia(ratio * body.mass, body.lever, ratio * body.inertia)


def _pose(system: pinred.System, rng: np.random.Generator, offset: float) -> Array:
    """Return a random pose at the given distance from the origin [m]."""
    log = rng.uniform(-1.5, 1.5, system.r)
    pose = np.array(system.group.exp(log))
    k = system.group.linear
    direction = rng.normal(size=k)
    pose[:k] += offset * direction / (np.linalg.norm(direction) or 1.0)
    return pose


def _forces(system: pinred.System, rng: np.random.Generator) -> dict[str, Any]:
    """Return random springs, prescribed joints and wrenches. Each kind changes the kernel."""
    options: dict[str, Any] = {}
    names = list(system.shape_names)
    if names and rng.random() < 0.3:
        options["springs"] = {
            names[0]: (float(10.0 ** rng.uniform(-2.0, 2.0)), float(rng.normal()))
        }
    if len(names) > 1 and rng.random() < 0.2:
        options["prescribed"] = {names[-1]: "0.3*sin(2*t) + 0.1*t"}
    if rng.random() < 0.2:
        wrench: Callable[[Any], Any] = lambda values: forces.Wrench(values)  # noqa: E731
        options["forces"] = [wrench((0.3 * rng.normal(size=system.r)).tolist())]
    return options
