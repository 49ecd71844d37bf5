"""Tables as data of runs: values against SciPy, shared kernels, and work linear in the entries."""

from __future__ import annotations

import cProfile
import pstats
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import pinred
from pinred import Parameter
from pinred.common.arrays import Array
from pinred.common.errors import InputError
from pinred.forces import Limit, Torque
from pinred.forces.force_model import ForceModel
from pinred.forces.force_numbers import Tables
from pinred.forces.signals import signal
from pinred.judge.full_dynamics import FullDynamics
from pinred.scene.scene import ENGINES, Engine
from pinred.signals import Hold, Linear, Spline
from pinred.simulation.longest_steps import limits_of_runs, step_limits
from pinred.simulation.members import integrate_members

CAT = pinred.load("falling_cat")
DRIVEN, PUSHED = CAT.shape_names[0], CAT.shape_names[2]
END = 1.0


def knots(count: int, seed: int = 0) -> tuple[Array, Array]:
    """Return times from 0 to END, unevenly spaced, and values, (count,) each."""
    rng = np.random.default_rng(seed)
    inner = (np.arange(1, count - 1) + rng.uniform(-0.4, 0.4, count - 2)) / (count - 1)
    times = END * np.concatenate([[0.0], inner, [1.0]])
    return times, 0.3 * np.sin(3.0 * times + seed) + 1e-3 * rng.normal(size=count)


def driven(table: Any, **options: Any) -> pinred.Scene:
    """Return a scene whose first joint follows a table."""
    settings: dict[str, Any] = {"times": np.linspace(0.0, END, 23), "seed": 1} | options
    return pinred.Scene(system=CAT, prescribed={DRIVEN: table}, **settings)


def pushed(table: Any, **options: Any) -> pinred.Scene:
    """Return a scene with a torque on the last joint that follows a table."""
    settings: dict[str, Any] = {"times": np.linspace(0.0, END, 5), "seed": 1} | options
    return pinred.Scene(system=CAT, forces=[Torque({PUSHED: table})], **settings)


def model_of(scene: pinred.Scene) -> ForceModel:
    """Return the force model of a scene."""
    model = scene.force_model
    assert model is not None
    return model


# Each kind of spline runs in the compiled engine, and one in both.
@pytest.mark.by_hand("clamped-pinocchio", "natural-pinocchio", "not-a-knot-pinocchio")
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("end", signal.ENDS)
@pytest.mark.sampled
def test_driven_joint_follows_spline_of_scipy(engine: Engine, end: Any) -> None:
    """Positions and rates of a driven joint are those of SciPy's spline, also exactly at knots."""
    times, values = knots(40)
    values[-1] = values[0]
    reports = np.sort(np.concatenate([times[::7], np.linspace(0.0, END, 23)[1:-1]]))
    curve = CubicSpline(times, values, bc_type=end)
    traj = pinred.simulate(driven(Spline(times, values, end=end), times=reports), engine=engine)
    np.testing.assert_allclose(traj.x[:, 0], curve(reports), rtol=0, atol=1e-14)
    np.testing.assert_allclose(traj.xdot[:, 0], curve(reports, 1), rtol=0, atol=1e-11)


def test_numbers_of_spans_are_segments_of_scipy() -> None:
    """The segment at a time is SciPy's, also before and after the table, for several tables."""
    (times, values), (others, more) = knots(30), knots(17, 1)
    tables = [Spline(times, values), Hold(others, more), Linear(times, values)]
    within = np.array([-1.0, 0.0, times[3], 0.123, times[-1], 2.0])
    numbers = Tables(tables).at(within)
    curve = CubicSpline(times, values, bc_type="natural")
    assert (numbers[:, 0] == within).all()
    k = np.clip(np.searchsorted(times, within, side="right") - 1, 0, 28)
    assert (numbers[:, 1] == times[k]).all()
    np.testing.assert_allclose(numbers[:, 2:6], curve.c.T[k], rtol=1e-13)
    j = np.clip(np.searchsorted(others, within, side="right") - 1, 0, 16)
    assert (numbers[:, 6:8] == np.column_stack([others, more])[j]).all()
    slopes = np.diff(values) / np.diff(times)
    np.testing.assert_allclose(
        numbers[:, 8:], np.column_stack([times[:-1], slopes, values[:-1]])[k]
    )
    assert (Tables(tables).breaks == np.unique([*times[1:-1], *others[1:]])).all()


def test_second_table_shares_functions_and_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another table of the same kind, of another length, compiles nothing and has own values."""
    first = pinred.simulate(driven(Spline(*knots(9))))
    monkeypatch.setattr(ForceModel, "__init__", lambda *_: pytest.fail("another force model"))
    times, values = knots(301, 5)
    second = pinred.simulate(driven(Spline(times, values)))
    assert second.motion.flow.kernel is first.motion.flow.kernel  # type: ignore[attr-defined]
    curve = CubicSpline(times, values, bc_type="natural")
    np.testing.assert_allclose(second.x[:, 0], curve(second.t), rtol=0, atol=1e-14)
    # The models of the first table are unchanged.
    assert np.array_equal(pinred.simulate(driven(Spline(*knots(9)))).x, first.x)


def test_tables_of_another_kind_are_not_shared() -> None:
    """The type, the pattern of shared tables, and other numbers of a force are parts of the key."""
    a, b = Linear(*knots(5)), Linear(*knots(5, 1))
    options: dict[str, Any] = {"times": [END], "seed": 1}

    def key(first: Any, second: Any, limit: Limit | None = None) -> str:
        torque = Torque({DRIVEN: first, PUSHED: second}, limit)
        return model_of(pinred.Scene(system=CAT, forces=[torque], **options)).key

    assert key(a, b) == key(b, a)
    assert len({key(a, b), key(a, a), key(a, Hold(*knots(5))), key(a, b, Limit(0.1))}) == 4
    shared = pinred.Scene(
        system=CAT, forces=[Torque({DRIVEN: a, PUSHED: a}, Limit(0.1))], **options
    )
    other = pinred.Scene(system=CAT, forces=[Torque({DRIVEN: b, PUSHED: b}, Limit(0.2))], **options)
    assert model_of(shared).numbers[-2:].tolist() == [0.1, 0.1]
    assert model_of(other).numbers[-2:].tolist() == [0.2, 0.2]


def test_forces_with_functions_are_not_shared() -> None:
    """A function may use variables that change, so another force with it has its own model."""
    gain = [1.0]

    def torque(t: Any, x: Any, xdot: Any, mu: Any) -> Any:  # noqa: ARG001
        return gain[0]

    def value() -> float:
        force = Torque({DRIVEN: torque, PUSHED: Linear(*knots(4))})
        model = model_of(pinred.Scene(system=CAT, forces=[force], times=[END], seed=1))
        result = model.acting_function.call([0.0] * len(range(model.acting_function.n_in())))
        return float(result[0][0])

    assert value() == 1.0
    gain[0] = 2.0
    assert value() == 2.0


def test_work_and_memory_grow_linearly_with_entries() -> None:
    """Ten times as many knots take at most about ten times the calls and the memory."""
    pinred.simulate(driven(Spline(*knots(9))))
    calls, peaks = [], []
    for count in (1000, 10_000):
        table = Spline(*knots(count))
        profile = cProfile.Profile()
        profile.enable()
        pinred.simulate(driven(table))
        profile.disable()
        calls.append(pstats.Stats(profile).total_calls)  # type: ignore[attr-defined]
        tracemalloc.start()
        pinred.simulate(driven(Spline(*knots(count, 1))))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert calls[1] < 11.0 * calls[0]
    assert calls[1] < 20 * 10_000
    assert peaks[1] < 12.0 * peaks[0]


@pytest.mark.by_hand
def test_time_grows_linearly_with_entries() -> None:
    """The processor time for 100,000 knots on three joints is at most 20 times that for 10,000."""
    from time import process_time

    seconds = []
    for count in (10, 10_000, 100_000):
        plans = {name: Spline(*knots(count, k)) for k, name in enumerate(CAT.shape_names)}
        began = process_time()
        pinred.simulate(pinred.Scene(system=CAT, prescribed=plans, duration=END, seed=1))
        seconds.append(process_time() - began)
    assert seconds[2] < 20.0 * seconds[1]


def test_derivatives_with_respect_to_values_are_splines_of_units() -> None:
    """A spline is linear in its values, so the derivative is SciPy's spline through a unit."""
    times, values = knots(6)
    entries: list[Any] = values.tolist()
    entries[1], entries[4] = Parameter("a", values[1]), Parameter("b", values[4])
    entries[2] = entries[1]  # one Parameter in two values
    reports = np.array([0.15, 0.5, 0.95])
    table = Spline(times, entries)
    flow = pinred.flow(driven(table, times=reports), wrt=("a", "b"), of=("x",))
    units = np.zeros((6, 2))
    units[[1, 2], 0] = units[4, 1] = 1.0
    expected = CubicSpline(times, units, bc_type="natural")(reports)
    jacobian = flow.jacobian()
    found = np.stack([jacobian[name][:, 0] for name in ("a", "b")], axis=1)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    moved = pinred.simulate(driven(table, times=reports, parameters={"a": 0.7, "b": -0.2}))
    values[[1, 2]], values[4] = 0.7, -0.2
    exact = CubicSpline(times, values, bc_type="natural")(reports)
    np.testing.assert_allclose(moved.x[:, 0], exact, rtol=0, atol=1e-14)


def test_members_with_own_tables_equal_simulate() -> None:
    """Members share lanes but not tables, also where conditions contain tables and Parameters."""
    most, times = Parameter("most", 0.05), np.linspace(0.0, END, 7)
    values = 0.1 * np.random.default_rng(2).normal(size=(5, 7))

    def scene(k: int) -> pinred.Scene:
        torque = Torque({PUSHED: Spline(times, values[k])}, Limit(most))
        options: dict[str, Any] = {"times": [0.4, END], "parameters": {"most": 0.04 + 0.01 * k}}
        return pinred.Scene(system=CAT, forces=[torque], seed=3, **options)

    scenes = [scene(k) for k in (0, 1, 2, 3, 4, 1)]
    many = pinred.simulate_many(scenes)
    for k, one in enumerate(map(pinred.simulate, scenes)):
        np.testing.assert_allclose(many[k].x, one.x, rtol=0, atol=1e-8)
    assert np.array_equal(many[1].x, many[5].x)
    assert np.abs(many[1].x - many[2].x).max() > 1e-4


def test_steps_of_members_are_limited_by_own_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    """Members of one group have the step limits of their own tables, as each alone."""
    times = np.linspace(0.0, END, 5)
    tables = [Spline(times, values) for values in (np.zeros(5), [0.0, 1.0, -1.0, 1.0, 0.0])]
    scenes = [pushed(table, seed=3) for table in tables]
    found: list[Any] = []

    def spy(*arguments: Any) -> Any:
        found.extend(limits_of_runs(*arguments))
        return found

    monkeypatch.setattr(integrate_members, "limits_of_runs", spy)
    pinred.simulate_many(scenes)
    assert len(found) == 2
    assert sorted(limits.decay.max() > 1e-3 for limits in found) == [False, True]


def test_step_limits_belong_to_tables() -> None:
    """Models that share functions of time have the limits of their own tables."""
    times = np.linspace(0.0, END, 5)
    flat, steep = Spline(times, np.zeros(5)), Spline(times, [0.0, 1.0, -1.0, 1.0, 0.0])
    found = []
    for table in (flat, steep):
        model = model_of(pushed(table))
        limits = step_limits(model, END, model.numbers_from(0.0, END), 1e-9, 8)
        found.append(limits.decay)
    assert found[0].max() == 0.0
    assert found[1].max() > 1e-3


def test_judge_uses_own_tables() -> None:
    """Segments in the parameters of a trajectory do not replace those of the scene."""
    scene = pushed(Hold([0.0, 0.5], [0.1, 0.2]))
    full, model = FullDynamics(scene), model_of(scene)
    numbers = model.numbers_from(0.6, END)
    numbers[model.within.start + 1 : model.within.stop] = 7.0
    full.set_parameters(numbers)
    assert full._parameters[model.within].tolist() == [numbers[0], 0.5, 0.2]


def test_other_tables_are_other_scenes(tmp_path: Path) -> None:
    """A checkpoint and a sweep's store of another table are refused."""
    a, b = Hold([0.0, 0.5], [0.1, 0.2]), Hold([0.0, 0.5], [0.1, 0.3])
    pinred.simulate(pushed(a), checkpoint=tmp_path / "run.ckpt")
    with pytest.raises(InputError, match="another scene"):
        pinred.simulate(pushed(b), checkpoint=tmp_path / "run.ckpt")
    varied = {f"x0.{DRIVEN}": [0.1, 0.2]}
    pinred.sweep(pushed(a), varied, store=tmp_path / "store.zarr")
    with pytest.raises(InputError, match="another scene"):
        pinred.sweep(pushed(b), varied, store=tmp_path / "store.zarr")


def test_random_numbers_keep_the_segment_of_the_time() -> None:
    """Kernels are tested near the start of a segment, where its polynomial is defined."""
    times, values = knots(20)
    model = model_of(pushed(Spline(times, values)))
    numbers = model.random_numbers(np.random.default_rng(0), float(times[7]) + 1e-6)
    assert numbers[model.within][1] == times[7]
    assert (numbers[model.within][2:] != model.tables.at(times[7])[2:]).all()


def test_sizes_of_tables_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tables have at most 100,000 entries, and their Parameters a bounded number of weights."""
    grid = np.arange(100_001.0)
    assert Hold(grid[:-1], grid[:-1]).breaks.size == 99_999
    with pytest.raises(InputError, match="100001 entries, more than 100000"):
        Hold(grid, grid)
    monkeypatch.setattr(signal, "_MOST_WEIGHTS", 100)
    table = Spline([0.0, 0.3, 0.6, END], [Parameter(name, 0.0) for name in "abcd"])
    assert table.segments().shape == (3, 21)
    monkeypatch.setattr(signal, "_MOST_WEIGHTS", 60)
    with pytest.raises(InputError, match="at most 3 Parameters among its values, got 4"):
        table.segments()
