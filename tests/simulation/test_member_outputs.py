"""States of all members are computed in one loop, with the bits of single members."""

from __future__ import annotations

import threading
import tracemalloc
from typing import Any

import numpy as np
import pytest

from pinred import load, simulate_many
from pinred.simulation.members.trajectories import Trajectories
from pinred.system.state_fields import arrays_of

CASES: dict[str, dict[str, Any]] = {
    "all": {},
    "shape": {"outputs": "shape"},
    "momentum of some members": {"momentum": [[0, 0, 0], [1, 2, 3], [0, 0, 0], [0, 1, 0]]},
    "time in the state": {"prescribed": {"joint2": "0.3*sin(t)"}},
    "members that fail": {"method": "DOP853(max_steps=12)", "xi0": [[0, 0, 0], [9, 9, 90]] * 2},
}


@pytest.mark.parametrize("case", CASES)
def test_outputs_of_all_members_equal_those_of_each(case: str) -> None:
    """The loop over members passes each member its own state, parameters and path."""
    system = load("planar_chain5", lock=("joint3", "joint4", "joint5"))
    x0 = np.random.default_rng(0).normal(size=(4, 2))
    options: dict[str, Any] = {"x0": x0, "xdot0": [1, 2], "times": [0, 0.3, 1.0], **CASES[case]}
    many = simulate_many(system, **options, threads=1)
    assert ("fail" in case) == bool(many.failures)
    each = [many._states(member) for member in range(4)]
    for name, array in arrays_of(many.outputs).items():
        expected = many.t if name == "t" else np.array([getattr(states, name) for states in each])
        assert np.array_equal(array, expected, equal_nan=True), name
        assert not array.flags.writeable


def test_one_thread_is_kept_for_further_calls() -> None:
    """With threads=1, a second call creates no thread."""
    system = load("planar_chain5", lock=("joint3", "joint4", "joint5"))

    def run() -> Trajectories:
        return simulate_many(system, x0=np.zeros((4, 2)), times=[0, 0.1], threads=1)

    run()
    before = set(threading.enumerate())
    run()
    assert set(threading.enumerate()) == before


def test_batch_copies_no_states_that_all_members_have() -> None:
    """Members that are all integrated together need at most 850 bytes each, not 1010."""
    system, count = load("planar_chain5"), 20_000
    x0 = np.random.default_rng(0).normal(size=(count, system.m))
    peaks = []
    for size in (count // 4, count):
        options: dict[str, Any] = {"x0": x0[:size], "times": [1e-3], "rtol": 1e-3}
        simulate_many(system, **options, threads=1)
        tracemalloc.start()
        try:
            simulate_many(system, **options, threads=1)
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    assert (peaks[1] - peaks[0]) / (count - count // 4) < 850
