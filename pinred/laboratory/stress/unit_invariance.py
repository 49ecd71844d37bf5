"""The same motion in other units: kg, m and s against g, mm and ms, and others."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...integrators.methods import RKMK4, Gauss
from ...scene.scene import Scene
from ...simulation.trajectory import Trajectory
from ...system.joints import is_prismatic
from ...system.load import load
from ...system.system import System
from .aba_reference import samples, truth_of
from .check import EPS, Case, Cases, Check, Trial, dop853

_ROUNDING = 50.0  # of eps times the growth, and the root of the number of steps
_RTOL = 1e-11
_NO_ATOL = 1e-30  # an absolute tolerance would be another one in other units
# With none, an angle that begins at zero asks for a first step of nothing.
_POSES = {"falling_cat": None, "cartpole": None, "planar_chain5": [0.0, 0.0, 0.5]}


@dataclass(frozen=True)
class Units:
    """Numbers of new units in 1 kg, 1 m and 1 s."""

    mass: float
    length: float
    time: float


_THOUSANDS = Units(1e3, 1e3, 1e3)  # g, mm, ms


def _cases(trial: Trial) -> Cases:
    rng = np.random.default_rng(2)
    every = [Units(*10.0 ** rng.uniform(-4.0, 4.0, 3)) for _ in range(99)]
    for name in trial.pick(("falling_cat",), tuple(_POSES)):
        system = load(name)
        # Each needs a kernel of its own, and that of a cartpole is soon made.
        drawn = every[: trial.pick(2, 99 if name == "cartpole" else 12, 99)]
        times = np.linspace(0.0, 2.0, 21)
        pose0 = _POSES[name]
        scene = Scene(system=system, times=times, pose0=pose0)
        growth = truth_of(scene, samples(scene)).growth
        for method in (dop853(_RTOL, _NO_ATOL), *(make(1e-2) for make in trial.fixed)):
            here = trial.simulate(system, times=times, method=method, pose0=pose0)
            bound = _ROUNDING * EPS * growth * np.sqrt(here.run.steps)
            worst = [_apart(here, trial, units) for units in [_THOUSANDS, *drawn]]
            yield Case(f"{name}, {method.name}, g, mm, ms", worst[0], bound)
            yield Case(f"{name}, {method.name}, {len(drawn)} others", max(worst), bound)


def _apart(here: Trajectory, trial: Trial, units: Units) -> float:
    """Return how far a motion is from the same one found in other units."""
    system, method = here.system, here.scene.method
    start, other = here.scene.start, _converted(system, units)
    lengths = _lengths(system)
    factor = np.where(lengths, units.length, 1.0)
    r = system.r
    if isinstance(method, (RKMK4, Gauss)):
        method = replace(method, step=method.step * units.time)
    found = trial.simulate(
        other,
        x0=start.x * factor[r:],
        xdot0=start.xdot * factor[r:] / units.time,
        xi0=start.xi * factor[:r] / units.time,
        pose0=here.scene.pose0,
        times=here.t * units.time,
        method=method,
    )
    back = np.array(found.q)
    for i in range(1, other.model.njoints):
        joint = other.model.joints[i]
        linear = min(joint.nq, int(lengths[joint.idx_v : joint.idx_v + joint.nv].sum()))
        back[:, joint.idx_q : joint.idx_q + linear] /= units.length
    gaps = [pin.difference(system.model, a, b) for a, b in zip(here.q, back, strict=True)]
    return float(np.abs(gaps).max())


def _lengths(system: System) -> Array:
    """Return which velocities are lengths per time, (n,), as 1 and 0."""
    out = np.zeros(system.n)
    out[: system.group.linear] = 1.0
    for i in range(2, system.model.njoints):
        out[system.r + i - 2] = is_prismatic(system.model.joints[i])
    return out


def _converted(system: System, units: Units) -> System:
    """Return the robot in other units."""
    model = system.model.copy()
    for i in range(1, model.njoints):
        place, body = model.jointPlacements[i], model.inertias[i]
        model.jointPlacements[i] = pin.SE3(place.rotation, place.translation * units.length)
        model.inertias[i] = pin.Inertia(
            body.mass * units.mass,
            body.lever * units.length,
            body.inertia * units.mass * units.length**2,
        )
    model.gravity.linear = model.gravity.linear * units.length / units.time**2
    inertial = np.where(_lengths(system), units.mass, units.mass * units.length**2)
    model.armature = model.armature * inertial
    return load(model)


CHECK = Check("units", "difference of configurations in 100 systems of units", _cases)
