"""The measurements: what they measure, on small cases, against what is known."""

from __future__ import annotations

import csv
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from trees import random_model

import pinred
from pinred.bench import (
    METHODS,
    End,
    Method,
    Point,
    Prepared,
    Problem,
    Scaling,
    WorkPrecision,
    bench_accuracy,
    bench_many,
    bench_scaling,
    methods,
    problems,
    timing,
)
from pinred.bench.chains import chain
from pinred.bench.full_field import full_field
from pinred.cli import main
from pinred.engine.symbolic import ReducedGraph, Structure
from pinred.errors import InputError, IntegrationError, UnsupportedOperationError
from pinred.full_state import FullState
from pinred.lie import GROUPS
from pinred.system import InitialState

QUICK = tuple(method for method in METHODS if "heyoka" not in method.name)
needs_heyoka = pytest.mark.skipif(find_spec("heyoka") is None, reason="heyoka is not installed")


@pytest.fixture(autouse=True)
def short_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounds so short that a measurement takes no time, and is worth nothing as one."""
    monkeypatch.setattr(timing, "SPAN", 1e-5)


def short_planar() -> Problem:
    """The planar problem over one second."""
    problem = problems.planar_joint()
    return replace(problem, start=replace(problem.start, duration=1.0))


def test_bench_is_light() -> None:
    """Importing the package imports none of what it measures with."""
    code = "import sys, pinred.bench.command; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"numpy", "pinocchio", "scipy", "casadi", "heyoka"} & set(done.stdout.split())


@pytest.mark.parametrize("group", sorted(GROUPS))
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_full_field_is_the_judge_s(group: str, seed: int) -> None:
    """The lean vector field for SciPy is that of the judge, which is written otherwise."""
    system = pinred.load(random_model(group, 4, seed))
    rng = np.random.default_rng(seed)
    pose = system.group.exp(rng.normal(size=system.r))
    judge = FullState(pinred.Scene(system=system, seed=0))
    y = judge.state(pose, *(rng.normal(size=k) for k in (system.m, system.r, system.m)))
    expected = judge.rate(0.0, y)
    np.testing.assert_allclose(
        full_field(system)(0.0, y), expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max()
    )


def test_reference_against_closed_form() -> None:
    """Joint and base of coupled_planar turn steadily; the centre of mass goes straight on."""
    system = pinred.load("coupled_planar")
    x, xdot, xi = np.array([0.3]), np.array([1.2]), np.array([0.4, -0.7, 0.9])
    problem = Problem("steady", "", system, InitialState(x, xdot, xi, duration=3.0))
    found = problem.reference()
    assert found.error < 1e-12
    np.testing.assert_allclose(found.end.x[0], x + 3.0 * xdot, atol=1e-12)
    q = found.end.q[0]
    assert abs(np.arctan2(q[3], q[2]) - 3.0 * 0.9) < 1e-12
    data = system.model.createData()
    start = system.q(system.group.identity(), x)
    pin.centerOfMass(system.model, data, start, system.v(xi, xdot))
    straight = data.com[0] + 3.0 * data.vcom[0]
    np.testing.assert_allclose(pin.centerOfMass(system.model, data, q), straight, atol=1e-12)


def test_errors_fall_with_the_tolerance() -> None:
    """Each method comes nearer to the reference, at a price, until the reference itself ends."""
    (found,) = bench_accuracy(
        [short_planar()], methods=QUICK, tolerances=(1e-3, 1e-6, 1e-10), rounds=1
    )
    assert found.reference_error < 1e-12
    assert list(found.about) == [method.name for method in QUICK]
    for name in found.about:
        loose, middle, tight = found.of(name)
        assert loose.error > 10.0 * middle.error > 100.0 * tight.error
        assert 0.0 < tight.error < 1e-8
        assert tight.evaluations > loose.evaluations
        assert tight.wall > 0.0
    whole, inside = found.of("pinred"), found.of("pinred, inside")
    assert [p.error for p in whole] == [p.error for p in inside]
    assert f"{found.of('SciPy')[0].shape:8.1e}" in str(found)


def made(*points: Point, reference_error: float = 1e-14) -> WorkPrecision:
    """A result of two methods a and b with these points."""
    return WorkPrecision(
        problem="p",
        joints=1,
        duration=1.0,
        reference_error=reference_error,
        about={"a": "", "b": ""},
        points=points,
    )


def point(method: str, error: float, wall: float) -> Point:
    """A point whose largest error is that of the shape."""
    return Point(method, 1.0, wall=wall, shape=error, rotation=0.1 * error, position=0.0)


def test_wall_at_equal_error() -> None:
    """Between two points the interpolation is log-log; a beaten point does not count."""
    found = made(
        point("a", 1e-2, 1.0),
        point("a", 1e-3, 9.0),  # slower and less accurate than the next
        point("a", 1e-4, 4.0),
        Point("a", 1e-9, failure="stopped"),
        point("b", 1e-6, 8.0),
        point("b", 1e-2, 2.0),
    )
    assert found.wall_at("a", 1e-3) == pytest.approx(2.0)
    assert found.wall_at("a", 1e-4) == pytest.approx(4.0)
    assert found.wall_at("a", 1.0) == pytest.approx(1.0)
    assert np.isnan(found.wall_at("a", 9e-5))
    assert found.wall_at("b", 1e-4) == pytest.approx(4.0)
    assert found.ratio_at("b", 1e-3, "a") == pytest.approx(2.0 * 2.0**0.5 / 2.0)
    with pytest.raises(InputError, match="no method 'c'; they are a, b"):
        found.of("c")


def test_what_the_reference_cannot_tell_is_not_claimed() -> None:
    """An error below that of the reference counts as the reference's."""
    found = made(point("a", 1e-13, 1.0), point("a", 1e-4, 0.1), reference_error=1e-9)
    assert found.wall_at("a", 1e-9) == pytest.approx(1.0)
    assert np.isnan(found.wall_at("a", 1e-10))


def test_failures_are_kept() -> None:
    """A method that stops, or ends nowhere, has a point that says so and no time."""

    def stops(_: Problem, tolerance: float) -> Prepared:
        def run() -> Any:
            if tolerance < 1e-3:
                raise IntegrationError("stopped at t = 0.5 s")

        return Prepared(run, lambda _: End(np.array([np.nan]), np.zeros(6), 1))

    broken = Method("broken", "fails", (1e-2, 1e-4), stops)
    (found,) = bench_accuracy([short_planar()], methods=[broken, QUICK[0]], rounds=1)
    failures = [p for p in found.points if p.method == "broken"]
    assert [p.failure for p in failures] == ["the end is not finite", "stopped at t = 0.5 s"]
    assert all(np.isnan(p.wall) and np.isnan(p.error) for p in failures)
    assert found.of("broken") == []
    assert np.isnan(found.wall_at("broken", 1e-4))
    assert "failed: stopped at t = 0.5 s" in str(found)
    assert len(found.of("pinred")) == len(QUICK[0].tolerances)


def test_without_heyoka(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is not installed is left out, with a line that says how to install it."""
    monkeypatch.setattr(methods, "has_heyoka", lambda: False)
    (found,) = bench_accuracy([short_planar()], tolerances=(1e-4,), rounds=1)
    assert list(found.about) == ["pinred", "pinred, inside", "SciPy"]
    assert 'heyoka is left out: pip install "pinred[bench]"' in str(found).splitlines()[4]


def test_without_example_robots(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without example-robot-data the quadruped is left out, with a line that says so."""
    monkeypatch.setattr(problems, "has_example_robots", lambda: False)
    there, missing = problems.default_problems()
    assert [problem.name for problem in there] == ["planar"]
    assert missing == ['solo12 is left out: pip install "pinred[robots]"']


@needs_heyoka
@pytest.mark.parametrize("robot", ["planar_chain5", "coupled_spatial", "cartpole"])
def test_taylor_expressions_are_the_graph(robot: str) -> None:
    """Heyoka evaluates what CasADi does, for a plane, free space and gravity."""
    import heyoka as hy

    from pinred.bench.taylor import taylor_expressions

    system = pinred.load(robot)
    gravity = (0.0, 0.0, -9.81) if robot == "cartpole" else None
    rate = ReducedGraph(system, Structure(zero_momentum=False, gravity=gravity)).rate()
    rng = np.random.default_rng(0)
    y, parameters = (rng.normal(size=rate.numel_in(k)) for k in range(2))
    pairs = taylor_expressions(rate, parameters.tolist())
    evaluate = hy.cfunc([f for _, f in pairs], [v for v, _ in pairs])
    expected = np.array(rate(y, parameters)).ravel()
    np.testing.assert_allclose(evaluate(y), expected, rtol=1e-12, atol=1e-12)


@needs_heyoka
def test_taylor_folds_constants_and_refuses() -> None:
    """What hangs on parameters only is a number; an unknown operation is named as such."""
    import heyoka as hy

    from pinred.bench.taylor import taylor_expressions

    y, p = ca.SX.sym("y", 2), ca.SX.sym("p", 1)
    rate = ca.Function("f", [y, p], [ca.vertcat(ca.sin(p) / 2.0 + 1.0, y[0] * (p * p))])
    (_, first), (_, second) = taylor_expressions(rate, [0.5])
    assert str(first) == str(hy.expression(np.sin(0.5) / 2.0 + 1.0))
    assert str(second) == str(0.25 * hy.expression("y0"))
    with pytest.raises(UnsupportedOperationError, match="instruction 1 of 'g'"):
        taylor_expressions(ca.Function("g", [y, p], [ca.fabs(y)]), [0.5])


@needs_heyoka
def test_heyoka_against_the_full_simulation() -> None:
    """Both of heyoka's modes come to the reference's end."""
    taylor = [method for method in METHODS if "heyoka" in method.name]
    (found,) = bench_accuracy([short_planar()], methods=taylor, tolerances=(1e-12,), rounds=1)
    assert [p.method for p in found.points] == ["heyoka", "heyoka, unrolled"]
    assert all(0.0 < p.error < 1e-11 and p.build > 0.0 for p in found.points)


def test_chains_are_what_they_say() -> None:
    """Stretched out, a chain is one rod, whose inertia is known; spatial joints take turns."""
    system = chain("planar", 9)
    assert (system.group.name, system.m) == ("SE2", 9)
    assert system.mass == pytest.approx(10.0)
    assert (np.array(system.model.gravity.linear) == 0.0).all()
    data = system.model.createData()
    q = system.q(system.group.identity(), np.zeros(9))
    pin.ccrba(system.model, data, q, np.zeros(system.n))
    assert data.Ig.inertia[2, 2] == pytest.approx(10.0 * (2.0**2 + 0.05**2) / 12.0)
    system = chain("spatial", 4)
    assert system.group.name == "SE3"
    names = [system.model.joints[i].shortname()[-2:] for i in range(2, 6)]
    assert names == ["RY", "RZ", "RY", "RZ"]
    with pytest.raises(InputError, match="planar or spatial"):
        chain("helical", 3)


def test_scaling() -> None:
    """The slope is that of a power law; short chains are measured, in order only."""
    n = np.array([5, 20, 50, 100])
    law = Scaling("made", n, 3 * n, build=0.1 * n, kernel=np.where(n < 20, 9.0, n**1.5))
    assert law.slope == pytest.approx(1.5)
    assert law.instructions_slope == pytest.approx(1.0)
    assert "to the power 1.50, instructions 1.00" in str(law)
    found = bench_scaling((2, 4), rounds=1)
    assert [each.family for each in found] == ["planar", "spatial"]
    for each in found:
        assert each.instructions[0] < each.instructions[1] <= 3 * each.instructions[0]
        assert (each.kernel > 0.0).all()
        assert (each.build > 0.0).all()
        assert np.isnan(each.slope)
    with pytest.raises(InputError, match="increasing"):
        bench_scaling((4, 2))


def test_many() -> None:
    """Times of both, and memory that is at least what the results take."""
    system = pinred.load("falling_cat")
    found = bench_many(system, members=8, duration=0.05, rounds=1)
    assert (found.wall > 0.0).all()
    assert found.speedup == pytest.approx(found.wall[0] / found.wall[1])
    many = pinred.simulate_many(system, seeds=range(8), times=[0.05])
    assert found.sizes.tolist() == [2.0, 8.0]
    assert found.results.tolist() == [many.y.nbytes / 4.0, many.y.nbytes]
    assert (found.kept >= found.results).all()
    assert (found.extra >= 0.0).all()
    with pytest.raises(InputError, match="at least 4"):
        bench_many(system, members=3)


def test_commands_write_csv(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`--out` makes the folder and writes whole tables whose numbers read back."""
    quick = tuple(replace(method, tolerances=(1e-3, 1e-6)) for method in QUICK)
    monkeypatch.setattr(methods, "METHODS", quick)
    folder = tmp_path / "new" / "numbers"
    assert main(["bench", "accuracy", "planar", "--out", str(folder)]) == 0
    assert main(["bench", "kernels", "coupled_planar", "--out", str(folder)]) == 0
    assert main(["bench", "many", "falling_cat", "--members", "4", "--out", str(folder)]) == 0
    out = capsys.readouterr().out
    names = ["accuracy", "equal_error", "kernels", "many", "many_memory"]
    assert sorted(path.name for path in folder.iterdir()) == [f"{name}.csv" for name in names]
    assert all(f"written to {folder / name}.csv" in out for name in names)
    with (folder / "accuracy.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * len(QUICK)
    assert {row["method"] for row in rows} == {method.name for method in QUICK}
    for row in rows:
        errors = [float(row[name]) for name in ("shape", "rotation", "position")]
        assert float(row["error"]) == max(errors)
        assert row["failure"] == ""
    with (folder / "many.csv").open(encoding="utf-8") as file:
        assert [row["threads"] for row in csv.DictReader(file)] == ["1", "2"]


def test_commands_refuse(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Bad input is named before anything is measured."""
    (tmp_path / "file").write_text("")
    assert main(["bench", "kernels", "--out", str(tmp_path / "file")]) == 2
    assert "cannot make the folder" in capsys.readouterr().err
    assert main(["bench", "accuracy", "moon"]) == 2
    assert "no problem 'moon'; they are planar, solo12" in capsys.readouterr().err
    with pytest.raises(SystemExit) as stop:
        main(["bench"])
    assert stop.value.code == 2
    assert capsys.readouterr().err.startswith("pinred: error: ")
