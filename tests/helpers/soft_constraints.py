"""Measure soft constraints: `python tests/helpers/soft_constraints.py loops`, or `stops`.

Closed loops and joint stops in MuJoCo and Drake, where they are soft, are compared with pinred's.

MuJoCo's constraints are springs and dampers with a time constant (`solref`) of at least two steps,
and with an impedance d below one (`solimp`): a fraction 1 − d of the force that violates a
constraint stays. A stiffer constraint therefore needs shorter steps. A critically damped stop, the
default, rebounds, because it only pushes; high damping comes near the restitution 0. Drake's
discrete solver treats stops as nearly rigid, at the ends of its steps. Neither finds the time of an
impact, so errors are of first order in the step, down to the rebound that damping leaves.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from pinred.common.arrays import Array
from pinred.common.waiting import Progress, one_by_one, quiet, shown
from pinred.laboratory.bench.peers.drake import DrakeModel
from pinred.laboratory.bench.peers.mujoco import MujocoModel
from pinred.laboratory.bench.problems import End
from pinred.laboratory.bench.timing import Table, alternating, repeated
from pinred.scene.scene import Scene
from pinred.simulation.simulate import simulate
from pinred.simulation.trajectory import Trajectory
from pinred.system.load import load
from pinred.system.loops.kinematics import LoopKinematics, loop_ends
from pinred.system.loops.loop import Loop
from pinred.system.system import System

TOLERANCES = (1e-6, 1e-10)  # of pinred; times are relative to the last one
_STIFFEST = (0.9999, 0.9999, 0.001)  # largest impedance that MuJoCo accepts
_DEFAULT = ((0.02, 1.0), (0.9, 0.95, 0.001))  # time constant [s], damping ratio, and impedance
_ROUNDS = 3
_LOOKS = 1000  # number of times at which violations are measured

Start: TypeAlias = tuple[Array, Array, Array]  # q, v and the unwrapped shape
Violation: TypeAlias = Callable[[Sequence[End]], float]  # of constraints, over some states


@dataclass(frozen=True)
class _Trial:
    """A method on the scene.

    Attributes:
        method: Name of the method, with its options.
        run: Function that runs the whole motion and returns its end.
        looks: Function that runs the motion and returns states during it.
    """

    method: str
    run: Callable[[], End]
    looks: Callable[[], Sequence[End]]


def _compare(
    trials: Sequence[_Trial],
    exact: Trajectory,
    violation: tuple[str, Violation],
    conserved: tuple[str, Callable[[Array, Array], Any]],
    progress: Progress = quiet,
) -> tuple[SimpleNamespace, ...]:
    """Time all methods alternately, and measure their errors.

    Args:
        trials: The methods; the first ones are pinred at TOLERANCES.
        exact: The exact motion.
        violation: Name and measure of the violation of constraints during a motion.
        conserved: Name of a conserved quantity, and the function of q and v that computes it.
        progress: Called with the completed fraction.
    Returns:
        A row for each method.
    """
    actions = [repeated(trial.run) for trial in trials]
    seconds = alternating(
        actions, rounds=_ROUNDS, span=0.0, clock=time.process_time, progress=progress
    )
    one = seconds[:, len(TOLERANCES) - 1 :][:, :1]
    columns = zip(
        np.nanmedian(seconds, axis=0).tolist(), np.nanmedian(seconds / one, axis=0), strict=True
    )
    before, table_rows = conserved[1](exact.q[0], exact.v[0]), []
    for trial, (cpu, times) in zip(trials, columns, strict=True):
        end = trial.run()
        change = np.abs(conserved[1](end.q, end.v) - before).max() / np.abs(before).max()
        numbers = {
            violation[0]: violation[1](trial.looks()),
            "error": float(np.abs(end.x - exact.x[-1]).max()),
            conserved[0]: float(change),
        }
        table_rows.append(
            SimpleNamespace(method=trial.method, **numbers, cpu=cpu, times=float(times))
        )
    return tuple(table_rows)


def _by_pinred(scene: Scene) -> list[_Trial]:
    def run(rtol: float) -> Trajectory:
        return simulate(scene, rtol=rtol, atol=1e-2 * rtol)

    def end(rtol: float) -> End:
        traj = run(rtol)
        return End(traj.x[-1], traj.q[-1], traj.v[-1], float(traj.run.evaluations))

    def looks(rtol: float) -> list[End]:
        states = run(rtol)(np.linspace(0.0, scene.end, _LOOKS + 1))
        return [End(*state, np.nan) for state in zip(states.x, states.q, states.v, strict=True)]

    return [
        _Trial(f"pinred, rtol {rtol:.0e}", partial(end, rtol), partial(looks, rtol))
        for rtol in TOLERANCES
    ]


def _start(exact: Trajectory) -> Start:
    return exact.q[0], exact.v[0], exact.x[0]


class _SoftModel(MujocoModel):
    """MuJoCo's model of a system with constraints."""

    def _build(self) -> Any:
        spec = super()._build()
        spec.option.disableflags &= ~int(self.mj.mjtDisableBit.mjDSBL_CONSTRAINT)
        self._constrain(spec)
        return spec

    def _constrain(self, spec: Any) -> None:
        """Add the constraints."""
        raise NotImplementedError

    def trial(
        self, start: Start, duration: float, integrator: str, step: float, damping: float
    ) -> _Trial:
        """Return the trial of an integrator.

        Args:
            start: Initial state.
            duration: Duration of the motion [s].
            integrator: Name of the integrator.
            step: Step [s].
            damping: Damping ratio of constraints that are as stiff as the step allows; 0 for
                MuJoCo's default constraints.
        Returns:
            The trial.
        """
        mj, model, data = self.mj, self.model, self.data
        reference, impedance = ((2.0 * step, damping), _STIFFEST) if damping else _DEFAULT
        count, (q, v, x) = round(duration / step), start

        def begin() -> None:
            model.eq_solref[:, :2] = model.jnt_solref[:, :2] = reference
            model.eq_solimp[:, :3] = model.jnt_solimp[:, :3] = impedance
            model.opt.integrator = getattr(mj.mjtIntegrator, f"mjINT_{integrator.upper()}")
            model.opt.tolerance, model.opt.iterations = 1e-12, 200
            model.opt.timestep = duration / count
            mj.mj_resetData(model, data)
            data.qpos[:], data.qvel[:] = self.qpos(q, x), self.qvel(q, v)

        def run() -> End:
            begin()
            mj.mj_step(model, data, count)
            return self.end(data.qpos.copy(), data.qvel.copy(), float(count))

        def looks() -> list[End]:
            begin()
            stride, states = max(1, count // _LOOKS), []
            for _ in range(count // stride):
                mj.mj_step(model, data, stride)
                states.append(self.end(data.qpos.copy(), data.qvel.copy(), float(count)))
            return states

        settings = f"solref {reference[0]:g} {reference[1]:g}, solimp {impedance[0]:g}"
        return _Trial(f"MuJoCo {integrator}, step {step:g} s, {settings}", run, looks)


LOOPED = ("four_bar", "gripper", "parallel_biped")
LOOP_DURATION = 0.5  # [s]
# Integrator of MuJoCo, step [s], and damping ratio of stiff loops (0 for the default loops).
LOOP_SETTINGS = (
    ("Euler", 2e-3, 0.0),
    ("implicitfast", 1e-3, 1.0),
    ("implicitfast", 1e-4, 1.0),
    ("RK4", 1e-3, 1.0),
    ("RK4", 1e-4, 1.0),
)


def measure_loops() -> list[Table]:
    """Measure the gaps of MuJoCo's soft loops, and what small gaps cost, on each robot in LOOPED.

    Returns:
        A table for each robot, with a row for each method: the largest gap of a loop during the
        motion [m], the largest error of a joint at the end [rad | m], the relative change of the
        kinetic energy, and the CPU time, also relative to that of pinred at its last tolerance.
    """
    return one_by_one(list(LOOPED), _measure_loop, True, "loops")


def _measure_loop(name: str) -> Table:
    system = load(name, gravity=(0.0, 0.0, 0.0))
    scene = Scene(system=system, duration=LOOP_DURATION)
    exact = simulate(scene, rtol=1e-13, atol=1e-15)
    bridge, kinematics = _LoopedModel(system), LoopKinematics(system.model, system.loops)
    trials = _by_pinred(scene)
    trials += [bridge.trial(_start(exact), scene.end, *setting) for setting in LOOP_SETTINGS]

    def gap(states: Sequence[End]) -> float:
        gaps = [kinematics.values(state.q).reshape(-1, 3) for state in states]
        return float(np.linalg.norm(np.array(gaps), axis=2).max())

    energy = partial(pin.computeKineticEnergy, system.model, system.model.createData())
    rows = _compare(trials, exact, ("gap", gap), ("energy", energy))
    units = {"gap": "m", "error": "rad | m", "cpu": "s"}
    shared = {"robot": name, "duration": scene.end}
    return Table("loops", rows, units, f"{name}: {scene.end:g} s", shared=shared)


class _LoopedModel(_SoftModel):
    """MuJoCo's model of a system with its loops as connect constraints."""

    def _constrain(self, spec: Any) -> None:
        mj, bodies = self.mj, {body.name: body for body in spec.bodies}
        for loop in self.system.loops:
            assert isinstance(loop, Loop)
            names = [f"{loop.name} {side}" for side in "ab"]
            for name, end in zip(names, loop_ends(self.system.model, loop), strict=True):
                bodies[f"body{end.joint}"].add_site(name=name, pos=end.placement.translation)
            spec.add_equality(
                name=loop.name, type=mj.mjtEq.mjEQ_CONNECT, objtype=mj.mjtObj.mjOBJ_SITE,
                name1=names[0], name2=names[1],
            )  # fmt: skip


ROBOT = "falling_cat"
STOPS = {"bend": (-0.6, 0.6), "sway": (-0.5, 0.5), "twist": (-0.4, 0.4)}  # [rad]; restitution 0
RATES = (3.0, -2.0, 1.5)  # initial joint rates [rad/s]
TWIST = (0.0, 0.0, 0.0, 0.3, -0.2, 0.4)  # initial twist of the base [m/s; rad/s]
STOP_DURATION = 1.0  # [s]
# Integrator of MuJoCo, step [s], and damping ratio of stiff stops (0 for the default stops).
STOP_SETTINGS = (
    ("Euler", 2e-3, 0.0),
    ("implicitfast", 1e-3, 1.0),
    ("implicitfast", 1e-3, 30.0),
    ("implicitfast", 1e-4, 30.0),
    ("implicitfast", 1e-5, 30.0),
    ("RK4", 1e-4, 30.0),
)
DRAKE = (1e-3, 1e-4, 1e-5)  # steps of Drake's discrete solver [s]


def measure_stops() -> Table:
    """Measure errors and times of joint stops in pinred, MuJoCo and Drake on one scene.

    The exact motion is that of pinred at a relative tolerance of 1e-13, which `compare` judges.

    Returns:
        A row for each method: the largest distance of a joint beyond its stop during the motion
        [rad | m], the largest error of a joint at the end, the relative change of the angular
        momentum about the centre of mass, and the CPU time, also relative to that of pinred at its
        last tolerance.
    """
    scene = stopped_scene()
    system = scene.system
    exact = simulate(scene, rtol=1e-13, atol=1e-15)
    start, trials, missing = _start(exact), _by_pinred(scene), list[str]()
    if find_spec("mujoco") is None:
        missing.append("MuJoCo")
    else:
        bridge = _StoppedModel(system)
        trials += [bridge.trial(start, STOP_DURATION, *setting) for setting in STOP_SETTINGS]
    if find_spec("pydrake") is None:
        missing.append("Drake")
    else:
        trials += [_by_drake(system, start, step) for step in DRAKE]

    def beyond(states: Sequence[End]) -> float:
        x, (lower, upper) = np.array([state.x for state in states]), np.array([*STOPS.values()]).T
        return float(np.maximum(lower - x, x - upper).max(initial=0.0))

    def angular_momentum(q: Array, v: Array) -> Array:
        """Return the angular momentum about the centre of mass in world axes, (3,)."""
        return np.array(pin.computeCentroidalMomentum(system.model, system.data, q, v).angular)

    with shown(True, "stops") as bar:
        measures = ("beyond", beyond), ("momentum", angular_momentum)
        rows = _compare(trials, exact, *measures, bar or quiet)
    impacts = len(exact.impacts.times)
    stops = f"{ROBOT}, stops of all joints, {STOP_DURATION:g} s"
    units = {"beyond": "rad | m", "error": "rad | m", "cpu": "s"}
    notes = tuple(f"{name} is not installed" for name in missing)
    return Table("stops", rows, units, f"{stops}: {impacts} impacts", notes, {"scene": stops})


def stopped_scene() -> Scene:
    """Return the scene: a cat that hits the stops of its spine while it turns."""
    system = load(ROBOT, gravity=(0.0, 0.0, 0.0))
    return Scene(
        system=system, x0=[0.0] * system.m, xdot0=RATES, xi0=TWIST, duration=STOP_DURATION,
        stops=STOPS,
    )  # fmt: skip


class _StoppedModel(_SoftModel):
    """MuJoCo's model of a system with limits of its joints."""

    def _constrain(self, spec: Any) -> None:
        joints = {joint.name: joint for joint in spec.joints}
        for name, limits in STOPS.items():
            joint = joints[f"joint{self.system.model.getJointId(name)}"]
            joint.limited, joint.range = True, limits


def _by_drake(system: System, start: Start, step: float) -> _Trial:
    bridge, (q, v, x) = DrakeModel(system, step, STOPS), start
    plant = bridge.plant
    simulator = import_module("pydrake.systems.analysis").Simulator(plant)
    context = simulator.get_mutable_context()
    q0, v0 = bridge.positions(q, x), bridge.velocities(q, v)

    def looks(count: int = _LOOKS) -> list[End]:
        context.SetTime(0.0)
        plant.SetPositions(context, q0)
        plant.SetVelocities(context, v0)
        simulator.Initialize()
        states = []
        for t in np.linspace(0.0, STOP_DURATION, count + 1)[1:].tolist():
            simulator.AdvanceTo(t)
            state = plant.GetPositions(context), plant.GetVelocities(context)
            states.append(bridge.end(*state, np.nan))
        return states

    return _Trial(f"Drake's discrete solver (SAP), step {step:g} s", lambda: looks(1)[0], looks)


if __name__ == "__main__":
    tables = [measure_stops()] if sys.argv[1:] == ["stops"] else measure_loops()
    print("\n\n".join(map(str, tables)))
