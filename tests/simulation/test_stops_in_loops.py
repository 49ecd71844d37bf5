"""Joint stops in closed loops: impacts, rest and release against Pinocchio on the full state."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from loop_robots import five_bar, four_bar, sliding_bars

import pinred
from pinred.common.errors import IntegrationError
from pinred.forces import Torque
from pinred.judge.verdict import Verdict
from pinred.simulation import run_with_stops

PRESS = Torque(lambda t, *_: [3.0 * (t - 0.5) ** 3, 0.0, 0.3, 0.0])
START: dict[str, Any] = {"xdot0": {"left_crank": 1.0, "right_crank": -0.5}, "duration": 1.05}
COARSE: dict[str, Any] = {"rtol": 1e-7, "atol": 1e-9}  # for fast comparisons


def load_five_bar() -> pinred.System:
    """Return the five-bar linkage, whose shape space has two dimensions."""
    model, loops = five_bar()
    return pinred.load(model, loops=loops)


def five_bar_motion(restitution: float, forces: list[Torque], **options: Any) -> pinred.Trajectory:
    """Return a motion of the five-bar linkage between its stops."""
    stops = {
        "left_crank": (-1.0, -0.5, restitution),
        "right_crank": (-1.2, -0.6, restitution),
        "left_coupler": (-1.2, -0.1, restitution),
    }
    options = START | {"stops": stops, "forces": forces} | options
    return pinred.simulate(load_five_bar(), **options)


# A slide that closes a loop bounces, below, and passes the comparison.
@pytest.mark.by_hand
def test_impacts_in_a_loop_pass_the_comparison() -> None:
    """The comparison takes impulses from the full mass matrix and all equations of the loop."""
    traj = five_bar_motion(0.5, [], **COARSE, duration=0.45)
    assert traj.impacts.joint == ("left_crank", "right_crank")
    report = pinred.compare(traj)
    assert report.verdict is Verdict.PASSED, report


# Other tests of this file have rests, releases and impacts, in a loop, one by one.
@pytest.mark.by_hand
def test_rest_and_release_in_a_loop_pass_the_comparison() -> None:
    """Joints rest one at a time and together, and are released by impacts of others."""
    traj = five_bar_motion(0.0, [PRESS], **COARSE)
    labels = [label for _, label in traj.motion.modes]
    assert "right_crank at its upper stop" in labels
    assert labels[-1] == "left_crank at its upper stop, right_crank at its upper stop"
    report = pinred.compare(traj)
    assert report.verdict is Verdict.PASSED, report
    np.testing.assert_allclose(traj.energy_balance.residual, 0.0, atol=1e-6)


def test_impulses_in_a_loop_obey_the_equations_of_all_joints() -> None:
    """H Δv consists of the impulse of the stop and of impulses of the loop, by Pinocchio."""
    traj = five_bar_motion(0.5, [])
    model = traj.system.model
    data, (first, second) = (
        model.createData(),
        [model.getFrameId(name) for name in ("left_tip", "right_tip")],
    )
    table = traj.impacts
    before, after = traj(table.t), traj(np.nextafter(table.t, np.inf))
    for k, name in enumerate(table.joint):
        q, v, new = before.q[k], before.v[k], after.v[k]
        upper = np.triu(pin.crba(model, data, q))
        H = upper + np.triu(upper, 1).T
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        J = np.subtract(
            *(
                pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)[:2]
                for frame in (first, second)
            )
        )
        np.testing.assert_allclose(J @ new, 0.0, atol=1e-12)
        at = model.joints[model.getJointId(name)].idx_v
        np.testing.assert_allclose(new[at], -0.5 * v[at], rtol=1e-10)
        impulse = H @ (new - v)
        impulse[at] -= table.impulse[k]
        multipliers = np.linalg.lstsq(J.T, impulse, rcond=None)[0]
        assert np.abs(multipliers).max() > 1e-3
        np.testing.assert_allclose(J.T @ multipliers, impulse, atol=1e-12)
        lost = 0.5 * (v @ H @ v - new @ H @ new)
        np.testing.assert_allclose(table.energy_lost[k], lost, rtol=1e-9)


def test_rest_in_a_loop_equals_a_loop_with_a_locked_joint() -> None:
    """With restitution 0, a pressed joint moves as one that is locked when it is loaded."""
    model, loops = five_bar()
    system = pinred.load(model, loops=loops)
    x0 = pinred.simulate(system, duration=1e-3, xdot0={"right_crank": 0.0}).x[0]
    push = Torque(lambda *_: [2.0, 0.0, 0.1, 0.0])
    rates = {"left_crank": 0.0, "right_crank": 0.8}
    traj = pinred.simulate(
        system, x0=x0, xdot0=rates, duration=0.5, forces=[push], stops={"left_crank": (-9.0, x0[0])}
    )
    assert traj.motion.modes == ((0.0, "left_crank at its upper stop"),)
    locked = pinred.load(model, loops=loops, lock={"left_crank": float(x0[0])})
    other = pinred.simulate(
        locked, x0=x0[1:], xdot0=traj.xdot[0, 1:], xi0=traj.xi[0], duration=0.5,
        forces=[Torque(lambda *_: [0.0, 0.1, 0.0])],
    )  # fmt: skip
    np.testing.assert_allclose(traj.x[:, 1:], other.x, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(traj.xi, other.xi, rtol=0.0, atol=1e-9)


def test_rest_of_the_only_freedom_of_a_loop_stops_all_its_joints() -> None:
    """A crank that rests locks the whole four-bar linkage until the torque pulls it away."""
    model, loops = four_bar()
    system = pinred.load(model, loops=loops)
    start = pinred.simulate(system, duration=1e-3, xdot0={"crank": 1.0})
    top = float(start.x[0, 0]) + 0.3
    traj = pinred.simulate(
        system, x0=start.x[0], xdot0={"crank": 1.0}, xi0=[0.1, 0.0, 0.2], duration=1.2,
        forces=[Torque(lambda t, *_: [2.0 * (1.0 - t), 0.0, 0.0])], stops={"crank": (-9.0, top)},
        **COARSE,
    )  # fmt: skip
    labels = [label for _, label in traj.motion.modes]
    assert labels == ["no joint at rest", "crank at its upper stop", "no joint at rest"]
    (_, (rest, _), (release, _)) = traj.motion.modes
    resting = (traj.t > rest) & (traj.t < release)
    assert np.abs(traj.xdot[resting]).max() < 1e-11
    # The reaction of a linkage that turns as one body includes the moment of the loop.
    report = pinred.compare(traj)
    assert report.verdict is Verdict.PASSED, report


def test_slide_in_a_loop_bounces() -> None:
    """A slide that closes a loop bounces at its stop."""
    model, loops = sliding_bars()
    system = pinred.load(model, loops=loops)
    slide = next(
        name for name, unit in zip(system.shape_names, system.units, strict=True) if unit == "m"
    )
    k = system.shape_names.index(slide)
    free = pinred.simulate(system, duration=1.0, xdot0={slide: 0.5})
    position = float(free.x[:, k].max() - 0.5 * np.ptp(free.x[:, k]))
    bounds = (-9.0, position) if free.x[0, k] < position else (position, 9.0)
    traj = pinred.simulate(
        system, duration=1.0, xdot0={slide: 0.5}, stops={slide: (*bounds, 0.4)}, **COARSE
    )
    assert len(traj.impacts) >= 1
    np.testing.assert_allclose(traj.impacts.rate_after, -0.4 * traj.impacts.rate_before, rtol=1e-12)
    report = pinred.compare(traj)
    assert report.verdict is Verdict.PASSED, report


def test_stops_that_a_loop_makes_dependent_are_refused() -> None:
    """Two stops cannot share the reaction of one freedom."""
    model, loops = four_bar()
    system = pinred.load(model, loops=loops)
    x0 = pinred.simulate(system, duration=1e-3, xdot0={"crank": 1.0}).x[0]
    stops = {"crank": (-9.0, float(x0[0])), "rocker": (-9.0, float(x0[2]))}
    with pytest.raises(IntegrationError, match=r"no independent motions at t = 0 s.*Omit one"):
        pinred.simulate(system, x0=x0, xdot0={"crank": 0.1}, duration=0.1, stops=stops)


def test_singular_shape_of_a_loop_ends_a_motion_with_stops() -> None:
    """Stops that no joint reaches do not let a parallelogram pass its flat shape."""
    lengths = {"crank": 0.5, "coupler": 1.0, "rocker": 0.5, "frame": 1.0}
    model, loops = four_bar(lengths=lengths)
    system = pinred.load(model, loops=[replace(loops[0], coupled=False)])
    start = {"crank": 2.0, "coupler": -2.0, "rocker": 2.0}
    with pytest.raises(IntegrationError, match=r"equations of the loops .*become dependent"):
        pinred.simulate(
            system, x0=start, xdot0={"crank": 1.0}, duration=2.0, stops={"crank": (-9.0, 9.0)},
            method=pinred.DOP853(max_steps=2000),
        )  # fmt: skip


@pytest.mark.parametrize(("least", "refused"), [(5e-9, False), (5e-10, True)])
def test_dependence_of_stops_is_decided_by_the_scaled_metric(
    least: float, refused: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An eigenvalue of the metric with unit diagonal below 1e-9 counts as zero."""
    inverse = run_with_stops.RunWithStops._inverse_metric

    def nearly_dependent(self: Any, x: Any, normals: Any) -> Any:
        if len(normals) != 2:
            return inverse(self, x, normals)
        size = np.array([3.0, 0.2])
        metric = (1.0 - least) * np.outer(size, size) + np.diag(least * size**2)
        return normals.T @ metric

    monkeypatch.setattr(run_with_stops.RunWithStops, "_inverse_metric", nearly_dependent)
    system = load_five_bar()
    x0 = pinred.simulate(system, duration=1e-3, xdot0={"left_crank": 1.0}).x[0]
    stops = {"left_crank": (float(x0[0]), 9.0), "right_crank": (float(x0[2]), 9.0)}
    run: dict[str, Any] = {"x0": x0, "xdot0": {"left_crank": -0.1}, "duration": 1e-3}
    if refused:
        with pytest.raises(IntegrationError, match="no independent motions"):
            pinred.simulate(system, **run, stops=stops)
    else:
        pinred.simulate(system, **run, stops=stops)
