"""Closed loops in MuJoCo, which are soft, and in pinred, which are exact, on the same robots.

MuJoCo's constraints are springs and dampers with a time constant (`solref`), and with an impedance
d below one (`solimp`): a fraction 1 − d of the force that violates a loop stays.  The time constant
must not be below two steps.  A stiffer loop therefore needs shorter steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.waiting import Progress, one_by_one
from ...scene.scene import Scene
from ...simulation.simulate import simulate
from ...simulation.trajectory import Trajectory
from ...system.load import load
from ...system.loops.kinematics import LoopKinematics, loop_ends
from ...system.loops.loop import Loop
from ...system.system import System
from .peers.mujoco import MujocoModel
from .timing import Tables, fastest, repeated

ROBOTS = ("four_bar", "gripper", "parallel_biped")
DURATION = 0.5  # [s]
# Integrator, step [s], and whether the loops are as stiff as this step allows.
SETTINGS = (
    ("Euler", 2e-3, False),
    ("implicitfast", 1e-3, True),
    ("implicitfast", 1e-4, True),
    ("RK4", 1e-3, True),
    ("RK4", 1e-4, True),
)
_DEFAULT = (0.02, (0.9, 0.95, 0.001))  # MuJoCo's time constant [s] and impedance
_STIFFEST = 0.9999  # largest impedance that MuJoCo accepts
_ROUNDS = 3


@checks_arguments
@dataclass(frozen=True)
class SoftLoop:
    """A motion of one method.

    Attributes:
        method: Name of the method, with its options.
        gap: Largest gap of a loop during the motion [m].
        error: Largest error of a joint at the end [rad | m].
        energy: Largest change of the energy, relative to the kinetic energy at the start.
        wall: Wall time of the motion [s].
    """

    method: str
    gap: float
    error: float
    energy: float
    wall: float


@checks_arguments
@dataclass(frozen=True)
class SoftLoops:
    """The methods on one robot.

    Attributes:
        robot: Name of the robot.
        duration: Duration of the motion [s].
        rows: The motions.
    """

    robot: str
    duration: float
    rows: tuple[SoftLoop, ...]

    def tables(self) -> Tables:
        """Return a row of the csv file for each motion."""
        head: dict[str, object] = {"robot": self.robot, "duration": self.duration}
        return {"loops": [{**head, **vars(row)} for row in self.rows]}

    def __str__(self) -> str:
        lines = [
            f"  {row.method:<66} {row.gap:9.1e} {row.error:12.1e} {row.energy:9.1e} "
            f"{1e3 * row.wall:10.2f}"
            for row in self.rows
        ]
        header = (
            f"  {'method':<66} {'gap [m]':>9} {'error [rad]':>12} {'energy':>9} {'time [ms]':>10}"
        )
        return "\n".join([f"{self.robot}: {self.duration:g} s", header, *lines])


@checks_arguments
def bench_loops(*, progress: Progress | bool | None = None) -> list[SoftLoops]:
    """Measure the gaps of MuJoCo's soft loops, and what small gaps cost, on each robot in ROBOTS.

    Args:
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        One result for each robot.
    """
    return one_by_one(list(ROBOTS), partial(_measure, duration=DURATION), progress, "loops")


def _measure(name: str, duration: float) -> SoftLoops:
    system = load(name, gravity=(0.0, 0.0, 0.0))
    scene = Scene(system=system, duration=duration)
    exact = simulate(scene, rtol=1e-13, atol=1e-15)
    rows = [_by_pinred(scene, rtol, exact) for rtol in (1e-6, 1e-10)]
    bridge = _LoopedModel(system)
    rows += [_by_mujoco(bridge, exact, *setting) for setting in SETTINGS]
    return SoftLoops(name, duration, tuple(rows))


def _by_pinred(scene: Scene, rtol: float, exact: Trajectory) -> SoftLoop:
    run = partial(simulate, scene, rtol=rtol, atol=1e-2 * rtol)
    traj, (wall,) = run(), fastest([repeated(run)], rounds=_ROUNDS, span=0.0)
    error = float(np.abs(traj.x[-1] - exact.x[-1]).max())
    drift = float(np.ptp(traj.energy)) / float(exact.energy[0])
    method = f"pinred, rtol {rtol:.0e}"
    return SoftLoop(method, _largest_gap(scene.system, traj.q), error, drift, wall)


class _LoopedModel(MujocoModel):
    """MuJoCo's model of a system with its loops as connect constraints."""

    def _build(self) -> Any:
        mj, system, spec = self.mj, self.system, super()._build()
        spec.option.disableflags &= ~int(mj.mjtDisableBit.mjDSBL_CONSTRAINT)
        bodies = {body.name: body for body in spec.bodies}
        for loop in system.loops:
            assert isinstance(loop, Loop)
            names = [f"{loop.name} {side}" for side in "ab"]
            for name, end in zip(names, loop_ends(system.model, loop), strict=True):
                bodies[f"body{end.joint}"].add_site(name=name, pos=end.placement.translation)
            spec.add_equality(
                name=loop.name, type=mj.mjtEq.mjEQ_CONNECT, objtype=mj.mjtObj.mjOBJ_SITE,
                name1=names[0], name2=names[1],
            )  # fmt: skip
        return spec

    def run(self, q: Array, v: Array, x: Array, step: float, duration: float) -> Array:
        """Return qpos after each step, (steps + 1, nq)."""
        mj, model, data = self.mj, self.model, self.data
        count = round(duration / step)
        model.opt.timestep = duration / count
        mj.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = self.qpos(q, x), self.qvel(q, v)
        every = max(1, count // 500)
        states = [data.qpos.copy()]
        for _ in range(count // every):
            mj.mj_step(model, data, every)
            states.append(data.qpos.copy())
        return np.array(states)


def _by_mujoco(
    bridge: _LoopedModel, exact: Trajectory, integrator: str, step: float, stiff: bool
) -> SoftLoop:
    model, system = bridge.model, bridge.system
    constant, impedance = _DEFAULT
    if stiff:
        constant, impedance = 2.0 * step, (_STIFFEST, _STIFFEST, 0.001)
    model.eq_solref[:, :2] = constant, 1.0
    model.eq_solimp[:, :3] = impedance
    model.opt.integrator = getattr(bridge.mj.mjtIntegrator, f"mjINT_{integrator.upper()}")
    model.opt.tolerance, model.opt.iterations = 1e-12, 200
    q, v, x = exact.q[0], exact.v[0], exact.x[0]
    run = partial(bridge.run, q, v, x, step, float(exact.t[-1]))
    states, (wall,) = run(), fastest([repeated(run)], rounds=_ROUNDS, span=0.0)
    ends = [bridge.end(state, np.zeros(model.nv), 0.0) for state in states]
    gap = _largest_gap(system, np.array([end.q for end in ends]))
    end = bridge.end(bridge.data.qpos.copy(), bridge.data.qvel.copy(), 0.0)
    data = system.model.createData()
    energy = pin.computeKineticEnergy(system.model, data, end.q, end.v)
    change = abs(energy / float(exact.energy[0]) - 1.0)
    error = float(np.abs(end.x - exact.x[-1]).max())
    method = f"MuJoCo {integrator}, step {step:g} s, solref {constant:g}, solimp {impedance[0]:g}"
    return SoftLoop(method, gap, error, float(change), wall)


def _largest_gap(system: System, q: Array) -> float:
    """Return the largest gap of a loop at configurations q (T, nq) [m]."""
    kinematics = LoopKinematics(system.model, system.loops)
    gaps = [kinematics.values(at).reshape(-1, 3) for at in q]
    return float(np.linalg.norm(np.array(gaps), axis=2).max())
