"""The judge of motions with joint stops: it passes correct motions and finds planted faults."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hybrid_reference import stops_of

import pinred
from pinred.forces import Torque
from pinred.judge.verdict import Verdict
from pinred.simulation import run_with_stops
from pinred.simulation.compiled.compiled_flow import CompiledFlow

START: dict[str, Any] = {
    "x0": [0.1, 0.2, -0.1], "xdot0": [3.0, -3.0, 2.0], "xi0": [0.1, 0.2, 0.3, 0.1, 0.5, -0.2],
    "duration": 1.0,
}  # fmt: skip
PRESS = Torque(lambda *_: [0.05, 0.04, -0.02])


def cat(restitution: float, **options: Any) -> pinred.Trajectory:
    """Return a motion of the cat with stops at ±0.5 rad."""
    system = pinred.load("falling_cat")
    stops = {name: pinred.Stop(-0.5, 0.5, restitution) for name in system.shape_names}
    return pinred.simulate(system, **START | {"stops": stops} | options)


def failed(traj: pinred.Trajectory) -> set[str]:
    """Return the names of the checks that fail."""
    checks = pinred.compare(traj).checks
    return {name for name, (value, bound) in checks.items() if not value <= bound}


@pytest.mark.parametrize(("restitution", "forces"), [(0.6, []), (0.0, [PRESS])])
def test_correct_motions_with_stops_pass(restitution: float, forces: list[Torque]) -> None:
    """Correct motions with stops pass."""
    traj = cat(restitution, forces=forces)
    assert len(traj.impacts) >= 3
    if forces:
        assert any("at its" in label for _, label in traj.motion.modes)
    report = pinred.compare(traj)
    assert report.verdict is Verdict.PASSED, report
    assert "time of an impact [s]" in report.checks
    assert "time of an impact [s]" in str(report)


def test_wrong_restitution_fails() -> None:
    """Wrong restitution fails."""
    traj = cat(0.6 * (1.0 + 1e-4))
    stops = {name: replace(stop, restitution=0.6) for name, stop in stops_of(traj).items()}
    traj.scene = replace(traj.scene, stops=stops)
    assert "impulse of an impact [relative]" in failed(traj)


def test_missed_impact_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """Missed impact fails."""
    first = cat(0.6).impacts.joint[0]
    search = run_with_stops._StopSearch.look

    def look(self: Any, segment: Any) -> bool:
        search(self, segment)
        self.found = [root for root in self.found if root[1].joint != first]
        return bool(self.found)

    monkeypatch.setattr(run_with_stops._StopSearch, "look", look)
    names = failed(cat(0.6, stops={first: pinred.Stop(-0.5, 0.5, 0.6)}))
    assert {"impacts in other order", "distance beyond a stop"} <= names


def _negative(traj: pinred.Trajectory) -> None:
    table = traj.impacts
    vars(traj)["impacts"] = replace(table, impulse=-table.impulse)


def _late(traj: pinred.Trajectory) -> None:
    table = traj.impacts
    vars(traj)["impacts"] = replace(table, t=table.t + 1e-6)


def _swapped(traj: pinred.Trajectory) -> None:
    table = traj.impacts
    joint = list(table.joint)
    k = next(k for k in range(len(joint) - 1) if joint[k] != joint[k + 1])
    joint[k], joint[k + 1] = joint[k + 1], joint[k]
    vars(traj)["impacts"] = replace(table, joint=tuple(joint))


@pytest.mark.parametrize(
    ("plant", "check"),
    [
        (_negative, "impulse of an impact [relative]"),
        (_late, "time of an impact [s]"),
        (_swapped, "impacts in other order"),
    ],
)
def test_faults_in_the_table_fail(plant: Callable[[pinred.Trajectory], None], check: str) -> None:
    """Faults in the table fail."""
    traj = cat(0.6)
    plant(traj)
    assert check in failed(traj)


def test_stop_that_pulls_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stop that pulls fails."""
    monkeypatch.setattr(run_with_stops, "_CLINGING", 1.0)
    names = failed(cat(0.0, forces=[PRESS]))
    assert "pull of a stop [relative]" in names


def test_momentum_that_jumps_at_an_impact_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """Momentum that jumps at an impact fails."""
    resumed = CompiledFlow.resumed

    def jump(self: Any, t: float, *arguments: Any) -> CompiledFlow:
        flow = resumed(self, t, *arguments)
        flow.parameters[: flow.kernel.layout.base.spin] *= 1.0 + 1e-9
        return flow

    monkeypatch.setattr(CompiledFlow, "resumed", jump)
    assert "momentum at an impact [relative]" in failed(cat(0.6))


@pytest.mark.parametrize("beyond", [1e-9, -1e-9])
def test_grazing_impact_cannot_be_told(beyond: float) -> None:
    """Grazing impact cannot be told."""
    system = pinred.load("falling_cat")
    fine = np.linspace(0.0, 1.0, 20001)
    x = pinred.simulate(system, **START)(fine).x
    joint, k = next(
        (name, int(np.argmax(column)))
        for name, column in zip(system.shape_names, x.T, strict=True)
        if 0 < np.argmax(column) < 20000
    )
    top = float(x[k, system.shape_names.index(joint)]) + beyond
    report = pinred.compare(pinred.simulate(system, **START, stops={joint: (-10.0, top)}))
    assert report.verdict is Verdict.CANNOT_TELL
    assert "impacts can be judged until" in report.reasons[0]
