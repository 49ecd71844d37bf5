"""MuJoCo's rollout: a batch of members with its RK4, fixed steps in C."""

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

_CHUNK = 1000  # number of steps in one call; rollout stores the states of all steps
_MEMBERS = 2


def _prepare(members: Sequence[Problem], fraction: float) -> PreparedBatch:
    bridge = mujoco_model(members[0].system)
    rollout = import_module("mujoco.rollout")
    mj, model = bridge.mj, bridge.model
    count, duration = steps_of(fraction), members[0].start.duration
    initial = [
        np.concatenate([[0.0], bridge.qpos(p.q0, p.start.x), bridge.qvel(p.q0, p.v0)])
        for p in members
    ]
    data, start = mj.MjData(model), np.array(initial)

    def run() -> Array:
        model.opt.timestep, model.opt.integrator = duration / count, mj.mjtIntegrator.mjINT_RK4
        states, done = start, 0
        while done < count:
            steps = min(_CHUNK, count - done)
            history, _ = rollout.rollout(model, data, states, nstep=steps)
            states, done = np.ascontiguousarray(history[:, -1]), done + steps
        return states

    def ends(states: Array, members_count: int) -> list[End]:
        nq = model.nq
        return [
            bridge.end(row[1 : 1 + nq], row[1 + nq : 1 + nq + model.nv], 4 * count)
            for row in states[:members_count]
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
