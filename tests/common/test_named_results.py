"""Results by name list their names when asked for an unknown one."""

from __future__ import annotations

import copy
import pickle

import pytest

import pinred
from pinred.common.names import NamedResults


def test_unknown_event_error_lists_the_events_of_the_run() -> None:
    """The most similar name comes first."""
    events = [pinred.Event("x[0] - 0.1", "apex"), pinred.Event("x[0] - 9", "landing")]
    rods = pinred.load("three_rods")
    traj = pinred.simulate(rods, x0=[0.0, 0.0], xdot0=[1.0, 0.0], duration=0.2, events=events)
    assert len(traj.events["apex"].t) == 1
    message = "no event 'apx'; did you mean 'apex'. the events are apex, landing"
    with pytest.raises(KeyError, match=message):
        traj.events["apx"]
    assert "apx" not in traj.events
    assert traj.events.get("apx") is None


def test_unknown_loop_error_lists_the_loops() -> None:
    """Forces in closed loops have the names of the loops."""
    gripper = pinred.load("gripper")
    traj = pinred.simulate(gripper, seed=0, duration=0.01)
    with pytest.raises(KeyError, match=f"the loops are {gripper.loops[0].name}, "):
        traj.loop_forces["?"]


def test_empty_results_say_so_after_copies() -> None:
    """Copies and pickles keep the kind of the names."""
    empty = NamedResults[int]("event", {})
    for results in (empty, copy.deepcopy(empty), pickle.loads(pickle.dumps(empty))):
        with pytest.raises(KeyError, match="no event 'x'; there is no event"):
            results["x"]
