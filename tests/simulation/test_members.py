"""Members that differ in states, parameters, gravity or whole scenes, and their files."""

from __future__ import annotations

import re
import warnings
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinred
from pinred.forces import Controller, Damper, Spring, Torque
from pinred.signals import Fourier, Hold, Spline
from pinred.simulation.compiled import compiled_flow
from pinred.simulation.members.member_options import MemberOptions
from pinred.system.state_fields import State

CAT = pinred.load("falling_cat")
TIMES = np.linspace(0.0, 0.5, 4)
NEAR: dict[str, Any] = {"rtol": 1e-9, "atol": 1e-11}


@pytest.mark.by_hand
def test_members_with_parameters_and_gravity_agree_with_scenes() -> None:
    """ABA validates them, and a single member has the same bits."""
    gain = pinred.Parameter("gain", 0.3)
    forces = [Damper("bend", gain), Spring("sway", 2.0 * np.pi, 0.1)]
    gains, g = np.array([0.0, 0.2, 0.9]), np.array([[0, 0, -9.8], [1.0, 2, 3], [0, 0, 0]])
    options: dict[str, Any] = {"seed": 3, "forces": forces, "times": TIMES}
    many = pinred.simulate_many(CAT, members={"gain": gains, "gravity": g}, **options)
    for k in range(3):
        system = pinred.load("falling_cat", gravity=g[k])
        one = pinred.simulate(system, parameters={"gain": gains[k]}, method="DOP853", **options)
        for field in State.__dataclass_fields__:
            np.testing.assert_allclose(getattr(many[k], field), getattr(one, field), **NEAR)
        assert pinred.compare(many[k]).passed
        alone = {"gain": gains[k : k + 1], "gravity": g[k : k + 1]}
        np.testing.assert_array_equal(
            pinred.simulate_many(CAT, members=alone, **options).q[0], many.q[k]
        )
    options["parameters"] = {"gain": gains}
    named = pinred.simulate_many(CAT, **options)
    np.testing.assert_array_equal(named.x, many.x)  # gravity only makes it fall


def test_gravity_of_pivoted_members_may_differ() -> None:
    """Gravity acts on the shape or turns the base; members without gravity are a separate group."""
    g = np.array([[0.0, 0.0, -9.81], [0.0, 0.0, -1.6], [0.0, 0.0, 0.0], [0.0, 0.0, 9.0]])
    for name in ("cartpole", "heavy_top"):
        if name not in pinred_robots():
            continue
        top = pinred.load(name)
        many = pinred.simulate_many(top, members={"gravity": g}, seed=1, times=TIMES)
        for k in range(len(g)):
            one = pinred.simulate(
                pinred.load(name, gravity=g[k]), seed=1, times=TIMES, method="DOP853"
            )
            np.testing.assert_allclose(many[k].q, one.q, **NEAR)
            np.testing.assert_allclose(many[k].energy, one.energy, **NEAR)


def pinred_robots() -> set[str]:
    """Return the names of the robots that come with pinred."""
    from pinred.system.find_robot_files import bundled_robots

    return set(bundled_robots())


def test_prescribed_joint_starts_at_plan_of_member() -> None:
    """The initial position follows the parameter of each member."""
    size = pinred.Parameter("size", 0.2)
    plan = Fourier(size, [0.1], [size], 2.0)
    sizes = np.array([0.1, 0.4])
    options: dict[str, Any] = {"prescribed": {"bend": plan}, "momentum": 0, "times": TIMES}
    many = pinred.simulate_many(CAT, members={"size": sizes}, **options)
    for k in range(2):
        one = pinred.simulate(CAT, parameters={"size": sizes[k]}, method="DOP853", **options)
        np.testing.assert_allclose(many[k].q, one.q, **NEAR)
        assert pinred.compare(many[k]).passed


def test_list_of_scenes_agrees_with_simulate() -> None:
    """The scenes have several structures, with and without breaks, in any order."""

    def scene(k: int) -> pinred.Scene:
        forces: list[Any] = [
            [Spring("bend", 1.0 + k, 0.0)],
            [Spring("bend", 3.0 - k, 0.1)],
            [Torque({"sway": Fourier(0.0, [0.1], [0.0], 2.0)})],
            [Controller(_held, 0.1)],
            [],
        ]
        start = [0.1 * k, 0.0, 0.2]
        plan = {"twist": Spline([0.0, 0.2, 0.5], [0.0, 1.0, 0.0])} if k == 4 else {}
        return pinred.Scene(
            system=CAT, x0=start, momentum=0, forces=forces[k], prescribed=plan, times=TIMES
        )

    scenes = [scene(k) for k in range(5)]
    many = pinred.simulate_many(scenes)
    back = pinred.simulate_many(scenes[::-1])
    np.testing.assert_array_equal(many.q, back.q[::-1])
    for k, each in enumerate(scenes):
        np.testing.assert_allclose(many[k].q, pinred.simulate(each, method="DOP853").q, **NEAR)
        assert many[k].scene.forces == each.forces
    assert many.q.shape == (5, 4, 10)


def test_members_with_inertias_and_events_agree_with_simulate(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Members with events are simulated one by one; entries after a terminal event are NaN."""
    name = next(name for name in CAT.shape_names)
    masses = np.array([0.8, 1.7])
    options: dict[str, Any] = {"seed": 1, "times": TIMES}
    many = pinred.simulate_many(CAT, members={f"{name}.mass": masses}, explain=True, **options)
    assert "2 members 8 at once in lanes" in capsys.readouterr().out
    scenes = [
        pinred.Scene(system=CAT, parameters={f"{name}.mass": mass}, **options) for mass in masses
    ]
    again = pinred.simulate_many(scenes)
    for k, scene in enumerate(scenes):
        one = pinred.simulate(scene, method="DOP853")
        np.testing.assert_allclose(many[k].q, one.q, **NEAR)
        np.testing.assert_array_equal(again.q[k], many.q[k])
    assert abs(many.q[0] - many.q[1]).max() > 1e-6
    stop = pinred.Event(lambda s: s.t - 0.2, name="stop", terminal=True)
    ended = pinred.simulate_many(CAT, seeds=[1, 2], times=TIMES, events=[stop])
    assert ended[0].ended_by == "stop"
    free = pinred.simulate_many(CAT, seeds=[1, 2], times=TIMES)
    before = TIMES < 0.2
    np.testing.assert_allclose(ended.q[:, before], free.q[:, before], **NEAR)
    assert np.isnan(ended.energy[:, ~before]).all()
    assert np.isnan(ended.y[:, ~before]).all()


def _held(_t: float, _x: Any, xdot: Any, _mu: Any) -> list[float]:
    return [0.1, 0.0, -float(xdot[2])]


WRONG: list[tuple[Any, dict[str, Any], str]] = [
    (CAT, {"members": {"gains": [1.0]}, "seed": 1}, "members: 'gains' cannot vary"),
    (CAT, {"members": {"gravity": [0, 0, 1.0]}}, r"gravity must have shape \(N, 3\)"),
    (CAT, {"members": {"x0": np.zeros((2, 3))}, "x0": [1.0, 0, 0]}, "'x0' is given in members"),
    (CAT, {"members": {"x0": np.zeros((2, 3)), "gravity": np.zeros((3, 3))}}, "x0: 2, gravity: 3"),
    (CAT, {"members": [1.0]}, "members must be"),
    (CAT, {"seeds": [1], "x0": np.zeros((1, 3))}, "set the whole initial state"),
    ([], {}, "at least one member"),
    ([CAT], {}, "takes Scenes in a list, but entry 0"),
    (
        [pinred.Scene(system=CAT, duration=1.0), pinred.Scene(system=CAT, duration=2.0)], {},
        "at the same times",
    ),
    ([pinred.Scene(system=CAT)], {"duration": 1.0}, "already contains all options. Omit duration"),
    ("falling_cat", {"seeds": [1]}, "takes a System"),
]  # fmt: skip


@pytest.mark.parametrize(("what", "options", "words"), WRONG)
def test_unknown_member_names_are_rejected(what: Any, options: dict[str, Any], words: str) -> None:
    """The message states the name and a remedy."""
    with pytest.raises(pinred.InputError, match=words):
        pinred.simulate_many(what, **options)


def test_member_has_dense_output_and_balances() -> None:
    """At the report times its states are those of the arrays."""
    many = pinred.simulate_many(CAT, seeds=[1, 2], duration=0.5, forces=[Damper("bend", 0.2)])
    traj = many[1]
    assert isinstance(traj, pinred.Trajectory)
    np.testing.assert_array_equal(traj.energy, many.energy[1])
    one = pinred.simulate(CAT, seed=2, duration=0.5, forces=[Damper("bend", 0.2)])
    np.testing.assert_allclose(traj(0.123).q, one(0.123).q, **NEAR)
    assert (traj.run.steps, traj.run.evaluations) == (one.run.steps, one.run.evaluations)
    work = traj.energy_balance.work[-1]
    np.testing.assert_allclose(work, one.energy_balance.work[-1], **NEAR)
    shapes = pinred.simulate_many(CAT, seeds=[1, 2], times=TIMES, outputs="shape")
    assert shapes.x.shape == (2, 4, 3)
    with pytest.raises(pinred.InputError, match="outputs='shape'"):
        _ = shapes.pose


def test_npz_of_members_has_states_and_failures(tmp_path: Path) -> None:
    """Arrays have names, and a failed save leaves no file."""
    system = pinred.load("coupled_planar")
    many = pinred.simulate_many(
        system, x0=[[0.0], [1.0]], duration=100.0, springs={"hinge": (-1e6, 0.0)}
    )
    many.save(tmp_path / "many.npz")
    with np.load(tmp_path / "many.npz") as file:
        np.testing.assert_array_equal(file["x"], many.x)
        np.testing.assert_array_equal(file["pose"], many.pose)
        np.testing.assert_array_equal(file["t"], many.t)
        assert file["failure"].tolist() == ["", many.failures[0].reason]
        assert file["reached"].tolist() == [100.0, many.failures[0].time]
        assert file["robot"] == "coupled_planar"
    with pytest.raises(pinred.InputError, match=r"\.npz or \.zarr"):
        many.save(tmp_path / "many.csv")
    assert [path.name for path in tmp_path.iterdir()] == ["many.npz"]


def test_zarr_of_members_has_the_arrays_of_npz(tmp_path: Path) -> None:
    """Without the package zarr, the error states how to install it."""
    many = pinred.simulate_many(CAT, seeds=[1, 2], times=TIMES)
    if find_spec("zarr") is None:
        with pytest.raises(pinred.MissingPackageError, match=r"pinred\[zarr\]"):
            many.save(tmp_path / "many.zarr")
        assert list(tmp_path.iterdir()) == []
        return
    zarr = import_module("zarr")
    many.save(tmp_path / "many.zarr")
    root = zarr.open_group(str(tmp_path / "many.zarr"), mode="r")
    np.testing.assert_array_equal(root["q"][:], many.q)
    assert root.attrs["robot"] == "falling_cat"
    assert [path.name for path in tmp_path.iterdir()] == ["many.zarr"]


def test_saved_members_are_read_again(tmp_path: Path) -> None:
    """Arrays and failures of .npz and .zarr are equal, and xarray reads names and units."""
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("zarr")
    system = pinred.load("coupled_planar")
    options: dict[str, Any] = {"duration": 100.0, "springs": {"hinge": (-1e6, 0.0)}}
    many = pinred.simulate_many(system, x0=[[0.0], [1.0]], **options)
    for name in ("many.npz", "many.zarr"):
        many.save(tmp_path / name)
        again = pinred.read_members(tmp_path / name)
        assert (len(again), again.failures) == (2, list(many.failures))
        for field in ("x", "pose", "energy"):
            np.testing.assert_array_equal(getattr(again, field), getattr(many, field))
        np.testing.assert_array_equal(again[0].pose, many.pose[0])
        assert again.system.name == again[0].system.name == "coupled_planar"
        with pytest.raises(pinred.IntegrationError, match="member 1 stopped at t"):
            again[1]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plain = xarray.open_zarr(str(tmp_path / "many.zarr"), consolidated=False)
    assert plain["pose"].dims == ("member", "t", "coordinate")
    assert plain["pose"].attrs["units"] == "m | rad"
    assert plain["coordinate"].values.tolist() == list(system.group.pose_names)
    np.testing.assert_array_equal(plain["reached"], [100.0, many.failures[0].time])
    other = pinred.simulate_many(system, x0=[[0.1], [0.2], [0.3]], duration=1.0)
    other.save(tmp_path / "many.zarr")
    np.testing.assert_array_equal(pinred.read_members(tmp_path / "many.zarr").x, other.x)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["many.npz", "many.zarr"]


def test_folders_of_others_are_not_replaced(tmp_path: Path) -> None:
    """Only a zarr folder is replaced; other files are not members."""
    pytest.importorskip("zarr")
    many = pinred.simulate_many(CAT, seeds=[1], times=TIMES)
    folder = tmp_path / "many.zarr"
    folder.mkdir()
    (folder / "mine.txt").write_text("mine")
    with pytest.raises(pinred.InputError, match="it exists and is not a zarr folder"):
        many.save(folder)
    assert (folder / "mine.txt").read_text() == "mine"
    for path in (folder, tmp_path / "none.zarr", tmp_path / "none.npz"):
        with pytest.raises((pinred.LoadError, pinred.InputError)):
            pinred.read_members(path)
    many[0].save(tmp_path / "one.npz")
    with pytest.raises(pinred.LoadError, match="does not contain members"):
        pinred.read_members(tmp_path / "one.npz")


@pytest.mark.by_hand
def test_documented_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    """The example of the documentation runs, and its member passes the comparison."""
    text = (Path(__file__).parents[2] / "docs/many.md").read_text(encoding="utf-8")
    _, code = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(compile(code, "docs/many.md", "exec"), {})
    out = capsys.readouterr().out
    assert "40 members 8 at once in lanes, DOP853" in out
    assert "(40, 201, 3) (40, 201)" in out
    assert "verdict: PASSED" in out


def test_members_with_breaks_agree_with_simulate(capsys: pytest.CaptureFixture[str]) -> None:
    """Members in SIMD lanes stop together at the break of a table."""
    high, rng = pinred.Parameter("high", 0.4), np.random.default_rng(2)
    options: dict[str, Any] = {
        "forces": [Torque({"sway": Hold([0.0, 0.1, 0.25], [0.1, high, -0.3])})],
        "times": [0.0, 0.05, 0.1, 0.3, 0.4], "momentum": 0, "method": "DOP853",
    }  # fmt: skip
    members = {"high": rng.normal(size=11), "x0": rng.normal(size=(11, 3))}
    many = pinred.simulate_many(CAT, members=members, explain=True, **options)
    assert "11 members 8 at once in lanes" in capsys.readouterr().out
    for k in (0, 10):
        one = pinred.simulate(many[k].scene)
        np.testing.assert_allclose(many.q[k], one.q, **NEAR)
        np.testing.assert_allclose(many.energy[k], one.energy, **NEAR)
    some = {name: values[4:6] for name, values in members.items()}
    np.testing.assert_array_equal(pinred.simulate_many(CAT, members=some, **options).q, many.q[4:6])
    members["x0"][3] = np.nan
    with pytest.raises(pinred.InputError, match="finite"):
        pinred.simulate_many(CAT, members=members, **options)


def _flows(threads: int) -> list[Any]:
    """Return the flows of members with and without momentum, whose parameters differ."""
    gain, rng = pinred.Parameter("gain", 0.3), np.random.default_rng(2)
    rates = rng.normal(size=(11, 3))
    twists = rng.normal(size=(11, 6))
    rates[[2, 7]] = twists[[2, 7]] = 0.0
    members = {"gain": rng.uniform(size=11), "xdot0": rates, "xi0": twists}
    members |= {"x0": rng.normal(size=(11, 3)), "back.mass": rng.uniform(1.0, 3.0, 11)}
    options = {"forces": [Damper("bend", gain)], "times": TIMES}
    (group,) = MemberOptions(CAT, options, members, None).members().groups
    return compiled_flow.flows_of(group.plan, group.given, group.own, threads)


@pytest.mark.by_hand("1")
@pytest.mark.parametrize("threads", [1, 4])
def test_members_are_set_up_by_copies_on_threads(
    threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bits are those of arrays that are concatenated, without indices of copies."""
    monkeypatch.setattr(compiled_flow, "_ROWS_OF_ONE_THREAD", 2)
    flows = _flows(threads)
    monkeypatch.setattr(compiled_flow, "prepare_start", lambda *_: None)
    expected = _flows(1)
    assert [len(members) for members, _ in flows] == [9, 2]
    for (members, flow), (others, other) in zip(flows, expected, strict=True):
        assert np.array_equal(members, others)
        for name in ("y0", "parameters", "path"):
            assert np.array_equal(getattr(flow, name), getattr(other, name)), name


def test_members_whose_momentum_overflows_are_rejected() -> None:
    """The momentum is a sum of products of finite numbers."""
    rates = np.array([[1.0, 0.0, 0.0], [1e308, 1e308, 1e308]])
    options: dict[str, Any] = {"xi0": [1e308, 0, 0, 1e308, 0, 0], "times": TIMES}
    with pytest.raises(pinred.InputError, match="initial momentum or twist overflows"):
        pinred.simulate_many(CAT, xdot0=rates, invalid="raise", **options)
