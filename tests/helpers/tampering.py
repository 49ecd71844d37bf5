"""Trajectories with manipulated states, to test that validation detects them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pinred
from pinred.common.arrays import Array
from pinred.simulation.motion import Motion
from pinred.system.state_fields import with_base

Change = Callable[[pinred.State], pinred.State]


def tampered(traj: pinred.Trajectory, change: Change) -> pinred.Trajectory:
    """Return the trajectory with manipulated states."""

    class Tampered(Motion):
        def states(self, t: Array) -> pinred.State:
            return change(with_base(super().states(t), ""))

    motion = Tampered(traj.motion.flow, traj.motion.segments)
    return pinred.Trajectory(traj.scene, motion, traj.run)


def offset(name: str, column: int, size: float) -> Change:
    """Return a change that adds `size` to a column of a field in the second half of the states."""

    def change(state: pinred.State) -> pinred.State:
        values: Array = getattr(state, name).copy()
        values[len(values) // 2 :, column] += size
        return replace(state, **{name: values})

    return change
