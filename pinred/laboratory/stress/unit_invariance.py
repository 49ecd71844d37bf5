"""Check that a motion does not depend on the system of units, such as g, mm and ms."""

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
from .aba_reference import aba_reference, samples
from .check import EPS, Case, Cases, Check, Trial, dop853

_ROUNDING = 50.0  # bound in units of eps times the growth times the square root of the steps
_RTOL = 1e-11
_NO_ATOL = 1e-30  # an absolute tolerance would depend on the units
# Without any absolute tolerance, an angle that starts at zero would require a first step of zero.
_POSES = {"falling_cat": None, "cartpole": None, "planar_chain5": [0.0, 0.0, 0.5]}


@dataclass(frozen=True)
class Units:
    """A system of units.

    Attributes:
        mass: Number of its mass units in 1 kg.
        length: Number of its length units in 1 m.
        time: Number of its time units in 1 s.
    """

    mass: float
    length: float
    time: float


_THOUSANDS = Units(1e3, 1e3, 1e3)  # g, mm, ms


def _cases(trial: Trial) -> Cases:
    rng = np.random.default_rng(2)
    systems_of_units = [Units(*10.0 ** rng.uniform(-4.0, 4.0, 3)) for _ in range(99)]
    for name in trial.pick(("falling_cat",), tuple(_POSES)):
        system = load(name)
        # Each system of units needs a separate kernel; a cartpole kernel compiles quickly.
        selected = systems_of_units[: trial.pick(2, 99 if name == "cartpole" else 12, 99)]
        times = np.linspace(0.0, 2.0, 21)
        pose0 = _POSES[name]
        scene = Scene(system=system, times=times, pose0=pose0)
        growth = aba_reference(scene, samples(scene)).growth
        for method in (dop853(_RTOL, _NO_ATOL), *(make(1e-2) for make in trial.fixed)):
            reference = trial.simulate(system, times=times, method=method, pose0=pose0)
            bound = _ROUNDING * EPS * growth * np.sqrt(reference.run.steps)
            errors = [_error(reference, trial, units) for units in [_THOUSANDS, *selected]]
            yield Case(f"{name}, {method.name}, g, mm, ms", errors[0], bound)
            yield Case(f"{name}, {method.name}, {len(selected)} others", max(errors), bound)


def _error(reference: Trajectory, trial: Trial, units: Units) -> float:
    """Compare a motion with the same motion simulated in other units."""
    system, method = reference.system, reference.scene.method
    start, converted = reference.scene.start, _convert(system, units)
    lengths = _lengths(system)
    factor = np.where(lengths, units.length, 1.0)
    r = system.r
    if isinstance(method, (RKMK4, Gauss)):
        method = replace(method, step=method.step * units.time)
    traj = trial.simulate(
        converted,
        x0=start.x * factor[r:],
        xdot0=start.xdot * factor[r:] / units.time,
        xi0=start.xi * factor[:r] / units.time,
        pose0=reference.scene.pose0,
        times=reference.t * units.time,
        method=method,
    )
    q = np.array(traj.q)
    for i in range(1, converted.model.njoints):
        joint = converted.model.joints[i]
        linear = min(joint.nq, int(lengths[joint.idx_v : joint.idx_v + joint.nv].sum()))
        q[:, joint.idx_q : joint.idx_q + linear] /= units.length
    gaps = [pin.difference(system.model, a, b) for a, b in zip(reference.q, q, strict=True)]
    return float(np.abs(gaps).max())


def _lengths(system: System) -> Array:
    """Return 1 for each velocity with the unit length/time, else 0; (n,)."""
    is_length = np.zeros(system.n)
    is_length[: system.group.linear] = 1.0
    for i in range(2, system.model.njoints):
        is_length[system.r + i - 2] = is_prismatic(system.model.joints[i])
    return is_length


def _convert(system: System, units: Units) -> System:
    """Convert a robot to other units."""
    model = system.model.copy()
    for i in range(1, model.njoints):
        placement, body = model.jointPlacements[i], model.inertias[i]
        model.jointPlacements[i] = pin.SE3(placement.rotation, placement.translation * units.length)
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
