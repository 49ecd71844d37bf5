"""Joint stops in the engine that evaluates the equations with Pinocchio, and prescribed joints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from ball_trees import joined_bodies
from coupled_trees import make_case
from loop_robots import five_bar
from trees import random_model

import pinred
from pinred.cli.command_line import main
from pinred.common.arrays import Array
from pinred.forces import PD, Controller, Torque, Wrench
from pinred.forces.signals.signal import Expression
from pinred.judge.verdict import Verdict
from pinred.scene.scene import Engine
from pinred.simulation import run_with_stops
from pinred.simulation.impacts import ImpactTable
from pinred.simulation.pinocchio_engine import DEGREE, PinocchioFlow, integrator
from pinred.simulation.plan import plan_of
from pinred.system.force_interface import SeenState

ENGINES: tuple[Engine, ...] = ("compiled", "pinocchio")
CAT = pinred.load("falling_cat")
SWING = pinred.signals.Spline([0.0, 0.2, 0.4, 0.6, 1.5], [0.0, 0.2, -0.1, 0.3, 0.1])


def cat_between(restitution: float) -> dict[str, Any]:
    """Return the options of a cat that hits stops of all its joints."""
    stops = {name: pinred.Stop(-0.5, 0.5, restitution) for name in CAT.shape_names}
    start = {"xdot0": [3.0, -2.0, 1.0], "xi0": [0.1, 0.2, 0.3, 0.1, 0.5, -0.2]}
    return {"scene": CAT, **start, "duration": 1.5, "stops": stops}


def follower() -> dict[str, Any]:
    """Return the options of a tree in which a joint that follows another has stops."""
    system = make_case("SE3", 3, 6).system
    name, zero = system.couplings[0].follower, np.zeros(system.m)
    value = float(system.joint_values(zero)[system.tree.x_names.index(name)])
    return {
        "scene": system, "x0": zero, "xdot0": np.ones(system.m), "duration": 3.0,
        "stops": {name: (value - 0.3, value + 0.2, 0.5)},
    }  # fmt: skip


def cat_at_rest() -> dict[str, Any]:
    """Return the options of a cat whose torques press joints against their stops and back."""
    torque = Torque(
        lambda t, x, *_: ca.vertcat(0.05 * ca.sin(3 * t), 0.04 * ca.cos(2 * t), -0.02 * x[2])
    )
    return {
        **cat_between(0.0), "x0": [0.1, 0.2, -0.1], "xdot0": [1.0, -1.0, 0.5], "duration": 3.0,
        "forces": [torque],
    }  # fmt: skip


def linkage() -> dict[str, Any]:
    """Return the options of a closed loop whose cranks come to rest."""
    model, loops = five_bar()
    return {
        "scene": pinred.load(model, loops=loops), "duration": 1.05,
        "xdot0": {"left_crank": 1.0, "right_crank": -0.5},
        "stops": {"left_crank": (-1.0, -0.5), "right_crank": (-1.2, -0.6)},
        "forces": [Torque(lambda t, *_: [3.0 * (t - 0.5) ** 3, 0.0, 0.3, 0.0])],
    }  # fmt: skip


def ball() -> dict[str, Any]:
    """Return the options of two bodies that a ball joins."""
    moments = np.array([[0.4, 0.5, 0.6], [0.1, 0.2, 0.15]])
    stop = pinred.BallStop(swing=0.5, twist=(-0.4, 0.3), axis=(1.0, 2.0, 3.0), restitution=0.8)
    return {
        "scene": joined_bodies(moments, np.array([[0.0, 0.0, 0.1], [0.0, 0.1, 0.0]])),
        "xdot0": [1.0, -2.0, 0.5], "xi0": [0.1, 0.2, 0.3, 0.4, 0.5, 0.6], "duration": 1.5,
        "stops": {"joint": stop},
    }  # fmt: skip


def press(state: SeenState) -> dict[str, float]:
    """Press one joint against its stop, and move another to and fro."""
    torque = -2.0 * (state.x["bend"] - 0.8) - 0.1 * state.xdot["bend"]
    return {"bend": torque, "sway": 0.3 * float(np.sin(5.0 * state.t))}


def controlled(force: Any) -> dict[str, Any]:
    """Return the options of a cat under control."""
    return {
        "scene": CAT, "x0": [0.0, 0.1, -0.2], "xdot0": [1.0, 0.5, 0.0], "duration": 0.8,
        "forces": [force], "stops": {"bend": (-0.5, 0.5), "sway": (-0.3, 0.3, 0.5)},
    }  # fmt: skip


def led(restitution: float, signal: Any = SWING) -> dict[str, Any]:
    """Return the options of a cat one joint of which is prescribed and in motion."""
    return {
        "scene": CAT, "x0": [0.0, 0.1, -0.2], "xdot0": [0.0, 1.5, 1.0], "duration": 1.5,
        "prescribed": {"bend": signal}, "hold": "free",
        "stops": {"sway": (-0.3, 0.3, restitution), "twist": (-0.4, 0.4, restitution)},
    }  # fmt: skip


def pushed() -> dict[str, Any]:
    """Return the options of a cat that a wrench pushes, with joints that come to rest."""
    wrench = Wrench(lambda t, x, *_: [0.1 * ca.sin(3 * t), 0.2, 0.1, 0.01, 0.02 * x[0], -0.01])
    return cat_between(0.0) | {"forces": [wrench, *cat_at_rest()["forces"]]}


def pinned() -> dict[str, Any]:
    """Return the options of a tree on a ball joint, whose base gravity turns."""
    model = random_model("SO3", 3, 1)
    model.gravity.linear = np.array([1.0, -2.0, -5.0])
    system = pinred.load(model)
    return {
        "scene": system, "x0": np.zeros(system.nx), "xdot0": np.ones(system.m), "duration": 1.0,
        "stops": dict.fromkeys(system.shape_names, (-0.3, 0.4)),
    }  # fmt: skip


def simulated(options: dict[str, Any], engine: Engine, rtol: float = 1e-10) -> pinred.Trajectory:
    """Return a motion by an engine."""
    return pinred.simulate(**options, engine=engine, rtol=rtol, atol=0.01 * rtol)


CASES = {
    "plastic": (cat_between(0.0), 4, 1),
    "bouncing": (cat_between(0.6), 4, 1),
    "follower": (follower(), 3, 1),
    "rest and release": (cat_at_rest(), 8, 8),
    "loop": (linkage(), 5, 4),
    "ball": (ball(), 3, 1),
    "PD": (controlled(PD({"bend": Expression("0.9*cos(3*t)"), "sway": 0.2}, 2.0, 0.1)), 2, 2),
    "controller": (controlled(Controller(press, period=0.05, joints=("bend", "sway"))), 5, 5),
    "wrench": (pushed(), 4, 2),
    "gravity": (pinned(), 2, 2),
    "spline": (led(0.5), 5, 1),
    "spline and rest": (led(0.0), 5, 4),
}


# Cases whose modes and forces other cases have, too.
CONTAINED = {"plastic", "PD", "spline"}


# Other tests have controllers with stops, and gravity in both engines.
# Rests in loops pass the comparison in test_stops_in_loops.py.
@pytest.mark.by_hand("controller", "gravity", "loop", "wrench", "ball", "rest and release")
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.by_hand) if n in CONTAINED else n for n in CASES]
)
def test_both_engines_find_the_same_impacts_and_modes(name: str) -> None:
    """Impacts, their order, rests and releases are those of the compiled engine."""
    options, impacts, modes = CASES[name]
    compiled, readable = (simulated(options, engine) for engine in ENGINES)
    table, expected = readable.impacts, compiled.impacts
    assert readable.run.engine == "pinocchio"
    assert readable.run.method == "DOP853"
    assert len(table) >= impacts
    assert (table.joint, table.side) == (expected.joint, expected.side)
    np.testing.assert_allclose(table.t, expected.t, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(table.impulse, expected.impulse, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(table.energy_lost, expected.energy_lost, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(readable.q, compiled.q, rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(readable.v, compiled.v, rtol=0.0, atol=1e-8)
    assert len(readable.motion.modes) >= modes
    for (t, label), (t_expected, label_expected) in zip(
        readable.motion.modes, compiled.motion.modes, strict=True
    ):
        assert label == label_expected
        assert abs(t - t_expected) < 1e-9
    np.testing.assert_allclose(
        readable.stop_reactions, compiled.stop_reactions, rtol=0.0, atol=1e-8
    )


# The previous test compares this motion with the other engine.
# Both engines agree, and motions of the compiled engine pass the comparison.
@pytest.mark.by_hand
@pytest.mark.parametrize(
    "name", [pytest.param("bouncing", marks=pytest.mark.by_hand), "follower", "rest and release"]
)
def test_motions_of_the_pinocchio_engine_pass_the_comparison(name: str) -> None:
    """The full-state dynamics confirms impacts, rests and releases of this engine."""
    report = pinred.compare(simulated(CASES[name][0], "pinocchio", 1e-8))
    assert report.verdict is Verdict.PASSED, report


def test_dense_output_is_a_polynomial_of_the_stated_degree_in_each_step() -> None:
    """Contacts are searched for with Bernstein coefficients of this degree."""
    plan = plan_of(pinred.Scene(system=CAT, xdot0=[3.0, -2.0, 1.0], duration=1.0))
    flow = PinocchioFlow(plan)
    segment = integrator(flow, plan, None)(0.0, 1.0, flow.y0, flow.parameters)
    start, end = segment.knots[3:5]
    part = np.linspace(0.01, 0.99, 40)
    values = segment.at(start + part * (end - start))
    nodes = np.polynomial.chebyshev.chebpts2(20)
    series = np.polynomial.chebyshev.chebfit(
        nodes, segment.at(start + 0.5 * (nodes + 1.0) * (end - start)), 12
    )
    size = np.abs(values).max()
    assert np.abs(series[DEGREE]).max() > 1e-13 * size
    assert np.abs(series[DEGREE + 1 :]).max() < 1e-15 * size
    fitted = np.polynomial.chebyshev.chebval(2.0 * part - 1.0, series[: DEGREE + 1])
    np.testing.assert_allclose(fitted.T, values, rtol=0.0, atol=1e-14 * size)


def spatial_momentum(q: Array, v: Array) -> Array:
    """Return the momentum of the cat by Pinocchio, about the origin."""
    data = CAT.model.createData()
    h: Array = pin.computeCentroidalMomentum(CAT.model, data, q, v).vector.copy()
    h[3:] += np.cross(data.com[0], h[:3])
    return h


# Case "spline and rest" above compares this motion with the other engine.
@pytest.mark.by_hand("pinocchio-0.0")
@pytest.mark.parametrize(
    ("engine", "restitution"),
    [
        pytest.param("compiled", 0.0, marks=pytest.mark.by_hand),
        ("compiled", 0.5),
        ("pinocchio", 0.0),
    ],
)
def test_impacts_beside_a_prescribed_joint_in_motion_pass_the_comparison(
    engine: Engine, restitution: float
) -> None:
    """Tables of the prescribed motion have the segment of the time of each impact."""
    traj = simulated(led(restitution), engine, 1e-8)
    assert len(traj.impacts) == 5
    report = pinred.compare(traj)
    assert report.verdict is Verdict.PASSED, report
    table: ImpactTable = traj.impacts
    before = traj(table.t)
    momenta = [spatial_momentum(q, v) for q, v in zip(before.q, before.v, strict=True)]
    for column in (table.momentum_before, table.momentum_after):
        np.testing.assert_allclose(column, momenta, rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("signal", [SWING, "0.3*sin(5*t)"], ids=["spline", "formula"])
def test_drive_of_a_joint_in_motion_does_work_at_an_impact(signal: Any) -> None:
    """The work is the impulse of the drive, by Pinocchio's mass matrix, times the joint's rate."""
    traj = simulated(led(0.5, signal), "compiled")
    times, work = traj.motion.work_of_drives
    before, after = traj(times), traj(np.nextafter(times, np.inf))
    model = CAT.model
    k = int(model.joints[model.getJointId("bend")].idx_v)
    expected = []
    for q, v, v_after in zip(before.q, before.v, after.v, strict=True):
        H = pin.crba(model, model.createData(), q)
        H = np.triu(H) + np.triu(H, 1).T
        expected.append(float((H @ (v_after - v))[k] * v[k]))
    assert min(map(abs, expected)) > 1e-5
    np.testing.assert_allclose(work, expected, rtol=1e-9, atol=1e-14)
    balance = traj.energy_balance
    assert balance.labels == ("prescribed joints", "joint stops")
    np.testing.assert_allclose(balance.residual, 0.0, atol=1e-11)


@pytest.mark.parametrize("engine", ENGINES)
def test_rest_is_decided_with_the_state_of_the_motion_at_an_impact(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The twist that reactions depend on is the one before the impact, whatever the segment."""
    seen, sample = [], run_with_stops.RunWithStops._sample

    def kept(run: Any, state: Any, x: Array, xdot: Array) -> Any:
        result = sample(run, state, x, xdot)
        if np.array_equal(xdot, state.values[1]):
            seen.append((state.t, result.xi[0]))
        return result

    monkeypatch.setattr(run_with_stops.RunWithStops, "_sample", kept)
    traj = simulated(led(0.0), engine)
    assert len({t for t, _ in seen} & {*traj.impacts.t}) == len(traj.impacts)
    for t, xi in seen:
        expected = traj.motion.samples(np.array([t]))[0].xi[0]
        np.testing.assert_allclose(xi, expected, rtol=0.0, atol=1e-9)


def test_work_of_a_drive_at_the_start_is_no_part_of_the_balance() -> None:
    """The first state of the balance is the one after an impact at the start."""
    traj = simulated(led(0.5, "0.3*sin(5*t)") | {"x0": [0.0, 0.3, -0.2]}, "compiled")
    times, work = traj.motion.work_of_drives
    assert times[0] == 0.0
    assert abs(work[0]) > 1e-5
    np.testing.assert_allclose(traj.energy_balance.residual, 0.0, atol=1e-11)


def test_controller_sees_a_prescribed_joint_in_the_segment_of_its_table() -> None:
    """What a controller observes between stops is the state of the motion at that time."""
    seen: list[tuple[float, float]] = []

    def observe(state: SeenState) -> dict[str, float]:
        seen.append((state.t, state.x["bend"]))
        return {"sway": 0.0}

    options = led(0.5) | {"forces": [Controller(observe, period=0.3, joints=("sway",))]}
    traj = simulated(options, "compiled")
    assert len(traj.impacts) >= 4
    seen = seen[-len(traj.actions) :]
    assert len(seen) == 5
    expected = [traj(np.array([t])).x[0, CAT.shape_names.index("bend")] for t, _ in seen]
    np.testing.assert_allclose([x for _, x in seen], expected, rtol=0.0, atol=1e-12)


def test_events_end_a_motion_with_stops_in_both_engines() -> None:
    """A terminal event ends the motion after an impact, at one time in both engines."""
    event = pinred.Event("x['sway'] + 0.3", terminal=True)
    ends = [simulated(cat_between(0.6) | {"events": [event]}, engine).t[-1] for engine in ENGINES]
    assert 0.1 < ends[0] < 1.5
    np.testing.assert_allclose(ends[1], ends[0], rtol=0.0, atol=1e-9)


def test_scene_file_and_command_take_stops_with_the_pinocchio_engine(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Options that do not act with stops are refused as with the compiled engine."""
    file, out = tmp_path / "scene.toml", tmp_path / "motion.npz"
    text = (
        'robot = "falling_cat"\n[start]\nxdot0 = [3.0, -2.0, 1.0]\n[run]\nduration = 0.5\n'
        'engine = "pinocchio"\n[stops]\nbend = [-0.6, 0.6]\nsway = [-0.5, 0.5, 0.6]\n'
    )
    file.write_text(text, "utf-8")
    assert main(["run", str(file), "--validate"]) == 0
    assert main(["run", str(file), "--out", str(out)]) == 0
    assert "2 at stops of bend, sway" in capsys.readouterr().out
    stops = {"bend": (-0.6, 0.6), "sway": (-0.5, 0.5, 0.6)}
    expected = pinred.simulate(
        CAT, xdot0=[3.0, -2.0, 1.0], duration=0.5, stops=stops, engine="pinocchio"
    )
    np.testing.assert_array_equal(pinred.read_recording(out).impacts.t, expected.impacts.t)
    command = ["simulate", "falling_cat", "--xdot0", "3,-2,1", "--duration", "0.5"]
    command += ["--engine", "pinocchio", "--stops", "bend=-0.6,0.6", "--stops", "sway=-0.5,0.5,0.6"]
    assert main([*command, "--out", str(out)]) == 0
    np.testing.assert_array_equal(pinred.read_recording(out).impacts.t, expected.impacts.t)
    capsys.readouterr()
    for line, code in (("check = true", 0), ('checkpoint = "run.ckpt"', 2)):
        file.write_text(text.replace("duration = 0.5", f"duration = 0.5\n{line}"), "utf-8")
        assert main(["run", str(file)]) == code
    assert "expected none with engine 'pinocchio'" in capsys.readouterr().err


def test_pinocchio_engine_stops_at_the_largest_number_of_impacts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The limits of a run with stops hold for both engines."""
    monkeypatch.setattr(run_with_stops, "MOST_IMPACTS", 2)
    with pytest.raises(pinred.IntegrationError, match="more than 2 impacts"):
        simulated(cat_between(0.6), "pinocchio", 1e-6)
