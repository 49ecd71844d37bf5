"""Accuracy benchmark: references, errors, drift, records, and resumption."""

from __future__ import annotations

import csv
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import aba
import numpy as np
import pinocchio as pin
import pytest
from trees import random_model, shuffled

import pinred
from pinred.cli.command_line import main
from pinred.common.arrays import Array
from pinred.common.errors import InputError, IntegrationError, LoadError, install_command
from pinred.integrators.methods import RKMK4
from pinred.judge.reference_solution import FullMotion
from pinred.laboratory.bench import (
    QUICK,
    SCENES,
    SOLVERS,
    Effort,
    End,
    Point,
    PreparedRun,
    Problem,
    Solver,
    WorkPrecision,
    accuracy,
    bench_accuracy,
    own_method,
    problems,
    problems_named,
    read_record,
    reference_of,
    timing,
    write_record,
)
from pinred.laboratory.bench.accuracy import _quadruple, overview, solvers_named
from pinred.laboratory.bench.problems import compute_drift
from pinred.system.coordinates import InitialState

pytestmark = pytest.mark.slow

needs_heyoka = pytest.mark.skipif(find_spec("heyoka") is None, reason="heyoka is not installed")
OWN = solvers_named(["pinred", "pinred-integration", "aba-dop853"])
BRIEF = Effort("brief", rounds=1, patience=10.0, budget=1.0)


@pytest.fixture(autouse=True)
def short_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make rounds so short that measurements take almost no time."""
    monkeypatch.setattr(timing, "SPAN", 1e-5)


def short_planar() -> Problem:
    """Return the planar problem over one second."""
    problem = problems.planar_joint()
    return replace(problem, start=replace(problem.start, duration=1.0))


def steady() -> Problem:
    """Return two bodies whose joint and base rotate at constant rates."""
    system = pinred.load("coupled_planar")
    x, xdot, xi = np.array([0.3]), np.array([1.2]), np.array([0.4, -0.7, 0.9])
    return Problem("steady", "", system, InitialState(x, xdot, xi, duration=3.0))


@pytest.mark.parametrize("quadruple", [True, False])
def test_reference_equals_closed_form(quadruple: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Joint and base of coupled_planar rotate steadily; the centre of mass moves straight."""
    if quadruple and find_spec("heyoka") is None:
        pytest.skip("heyoka is not installed")
    monkeypatch.setattr("pinred.laboratory.bench.accuracy.has_heyoka", lambda: quadruple)
    problem = steady()
    result = reference_of(problem)
    assert result.error < (1e-14 if quadruple else 1e-12)
    assert result.independent < 1e-12
    assert ("quadruple" in result.about) == quadruple
    x, xdot = problem.start.x, problem.start.xdot
    np.testing.assert_allclose(result.end.x[0], x + 3.0 * xdot, atol=1e-12)
    q = result.end.q[0]
    assert abs(np.arctan2(q[3], q[2]) - 3.0 * 0.9) < 1e-12
    system = problem.system
    data = system.model.createData()
    pin.centerOfMass(system.model, data, problem.q0, problem.v0)
    straight = data.com[0] + 3.0 * data.vcom[0]
    np.testing.assert_allclose(pin.centerOfMass(system.model, data, q), straight, atol=1e-12)


@needs_heyoka
def test_reference_error_is_distance_from_aba_if_unconfirmed() -> None:
    """A larger distance from ABA counts as the error of the reference."""
    problem = short_planar()
    aba = reference_of(problem).end
    wrong = FullMotion(aba.x + 1e-3, aba.q)
    result = _quadruple(problem, wrong)
    assert result.error == result.independent == pytest.approx(1e-3, rel=1e-6)


def test_drift_equals_closed_form() -> None:
    """A changed velocity changes energy and momenta about the centre of mass."""
    problem = steady()
    model, data = problem.system.model, problem.system.model.createData()
    q0, v0 = problem.q0, problem.v0
    assert compute_drift(problem, q0, v0) == (0.0, 0.0)
    v = v0 * 1.01
    pin.ccrba(model, data, q0, v0)
    mass, carried = data.Ig.mass, 0.5 * data.hg.linear @ data.hg.linear / data.Ig.mass
    total = pin.computeKineticEnergy(model, data, q0, v0)
    internal = total - carried
    energy, momentum = compute_drift(problem, q0, v)
    assert energy == pytest.approx(total * (1.01**2 - 1.0) / internal, rel=1e-12)
    radius = np.sqrt(np.trace(data.Ig.inertia) / mass)
    unit = np.sqrt(2.0 * mass * internal)
    parts = [*np.abs(data.hg.linear[:2]) / unit, abs(data.hg.angular[2]) / (unit * radius)]
    assert momentum == pytest.approx(0.01 * max(parts), rel=1e-9)


def test_drift_excludes_fall() -> None:
    """Momentum from gravity and potential energy are not counted as drift."""
    system = pinred.load("falling_cat", gravity=(0.0, 0.0, -9.81))
    assert system.initial is not None
    start = replace(system.initial, duration=0.5)
    problem = Problem("fall", "", system, start)
    (result,) = bench_accuracy([problem], methods=OWN, tolerances=(1e-10,), effort=BRIEF)
    for point in result.points:
        assert point.energy < 1e-7
        assert point.momentum < 1e-8


def test_problem_of_unsorted_robot_is_solved_in_sorted_order() -> None:
    """A method that takes x from v by position agrees with ABA of the original model."""
    model = shuffled(random_model("SE3", 5, 5), 5)
    system = pinred.load(model)
    assert system.model is not system.sorted_model
    start, duration = pinred.Scene(system=system, seed=0, duration=0.2).start, 0.2
    initial = InitialState(start.x, start.xdot, start.xi, duration)
    problem = Problem("unsorted", "a random tree", system, initial)
    prepared = solvers_named(["aba-odeint"])[0].prepare(problem, 1e-10)
    end = prepared.end(prepared.run())
    q0 = system.q(system.group.identity(), start.x)
    q, _ = aba.integrate(model, q0, system.v(start.xi, start.xdot), np.array([0.0, duration]))
    expected = system.configuration(q[1]).x
    np.testing.assert_allclose(np.exp(1j * end.x), np.exp(1j * expected), rtol=0.0, atol=1e-7)


def test_errors_decrease_with_tolerance() -> None:
    """Errors decrease to that of the reference, at increasing cost."""
    (result,) = bench_accuracy(
        [short_planar()], methods=OWN, tolerances=(1e-3, 1e-10, 1e-6), effort=BRIEF
    )
    assert result.reference_error < 1e-12
    assert list(result.about) == [method.name for method in OWN]
    for name in result.about:
        loose, middle, tight = result.of(name)
        assert loose.error > 10.0 * middle.error > 100.0 * tight.error
        assert loose.energy > tight.energy
        assert 0.0 < tight.error < 1e-8
        assert tight.evaluations > loose.evaluations
        assert tight.wall > 0.0
    total, inside = result.of("pinred"), result.of("pinred-integration")
    assert [p.error for p in total] == [p.error for p in inside]
    assert f"{result.of('aba-dop853')[0].shape:.3g}" in str(result)


def test_own_method_with_fixed_steps_has_its_order() -> None:
    """A method is added by one call with pinred's integrator."""
    method = own_method("mine", "", RKMK4, tolerances=(1 / 20, 1 / 40), fixed=True)
    (result,) = bench_accuracy([short_planar()], methods=[method], tolerances=(1e-9,), effort=BRIEF)
    coarse, fine = result.of("mine")
    assert np.log2(coarse.error / fine.error) == pytest.approx(4.0, abs=0.5)


def result_of(*points: Point, reference_error: float = 1e-14, run: str = "now") -> WorkPrecision:
    """Build a result of two methods a and b from points."""
    return WorkPrecision(
        problem="s",
        description="a scene, with a comma",
        joints=1,
        duration=1.0,
        reference_error=reference_error,
        reference="result_of up",
        about={"a": "", "b": ""},
        points=points,
        missing={"c": "c is left out", "d": "c is left out"},
        run=run,
    )


def point(method: str, error: float, wall: float) -> Point:
    """Build a point whose largest error is that of the shape."""
    return Point(method, 1.0, wall=wall, shape=error, rotation=0.1 * error, position=0.0)


def test_wall_at_interpolates_pareto_front() -> None:
    """The interpolation is log-log between points that no other beats."""
    result = result_of(
        point("a", 1e-2, 1.0),
        point("a", 1e-3, 9.0),  # slower and less accurate than the next point
        point("a", 1e-4, 4.0),
        Point("a", 1e-9, failure="stopped"),
        point("b", 1e-6, 8.0),
        point("b", 1e-2, 2.0),
    )
    assert result.wall_at("a", 1e-3) == pytest.approx(2.0)
    assert result.wall_at("a", 1e-4) == pytest.approx(4.0)
    assert result.wall_at("a", 1.0) == pytest.approx(1.0)
    assert np.isnan(result.wall_at("a", 9e-5))
    assert result.wall_at("b", 1e-4) == pytest.approx(4.0)
    assert result.ratio_at("b", 1e-3, "a") == pytest.approx(2.0 * 2.0**0.5 / 2.0)
    assert str(result).count("c is left out") == 1
    with pytest.raises(InputError, match="no method 'c'; the methods are a, b"):
        result.of("c")


def test_fastest_of_tools_has_one_method_per_tool() -> None:
    """The default of pinred, and the fastest method of each other tool at the error."""
    names = ("pinred", "pinred-x", "t-slow", "t-fast", "t-never", "u-never")
    walls = dict(zip(names, (1.0, 0.5, 5.0, 3.0, 0.1, 0.2), strict=True))
    points = [
        point(name, 1e-2 if name.endswith("never") else 1e-9, wall) for name, wall in walls.items()
    ]
    result = replace(result_of(*points), about=dict.fromkeys(names, ""))
    few = result.fastest_of_tools(1e-8)
    assert few == ["pinred", "t-fast", "u-never"]
    assert list(result.only(few).about) == few
    without = result.only([name for name in names if name != "pinred"])
    assert without.fastest_of_tools(1e-8)[0] == "pinred-x"
    assert [p.method for p in result.only(["t-fast", "pinred"]).points] == ["t-fast", "pinred"]


def test_wall_at_limits_errors_to_reference_error() -> None:
    """An error below that of the reference counts as the reference's error."""
    result = result_of(point("a", 1e-13, 1.0), point("a", 1e-4, 0.1), reference_error=1e-9)
    assert result.wall_at("a", 1e-9) == pytest.approx(1.0)
    assert np.isnan(result.wall_at("a", 1e-10))


def test_failed_methods_have_points_with_reason() -> None:
    """A method that stops, or ends with NaN, has a point without time."""

    def stops(_: Problem, tolerance: float) -> PreparedRun:
        def run() -> Any:
            if tolerance < 1e-3:
                raise IntegrationError("stopped at t = 0.5 s")

        return PreparedRun(run, lambda _: End(np.array([np.nan]), np.zeros(6), np.zeros(4), 1))

    broken = Solver("broken", "fails", (1e-2, 1e-4), stops)
    (result,) = bench_accuracy([short_planar()], methods=[broken, OWN[0]], effort=BRIEF)
    failures = [p for p in result.points if p.method == "broken"]
    messages = [p.failure for p in failures]
    assert messages == ["the final state is not finite", "stopped at t = 0.5 s"]
    assert all(np.isnan(p.wall) and np.isnan(p.error) for p in failures)
    assert result.of("broken") == []
    assert np.isnan(result.wall_at("broken", 1e-4))
    assert "stopped at t = 0.5 s" in str(result)
    assert len(result.of("pinred")) == len(OWN[0].tolerances)


def test_tolerances_after_slow_run_are_skipped() -> None:
    """Finer tolerances than a slow one have a point with the reason."""
    method = solvers_named(["pinred-rkmk4"])[0]
    impatient = Effort("impatient", rounds=1, patience=1e-6, budget=1.0, every=4)
    (result,) = bench_accuracy([short_planar()], methods=[method], effort=impatient)
    assert len(result.points) == len(method.tolerances[::4])
    assert len(result.of("pinred-rkmk4")) == 1
    assert all("not run: a coarser tolerance took" in p.failure for p in result.points[1:])


def test_record_round_trip(tmp_path: Path) -> None:
    """NaN and failures are preserved."""
    path = tmp_path / "accuracy.csv"
    with pytest.raises(LoadError, match="no such file"):
        read_record(path)
    result = result_of(point("a", 1.0 / 3.0, 0.1), Point("b", 1e-9, failure='stopped, "here"'))
    other = result_of(point("a", 1e-3, 0.2), Point("b", 1e-9, failure="again"), run="later")
    write_record(path, "quick", [result, other])
    assert list(tmp_path.iterdir()) == [path]
    again = read_record(path, "quick")
    assert repr(again) == repr([result, other])  # NaN is not equal to itself
    with path.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["run"] for row in rows] == ["now"] * 4 + ["later"] * 4
    assert float(rows[0]["error"]) == 1.0 / 3.0
    with pytest.raises(InputError, match="was measured as 'quick', not 'full'"):
        read_record(path, "full")
    path.write_text("a,b\n1,2\n")
    with pytest.raises(LoadError, match="it has no column 'problem'"):
        read_record(path, "quick")


@pytest.mark.by_hand
def test_interrupted_bench_resumes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Finished scenes are kept; ratios use times of one run."""
    folder, real, asked = tmp_path / "out", vars(accuracy)["bench_problem"], []

    def dies_at_the_second(problem: Problem, methods: Any, *rest: Any, **more: Any) -> Any:
        asked.append((problem.name, [method.name for method in methods]))
        if len(asked) == 2:
            raise KeyboardInterrupt
        return real(problem, methods, *rest, **more)

    monkeypatch.setattr(accuracy, "bench_problem", dies_at_the_second)
    command = ["bench", "accuracy", "--scenes", "coupled_planar,rigid_body", "--quick"]
    command += ["--methods", "pinred,aba-odeint", "--tolerances", "1e-4,1e-8"]
    command += ["--out", str(folder)]
    assert main(command) == 130
    asked_for = "quick, tolerances 0.0001 1e-08"
    first = read_record(folder / "accuracy.csv", asked_for)
    assert [result.problem for result in first] == ["coupled_planar"]
    assert main(command) == 0
    assert [name for name, _ in asked[2:]] == ["rigid_body"]
    assert f"coupled_planar is measured already, in run {first[0].run}" in capsys.readouterr().out
    command[command.index("pinred,aba-odeint")] = "aba-odeint,aba-lsoda"
    monkeypatch.setattr(accuracy, "run_name", lambda: "later")
    assert main(command) == 0
    assert [names for _, names in asked[3:]] == [["pinred", "aba-lsoda"]] * 2
    result = read_record(folder / "accuracy.csv", asked_for)
    assert repr(result[:1]) == repr(first)
    assert [(f.problem, list(f.about)) for f in result] == [
        ("coupled_planar", ["pinred", "aba-odeint"]),
        ("rigid_body", ["pinred", "aba-odeint"]),
        ("coupled_planar", ["pinred", "aba-lsoda"]),
        ("rigid_body", ["pinred", "aba-lsoda"]),
    ]
    if find_spec("matplotlib") is not None:
        scenes = ("coupled_planar", "coupled_planar_2", "rigid_body", "rigid_body_2")
        figures = {f"{name}{end}.png" for name in scenes for end in ("", "_all")}
        assert {path.name for path in folder.glob("*.png")} == figures
    assert (folder / "overview.txt").read_text(encoding="utf-8") == overview(result) + "\n"
    with (folder / "equal_error.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        (expected,) = (f for f in result if (f.problem, f.run) == (row["problem"], row["run"]))
        ratio = expected.ratio_at(row["method"], float(row["error"]))
        assert float(row["times_pinred"]) == ratio or np.isnan(ratio)
    assert main([*command[:-4], "--out", str(folder)]) == 2
    assert "choose another folder, or the same options" in capsys.readouterr().err


def test_bench_accuracy_rejects_unknown_names(capsys: pytest.CaptureFixture[str]) -> None:
    """The message lists the valid names."""
    for option, message in (
        (["--scenes", "moon"], "no scene 'moon'; the scenes are planar1, elroys_beanie,"),
        (["--methods", "magic"], "no method 'magic'; the methods are pinred, pinred-integration,"),
        (["--tolerances", "x"], "a tolerance must be a number, got 'x'"),
        (["--tolerances", "2"], "tolerances must be below 1, got 2"),
    ):
        assert main(["bench", "accuracy", *option]) == 2
        assert message in capsys.readouterr().err
    assert main(["bench", "accuracy", "--list"]) == 0
    printed = capsys.readouterr().out
    assert all(name in printed for name in (*SCENES, *(method.name for method in SOLVERS)))


def test_missing_package_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """The message says how to install it."""
    monkeypatch.setattr("pinred.laboratory.bench.peers.heyoka.has_heyoka", lambda: False)
    monkeypatch.setattr("pinred.laboratory.bench.accuracy.has_heyoka", lambda: False)
    methods = solvers_named(["pinred", "heyoka", "heyoka-unrolled"])
    (result,) = bench_accuracy([short_planar()], methods=methods, effort=QUICK)
    assert list(result.about) == ["pinred"]
    assert 'heyoka is left out: pip install "pinred[bench]"' in str(result).splitlines()[2]


def test_missing_example_robots_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two scenes are left out with a message."""
    monkeypatch.setattr(problems, "has_example_robots", lambda: False)
    second, missing = problems_named()
    assert [problem.name for problem in second] == ["planar1", "planar5", "satellite"]
    assert missing == [
        f"{name} is left out: {install_command('robots')}" for name in ("solo12", "talos")
    ]


@pytest.mark.by_hand("talos", "planar-50", "spatial-50")
@pytest.mark.parametrize("name", sorted(SCENES))
def test_scenes_have_names_and_states(name: str) -> None:
    """Each scene has its key as name and a state of the right size."""
    if name in ("solo12", "talos") and find_spec("example_robot_data") is None:
        pytest.skip("example-robot-data is not installed")
    problem = SCENES[name]()
    assert problem.name == name
    assert problem.start.duration in (2.0, 4.0, 10.0)
    assert problem.full_start().size == problem.system.group.size + 2 * problem.system.m + (
        problem.system.r
    )
    if name[-1].isdigit() and "-" in name:
        assert problem.system.m == int(name.split("-")[1])


@pytest.mark.by_hand
def test_satellite_is_chaotic() -> None:
    """By ABA, neighbours separate e-fold every 2 to 3 s, unlike in a regular motion."""
    (satellite,), _ = problems_named(["satellite"])
    (planar,), _ = problems_named(["planar1"])
    times = np.array([10.0, 20.0, 30.0, 40.0])

    def grown(problem: Problem) -> Array:
        full, y0 = problem.full, problem.full_start()
        second = full.run(y0, times, 1e-13, 1e-15)
        beside = full.run(full.perturb(y0, 40.0, 1e-11), times, 1e-13, 1e-15)
        return np.asarray(np.abs(beside.x - second.x).max(axis=1) / 1e-11)

    wild = grown(satellite)
    rates = np.diff(np.log(wild)) / 10.0
    assert (rates > 0.25).all(), wild
    assert wild[-1] > 1e6, wild
    assert grown(planar).max() < 1e3
