"""The same motion seen from 100 frames: nothing but the frame may differ.

Where steps have a given length, by round-off alone.  Step control makes more of that: an
estimated error that is little but round-off decides how long a step is.
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
from .aba_reference import truth_of
from .check import EPS, Case, Cases, Check, Trial

_ROUNDING = 50.0  # of eps times the growth and the root of the number of steps
_TIMES = np.linspace(0.0, 5.0, 21)


def _cases(trial: Trial) -> Cases:
    methods: list[Method | Literal["auto"]] = ["auto", *(make(1e-2) for make in trial.fixed)]
    for name in trial.pick(("falling_cat",), ("falling_cat", "satellite_two_arms")):
        system = load(name)
        scene = Scene(system=system, times=_TIMES)
        growth = truth_of(scene, _TIMES[1:]).growth
        rng = np.random.default_rng(1)
        frames = [_frame(rng) for _ in range(trial.pick(5, 100))]
        # Each other frame of the base needs a kernel of its own.
        robots = [_moved_base(system, frame) for frame in frames[: trial.pick(2, 12, 100)]]
        for method in methods:
            here = trial.simulate(system, times=_TIMES, method=method)
            bound = _ROUNDING * EPS * growth * math.sqrt(here.run.steps)
            if method == "auto":
                bound += scene.rtol
            who = f"{name}, {here.run.method}"
            world = max(_in_the_world(trial, here, frame) for frame in frames)
            yield Case(f"{who}, {len(frames)} frames of the world", world, bound)
            base = max(
                _on_the_base(trial, here, robot, frame)
                for robot, frame in zip(robots, frames, strict=False)
            )
            yield Case(f"{who}, {len(robots)} frames of the base", base, bound)


def _in_the_world(trial: Trial, here: Trajectory, frame: pin.SE3) -> float:
    """Return how far the motion is from that which starts turned and moved by a frame."""
    start = here.scene.start
    there = trial.simulate(
        here.system,
        x0=start.x,
        xdot0=start.xdot,
        xi0=start.xi,
        pose0=pin.SE3ToXYZQUAT(frame),
        times=_TIMES,
        method=here.scene.method,
    )
    return _apart(here, there, frame, pin.SE3.Identity())


def _on_the_base(trial: Trial, here: Trajectory, robot: System, frame: pin.SE3) -> float:
    """Return how far the motion is from that of the robot with another frame on its base."""
    start = here.scene.start
    there = trial.simulate(
        robot,
        x0=start.x,
        xdot0=start.xdot,
        xi0=frame.inverse().toActionMatrix() @ start.xi,
        pose0=pin.SE3ToXYZQUAT(frame),
        times=_TIMES,
        method=here.scene.method,
    )
    return _apart(here, there, pin.SE3.Identity(), frame)


def _frame(rng: np.random.Generator) -> pin.SE3:
    """A frame that is turned and moved at random, by less than the robot's size."""
    return pin.SE3(pin.exp3(rng.uniform(-2.0, 2.0, 3)), rng.uniform(-0.5, 0.5, 3))


def _moved_base(system: System, frame: pin.SE3) -> System:
    """Return the robot with another frame on its base: that at `frame` in the old one."""
    model = system.model.copy()
    inverse = frame.inverse()
    model.inertias[1] = inverse.act(model.inertias[1])
    for i in range(2, model.njoints):
        if model.parents[i] == 1:
            model.jointPlacements[i] = inverse * model.jointPlacements[i]
    return load(model)


def _apart(a: Trajectory, b: Trajectory, world: pin.SE3, base: pin.SE3) -> float:
    """Return how far b is from a, if the one's world is `world` in the other's, and so the base."""
    worst = float(np.abs(a.x - b.x).max())
    for p, q in zip(a.pose, b.pose, strict=True):
        expected = world * pin.XYZQUATToSE3(p) * base
        worst = max(worst, _distance(expected, pin.XYZQUATToSE3(q)))
    return worst


def _distance(a: pin.SE3, b: pin.SE3) -> float:
    gap: Array = pin.log6(a.actInv(b)).vector
    return float(np.abs(gap).max())


CHECK = Check("frames", "difference of shape and pose, at 21 times", _cases)
