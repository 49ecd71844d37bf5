"""Benchmarks on small cases, compared with known values."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import flow_cost
import numpy as np
import pinocchio as pin
import pytest
from commands import python

import pinred
from pinred.cli.command_line import main
from pinred.common.errors import InputError, LoadError
from pinred.laboratory.bench import (
    Table,
    bench_kernels,
    bench_many,
    bench_threads,
    timing,
)
from pinred.laboratory.bench.problems import chain
from pinred.laboratory.bench.timing import BATCH_SOLVERS

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def short_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make rounds so short that measurements take almost no time."""
    monkeypatch.setattr(timing, "SPAN", 1e-5)


def test_call_timing_counts_integrations(monkeypatch: pytest.MonkeyPatch) -> None:
    """A comparison takes longer than the integration by ABA that it contains."""
    monkeypatch.setattr(timing, "_ROUNDS_OF_COMPARE", 1)
    table = timing.bench_compare(["falling_cat, 2 s"])
    (result,) = table
    assert result.verdict == "PASSED"
    assert result.integrations > 1.0
    assert f"{result.seconds:.3g}" in str(table)
    with pytest.raises(InputError, match=r"no scene 'moon'; the scenes are falling_cat"):
        timing.bench_compare(["moon"])
    with pytest.raises(InputError, match="did you mean 'talos, 2 s'"):
        timing.bench_compare(["talo, 2 s"])


def test_first_calls_are_medians_of_three_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    """The table has the median of the times; unknown calls are refused."""
    monkeypatch.setattr(timing, "CALLS", {"note": "pass"})
    times = {"pass": [0.5, 4.0, 0.25]}
    monkeypatch.setattr(timing, "time_in_fresh_process", lambda call: times[call].pop())
    row = str(timing.bench_first_calls()).splitlines()[-1]
    assert times == {"pass": []}
    assert row.split() == ["note", "0.5"]
    with pytest.raises(InputError, match="no call 'moon'; the calls are note"):
        timing.bench_first_calls(["moon"])


def test_first_call_is_timed_in_another_process() -> None:
    """The process has a cache of its own, and its time includes the whole call and no import."""
    slow = "time.sleep(0.3); assert pinred.load('falling_cat') is not system"
    assert 0.3 < timing.time_in_fresh_process(slow) < 1e3


@pytest.mark.by_hand("flow.vjp", "simulate, Radau")
@pytest.mark.parametrize("name", timing.CALLS)
def test_first_calls_are_valid_programs(name: str) -> None:
    """The source text of each call runs with the names that the program defines."""
    names = {"pinred": pinred, "numpy": np, "system": pinred.load("falling_cat")}
    exec(timing.CALLS[name], names)


def test_importing_bench_is_lazy() -> None:
    """Importing the package imports none of the measured modules."""
    code = "import sys, pinred.cli.laboratory_commands; print(*sys.modules)"
    assert not {"numpy", "pinocchio", "scipy", "casadi", "heyoka"} & set(python(code).split())


def test_chain_inertia_in_closed_form() -> None:
    """A straight chain is one rod with known inertia; axes of spatial joints alternate."""
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


@pytest.mark.by_hand
def test_flow_cost_measures_the_default_robots(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bodies of joints that move several links have names that flows accept."""
    monkeypatch.setattr(flow_cost, "_ROUNDS", 1)
    monkeypatch.setattr(flow_cost, "_BURST", 1e-6)
    for result in flow_cost.measure_flows():
        assert min(result.integration, result.gradient, result.inertias, result.gauss) > 0.0


def test_flow_cost_measures_every_ratio(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each ratio is positive, and appears in the table."""
    monkeypatch.setattr(flow_cost, "_ROUNDS", 2)
    monkeypatch.setattr(flow_cost, "_BURST", 1e-5)
    table = flow_cost.measure_flows(["coupled_planar"])
    (result,) = table
    ratios = [result.jvp, result.gradient, result.inertias, result.gauss, result.adjoint]
    assert min(*ratios, result.call, result.simulate, result.step) > 0.0
    names, units, row = str(table).splitlines()
    assert all(f"{ratio:.3g}" in row for ratio in ratios)
    assert len(names.split()) == 13
    assert units.split().count("[runs]") == 4
    assert len(names) == len(units) == len(row)


def test_table_aligns_columns() -> None:
    """Units are a second line, NaN is a dash, and numbers have three digits or are whole."""
    rows = (
        SimpleNamespace(robot="arm", build_time=0.12345, steps=2.25, count=123456),
        SimpleNamespace(robot="leg", build_time=np.nan, steps=12345.6, count=1),
    )
    table = Table("made", rows, {"build_time": "s"}, "two robots", ("below",))
    assert str(table).splitlines() == [
        "two robots",
        "robot  build_time  steps   count",
        "              [s]",
        "arm         0.123   2.25  123456",
        "leg             —  12346       1",
        "below",
    ]
    assert (len(table), table[1], [*table]) == (2, rows[1], [*rows])
    shared = Table("made", rows[:1], shared={"axis": 1})
    assert shared.records == [
        {"axis": 1, "robot": "arm", "build_time": 0.12345, "steps": 2.25, "count": 123456}
    ]
    assert str(Table("none", (), notes=("nothing to measure",))) == "nothing to measure"


def test_bench_kernels_measures_chains() -> None:
    """Instructions grow in proportion to the joints; a chain may have any number of them."""
    short, long, robot = bench_kernels(["planar-2", "planar-4", "coupled_planar"])
    assert [row.joints for row in (short, long, robot)] == [2, 4, 1]
    assert short.instructions < long.instructions <= 3 * short.instructions
    assert all(row.kernel > 0.0 and row.build > 0.0 for row in (short, long))
    assert robot.ratio == robot.pin_aba / robot.kernel
    with pytest.raises(LoadError, match="helical-3"):
        bench_kernels(["helical-3"])


@pytest.mark.usefixtures("code_of_default_level")
def test_bench_many_reaches_error_or_reports_failure() -> None:
    """Each solver reaches the requested error against ABA, or says that it does not."""
    (result,) = bench_many(["planar1"], members=4, rounds=1, error=1e-6)
    rates = {rate.solver: rate for rate in result}
    assert {"lanes", "one by one"} <= rates.keys()
    assert all(0.0 < rate.error <= 1e-6 for rate in result)
    assert all(rate.per_second > 0.0 for rate in result)
    expected, other = rates["lanes"], rates["one by one"]
    assert expected.tolerance == other.tolerance
    assert expected.error == pytest.approx(other.error, rel=1e-3)
    assert expected.times == pytest.approx(expected.per_second / other.per_second)
    assert len(result) + len(result.notes) == len(BATCH_SOLVERS)
    with pytest.raises(InputError, match="at least 2"):
        bench_many(["planar1"], members=1)


def test_bench_threads_measures_one_and_two() -> None:
    """The note states the ratio of the two times."""
    table = bench_threads("falling_cat", members=8, rounds=1)
    assert [row.threads for row in table] == [1, 2]
    one, two = (row.wall for row in table)
    assert min(one, two) > 0.0
    assert f"two threads are {one / two:.2f} times faster" in str(table)


def test_bench_commands_write_csv(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`--out` creates the folder and writes complete tables whose numbers can be read back."""
    folder = tmp_path / "new" / "numbers"
    assert main(["bench", "kernels", "coupled_planar", "--out", str(folder)]) == 0
    assert main(["bench", "threads", "falling_cat", "--members", "4", "--out", str(folder)]) == 0
    printed = capsys.readouterr().out
    names = ["kernels", "threads"]
    assert sorted(path.name for path in folder.iterdir()) == [f"{name}.csv" for name in names]
    assert all(f"written to {folder / name}.csv" in printed for name in names)
    with (folder / "threads.csv").open(encoding="utf-8") as file:
        rows = [(row["robot"], row["members"], row["threads"]) for row in csv.DictReader(file)]
    assert rows == [("falling_cat", "4", "1"), ("falling_cat", "4", "2")]


def test_slow_actions_skip_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """A slow action runs in some evenly spread rounds, the others in all."""
    clock, calls = SimpleNamespace(now=0.0), {"slow": 0, "fast": 0}
    monkeypatch.setattr(timing, "time", SimpleNamespace(perf_counter=lambda: clock.now))
    monkeypatch.setattr(timing, "SPAN", 1e-3)

    def takes(name: str, seconds: float) -> Callable[[int], None]:
        def action(count: int) -> None:
            # The first call includes loading.
            clock.now += count * seconds + (0.0 if calls[name] else 1.0)
            calls[name] += count

        return action

    actions = [takes("slow", 0.01), takes("fast", 0.0004)]
    times = timing.alternating(actions, rounds=8, budget=0.0401)
    np.testing.assert_allclose(times[:, 1], 0.0004)
    second = np.flatnonzero(np.isfinite(times[:, 0]))
    assert len(second) == calls["slow"] - 2 == 4
    assert np.diff(second).max() <= 3
    np.testing.assert_allclose(times[second, 0], 0.01)
    other = SimpleNamespace(now=0.0)

    def twice(count: int) -> None:
        other.now += 2.0 * count

    assert timing.alternating([twice], rounds=2, clock=lambda: other.now).tolist() == [[2.0]] * 2


def test_bench_commands_reject_bad_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Bad input is reported before any measurement."""
    (tmp_path / "file").write_text("")
    assert main(["bench", "kernels", "--out", str(tmp_path / "file")]) == 2
    assert "cannot create the folder" in capsys.readouterr().err
    with pytest.raises(SystemExit) as stop:
        main(["bench"])
    assert stop.value.code == 2
    assert capsys.readouterr().err.startswith("pinred: error: ")
