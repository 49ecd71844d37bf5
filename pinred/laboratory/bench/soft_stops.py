"""Joint stops in MuJoCo, which are soft, in Drake's discrete solver, and in pinred, on one scene.

MuJoCo's stops are springs and dampers with a time constant (`solref`) of at least two steps, and
with an impedance (`solimp`) below one.  A critically damped one, the default, rebounds, because
it only pushes; high damping comes near the restitution 0.  Drake's discrete solver treats stops as
nearly rigid, at the ends of its steps.  Neither finds the time of an impact, so errors are
of first order in the step, down to the rebound that damping leaves.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.waiting import Progress, quiet, shown
from ...scene.scene import Scene
from ...simulation.simulate import simulate
from ...system.load import load
from ...system.system import System
from .peers.drake import DrakeModel
from .peers.mujoco import MujocoModel
from .solver import End
from .timing import Tables, alternating, repeated

ROBOT = "falling_cat"
STOPS = {"bend": (-0.6, 0.6), "sway": (-0.5, 0.5), "twist": (-0.4, 0.4)}  # [rad]; restitution 0
RATES = (3.0, -2.0, 1.5)  # initial joint rates [rad/s]
TWIST = (0.0, 0.0, 0.0, 0.3, -0.2, 0.4)  # initial twist of the base [m/s; rad/s]
DURATION = 1.0  # [s]
TOLERANCES = (1e-6, 1e-10)  # of pinred; times are relative to the last one
# Integrator of MuJoCo, step [s], and damping ratio of stops that are as stiff as this step allows;
# 0 for MuJoCo's default stops.
MUJOCO = (
    ("Euler", 2e-3, 0.0),
    ("implicitfast", 1e-3, 1.0),
    ("implicitfast", 1e-3, 30.0),
    ("implicitfast", 1e-4, 30.0),
    ("implicitfast", 1e-5, 30.0),
    ("RK4", 1e-4, 30.0),
)
DRAKE = (1e-3, 1e-4, 1e-5)  # steps of Drake's discrete solver [s]
# MuJoCo's time constant [s], damping ratio and impedance.
_DEFAULT = ((0.02, 1.0), (0.9, 0.95, 0.001))
_STIFFEST = 0.9999  # largest impedance that MuJoCo accepts
_ROUNDS = 3
_LOOKS = 1000  # number of times at which excursions beyond stops are measured

Stepper: TypeAlias = Callable[[int], Array]  # returns joint positions after a number of steps


@checks_arguments
@dataclass(frozen=True)
class SoftStop:
    """A motion of one method.

    Attributes:
        method: Name of the method, with its options.
        error: Largest error of a joint at the end [rad | m].
        beyond: Largest distance of a joint beyond its stop during the motion [rad | m].
        momentum: Largest change of the angular momentum about the centre of mass, relative.
        times: Median CPU time, relative to that of pinred at its last tolerance.
    """

    method: str
    error: float
    beyond: float
    momentum: float
    times: float


@checks_arguments
@dataclass(frozen=True)
class SoftStops:
    """The methods on one scene.

    Attributes:
        scene: Name of the scene.
        impacts: Number of its impacts.
        rows: The motions.
        missing: Names of tools that are not installed.
    """

    scene: str
    impacts: int
    rows: tuple[SoftStop, ...]
    missing: tuple[str, ...]

    def tables(self) -> Tables:
        """Return a row of the csv file for each motion."""
        return {"stops": [{"scene": self.scene, **vars(row)} for row in self.rows]}

    def __str__(self) -> str:
        head = f"  {'method':<66} {'error [rad]':>11} {'beyond [rad]':>12} {'momentum':>9} times"
        lines = [
            f"  {row.method:<66} {row.error:11.1e} {row.beyond:12.1e} {row.momentum:9.1e} "
            f"{row.times:5.2g}"
            for row in self.rows
        ]
        lines += [f"  {name} is not installed" for name in self.missing]
        return "\n".join([f"{self.scene}: {self.impacts} impacts", head, *lines])


@dataclass(frozen=True)
class _Trial:
    """A method on the scene.

    Attributes:
        method: Name of the method, with its options.
        run: Function that runs the whole motion and returns its end.
        beyond: Function that returns the largest distance beyond a stop.
    """

    method: str
    run: Callable[[], End]
    beyond: Callable[[], float]


@checks_arguments
def bench_stops(*, progress: Progress | bool | None = None) -> SoftStops:
    """Measure errors and times of joint stops in pinred, MuJoCo and Drake on one scene.

    The exact motion is that of pinred at a relative tolerance of 1e-13, which `compare` judges.

    Args:
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        The motions.
    """
    scene = stopped_scene()
    system = scene.system
    exact = simulate(scene, rtol=1e-13, atol=1e-15)
    q, v, x = exact.q[0], exact.v[0], exact.x[0]
    trials, missing = [_by_pinred(scene, rtol) for rtol in TOLERANCES], list[str]()
    last = len(trials) - 1
    if find_spec("mujoco") is None:
        missing.append("MuJoCo")
    else:
        trials += [_by_mujoco(system, (q, v, x), *setting) for setting in MUJOCO]
    if find_spec("pydrake") is None:
        missing.append("Drake")
    else:
        trials += [_by_drake(system, (q, v, x), step) for step in DRAKE]
    with shown(progress, "stops") as bar:
        actions = [repeated(trial.run) for trial in trials]
        seconds = alternating(
            actions, rounds=_ROUNDS, span=0.0, clock=time.process_time, progress=bar or quiet
        )
    times = np.nanmedian(seconds / seconds[:, last : last + 1], axis=0)
    before = _angular_momentum(system, q, v)
    rows = list[SoftStop]()
    for trial, ratio in zip(trials, times.tolist(), strict=True):
        end = trial.run()
        error = float(np.abs(end.x - exact.x[-1]).max())
        change = _angular_momentum(system, end.q, end.v) - before
        drift = float(np.abs(change).max() / np.abs(before).max())
        rows.append(SoftStop(trial.method, error, trial.beyond(), drift, ratio))
    text = f"{ROBOT}, stops of all joints, {DURATION:g} s"
    return SoftStops(text, len(exact.impacts.times), tuple(rows), tuple(missing))


def stopped_scene() -> Scene:
    """Return the scene: a cat that hits the stops of its spine while it turns."""
    system = load(ROBOT, gravity=(0.0, 0.0, 0.0))
    return Scene(
        system=system, x0=[0.0] * system.m, xdot0=RATES, xi0=TWIST, duration=DURATION, stops=STOPS
    )


def _angular_momentum(system: System, q: Array, v: Array) -> Array:
    """Return the angular momentum about the centre of mass in world axes, (3,)."""
    return np.array(pin.computeCentroidalMomentum(system.model, system.data, q, v).angular)


def _beyond(x: Array) -> float:
    """Return the largest distance beyond a stop of shapes (T, m); 0 if there is none."""
    lower, upper = np.array([*STOPS.values()]).T
    return float(np.maximum(lower - x, x - upper).max(initial=0.0))


def _by_pinred(scene: Scene, rtol: float) -> _Trial:
    run = partial(simulate, scene, rtol=rtol, atol=1e-2 * rtol)

    def end() -> End:
        traj = run()
        return End(traj.x[-1], traj.q[-1], traj.v[-1], float(traj.run.evaluations))

    def beyond() -> float:
        return _beyond(run()(np.linspace(0.0, DURATION, _LOOKS + 1)).x)

    return _Trial(f"pinred, rtol {rtol:.0e}", end, beyond)


class _StoppedModel(MujocoModel):
    """MuJoCo's model of a system with limits of its joints."""

    def _build(self) -> Any:
        mj, spec = self.mj, super()._build()
        spec.option.disableflags &= ~int(mj.mjtDisableBit.mjDSBL_CONSTRAINT)
        joints = {joint.name: joint for joint in spec.joints}
        for name, limits in STOPS.items():
            joint = joints[f"joint{self.system.model.getJointId(name)}"]
            joint.limited, joint.range = True, limits
        return spec


def _by_mujoco(
    system: System, start: tuple[Array, Array, Array], integrator: str, step: float, damping: float
) -> _Trial:
    bridge = _StoppedModel(system)
    mj, model, data = bridge.mj, bridge.model, bridge.data
    reference, impedance = _DEFAULT
    if damping:
        reference, impedance = (2.0 * step, damping), (_STIFFEST, _STIFFEST, 0.001)
    model.jnt_solref[:, :2], model.jnt_solimp[:, :3] = reference, impedance
    model.opt.integrator = getattr(mj.mjtIntegrator, f"mjINT_{integrator.upper()}")
    model.opt.tolerance, model.opt.iterations, model.opt.timestep = 1e-12, 200, step
    count, (q, v, x) = round(DURATION / step), start

    def begin() -> None:
        mj.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = bridge.qpos(q, x), bridge.qvel(q, v)

    def run() -> End:
        begin()
        mj.mj_step(model, data, count)
        return bridge.end(data.qpos.copy(), data.qvel.copy(), float(count))

    def beyond() -> float:
        begin()
        every, shapes = max(1, count // _LOOKS), list[Array]()
        for _ in range(count // every):
            mj.mj_step(model, data, every)
            shapes.append(data.qpos[-system.m :].copy())
        return _beyond(np.array(shapes))

    settings = f"solref {reference[0]:g} {reference[1]:g}, solimp {impedance[0]:g}"
    name = f"MuJoCo {integrator}, step {step:g} s, {settings}"
    return _Trial(name, run, beyond)


def _by_drake(system: System, start: tuple[Array, Array, Array], step: float) -> _Trial:
    bridge, (q, v, x) = DrakeModel(system, step, STOPS), start
    plant = bridge.plant
    simulator = import_module("pydrake.systems.analysis").Simulator(plant)
    context = simulator.get_mutable_context()
    q0, v0 = bridge.positions(q, x), bridge.velocities(q, v)

    def begin() -> None:
        context.SetTime(0.0)
        plant.SetPositions(context, q0)
        plant.SetVelocities(context, v0)
        simulator.Initialize()

    def end() -> End:
        return bridge.end(plant.GetPositions(context), plant.GetVelocities(context), 0.0)

    def run() -> End:
        begin()
        simulator.AdvanceTo(DURATION)
        return end()

    def beyond() -> float:
        begin()
        shapes = list[Array]()
        for t in np.linspace(0.0, DURATION, _LOOKS + 1)[1:].tolist():
            simulator.AdvanceTo(t)
            shapes.append(end().x)
        return _beyond(np.array(shapes))

    return _Trial(f"Drake's discrete solver (SAP), step {step:g} s", run, beyond)
