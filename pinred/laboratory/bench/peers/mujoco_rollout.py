"""MuJoCo's rollout: many members by its own RK4, equal steps in C."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module

import numpy as np

from ....common.arrays import Array
from ..member_batch import BatchSolver, PreparedBatch
from ..problems import Problem
from ..solver import End, halvings, steps_of
from .equality import missing_unless_equal
from .mujoco import mujoco_model

_AT_ONCE = 1000  # steps whose states rollout keeps
_MEMBERS = 2


def _prepare(members: Sequence[Problem], part: float) -> PreparedBatch:
    bridge = mujoco_model(members[0].system)
    rollout = import_module("mujoco.rollout")
    mj, model = bridge.mj, bridge.model
    count, duration = steps_of(part), members[0].start.duration
    rows = [
        np.concatenate([[0.0], bridge.qpos(p.q0, p.start.x), bridge.qvel(p.q0, p.v0)])
        for p in members
    ]
    data, start = mj.MjData(model), np.array(rows)

    def run() -> Array:
        model.opt.timestep, model.opt.integrator = duration / count, mj.mjtIntegrator.mjINT_RK4
        states, done = start, 0
        while done < count:
            steps = min(_AT_ONCE, count - done)
            found, _ = rollout.rollout(model, data, states, nstep=steps)
            states, done = np.ascontiguousarray(found[:, -1]), done + steps
        return states

    def ends(states: Array, several: int) -> list[End]:
        nq = model.nq
        return [
            bridge.end(row[1 : 1 + nq], row[1 + nq : 1 + nq + model.nv], 4 * count)
            for row in states[:several]
        ]

    return PreparedBatch(run, ends)


ROLLOUT = (
    BatchSolver(
        "mujoco-rollout",
        "MuJoCo's rollout with RK4, equal steps",
        halvings(400, 10),
        _prepare,
        missing_unless_equal("mujoco", "MuJoCo", mujoco_model),
        most=_MEMBERS,
    ),
)
