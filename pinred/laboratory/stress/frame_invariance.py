"""Check that a motion does not depend on the frames of the world and of the base.

With fixed steps, motions differ by round-off alone. Step control amplifies round-off, because error
estimates that are only round-off then determine the step length.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...integrators.methods import Method
from ...scene.scene import Scene
from ...simulation.trajectory import Trajectory
from ...system.load import load
from ...system.system import System
from .aba_reference import aba_reference
from .check import EPS, Case, Cases, Check, Trial

_ROUNDING = 50.0  # bound in units of eps times the growth times the square root of the steps
_TIMES = np.linspace(0.0, 5.0, 21)


def _cases(trial: Trial) -> Cases:
    methods: list[Method | Literal["auto"]] = ["auto", *(make(1e-2) for make in trial.fixed)]
    for name in trial.pick(("falling_cat",), ("falling_cat", "satellite_two_arms")):
        system = load(name)
        scene = Scene(system=system, times=_TIMES)
        growth = aba_reference(scene, _TIMES[1:]).growth
        rng = np.random.default_rng(1)
        frames = [_frame(rng) for _ in range(trial.pick(5, 100))]
        # Every frame of the base needs a separate kernel.
        robots = [_with_base_frame(system, frame) for frame in frames[: trial.pick(2, 12, 100)]]
        for method in methods:
            reference = trial.simulate(system, times=_TIMES, method=method)
            bound = _ROUNDING * EPS * growth * math.sqrt(reference.run.steps)
            if method == "auto":
                bound += scene.rtol
            case = f"{name}, {reference.run.method}"
            world = max(_error_in_world(trial, reference, frame) for frame in frames)
            yield Case(f"{case}, {len(frames)} frames of the world", world, bound)
            base = max(
                _error_on_base(trial, reference, robot, frame)
                for robot, frame in zip(robots, frames, strict=False)
            )
            yield Case(f"{case}, {len(robots)} frames of the base", base, bound)


def _error_in_world(trial: Trial, reference: Trajectory, frame: pin.SE3) -> float:
    """Compare the reference with a motion from a rotated and translated initial pose."""
    start = reference.scene.start
    transformed = trial.simulate(
        reference.system,
        x0=start.x,
        xdot0=start.xdot,
        xi0=start.xi,
        pose0=pin.SE3ToXYZQUAT(frame),
        times=_TIMES,
        method=reference.scene.method,
    )
    return _difference(reference, transformed, frame, pin.SE3.Identity())


def _error_on_base(trial: Trial, reference: Trajectory, robot: System, frame: pin.SE3) -> float:
    """Compare the reference with a motion of the robot with another frame on its base."""
    start = reference.scene.start
    transformed = trial.simulate(
        robot,
        x0=start.x,
        xdot0=start.xdot,
        xi0=frame.inverse().toActionMatrix() @ start.xi,
        pose0=pin.SE3ToXYZQUAT(frame),
        times=_TIMES,
        method=reference.scene.method,
    )
    return _difference(reference, transformed, pin.SE3.Identity(), frame)


def _frame(rng: np.random.Generator) -> pin.SE3:
    """Return a random frame, translated by less than the robot's size."""
    return pin.SE3(pin.exp3(rng.uniform(-2.0, 2.0, 3)), rng.uniform(-0.5, 0.5, 3))


def _with_base_frame(system: System, frame: pin.SE3) -> System:
    """Return the robot with its base frame moved to the pose `frame` in the old base frame."""
    model = system.model.copy()
    inverse = frame.inverse()
    model.inertias[1] = inverse.act(model.inertias[1])
    for i in range(2, model.njoints):
        if model.parents[i] == 1:
            model.jointPlacements[i] = inverse * model.jointPlacements[i]
    return load(model)


def _difference(a: Trajectory, b: Trajectory, world: pin.SE3, base: pin.SE3) -> float:
    """Return the largest difference of motions, after a is expressed in b's frames."""
    worst = float(np.abs(a.x - b.x).max())
    for p, q in zip(a.pose, b.pose, strict=True):
        expected = world * pin.XYZQUATToSE3(p) * base
        worst = max(worst, _distance(expected, pin.XYZQUATToSE3(q)))
    return worst


def _distance(a: pin.SE3, b: pin.SE3) -> float:
    gap: Array = pin.log6(a.actInv(b)).vector
    return float(np.abs(gap).max())


CHECK = Check("frames", "difference of shape and pose, at 21 times", _cases)
