"""Scenes that share a structure: each changed option, also one changed in place, has its effect."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from ball_trees import ball_tree

from pinred import DOP853, Scene, System, load, simulate
from pinred.common.errors import InputError, ShapeError
from pinred.common.memo import recent
from pinred.forces import PD, Controller, Damper, Torque, Wrench
from pinred.forces.force_model_cache import cached_force_model
from pinred.scene.scene import Shared, scene_of
from pinred.scene.scene_options import ARRAYS_OF_STATE
from pinred.signals import Attitude
from pinred.simulation.compiled.compiled_flow import CompiledFlow, flows_of
from pinred.simulation.plan import plan_of

START: dict[str, Any] = {
    "x0": np.array([0.3, -0.2]),
    "xdot0": np.array([1.2, 0.4]),
    "duration": 1.0,
}


@pytest.fixture(scope="module")
def robot() -> System:
    """Return a planar robot with two joints."""
    return load("planar_chain5", lock=("joint3", "joint4", "joint5"))


def fresh(robot: System, **options: Any) -> np.ndarray:
    """Simulate without the structures and force models that earlier scenes have left."""
    kept: dict[Any, Any] = vars(robot)["_once"]
    for kind in (Shared, cached_force_model):
        kept.pop((recent, kind), None)
    return simulate(robot, **{**START, **options}).x


CHANGES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "x0": ({}, {"x0": np.array([0.3, -0.1])}),
    "xi0": ({}, {"xi0": [0.1, 0.0, 0.4]}),
    "momentum instead of xi0": ({"xi0": [0.1, 0.2, 0.4]}, {"momentum": [0.1, 0.2, 0.4]}),
    "zero momentum": ({"momentum": [0.1, 0.2, 0.4]}, {"momentum": 0.0}),
    "duration": ({}, {"duration": 1.5}),
    "times": ({"times": [0.0, 0.5, 1.0]}, {"times": [0.0, 0.6, 1.0]}),
    "rtol": ({"rtol": 1e-4}, {"rtol": 1e-9}),
    "method": ({"method": "DOP853"}, {"method": "Tsit5"}),
    "tolerance of a method": ({"method": DOP853(1e-4)}, {"method": DOP853(1e-10)}),
    "springs": ({"springs": {"joint1": (3.0, 0.1)}}, {"springs": {"joint1": (3.0, 0.2)}}),
    "forces": ({"forces": [Damper("joint1", 0.1)]}, {"forces": [Damper("joint1", 0.3)]}),
    "prescribed": ({"prescribed": {"joint1": "0.3*t"}}, {"prescribed": {"joint1": "0.4*t"}}),
    "prescribed number": ({"prescribed": {"joint1": 0.2}}, {"prescribed": {"joint1": 0.3}}),
    "parameters": ({"parameters": {}}, {"parameters": {"link2.mass": 2.0}}),
}


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.sampled
def test_scene_with_changed_option_equals_first_scene_of_a_robot(
    change: str, robot: System
) -> None:
    """Each option, changed and changed back, has the same effect as without stored structures."""
    before, after = ({**START, **options} for options in CHANGES[change])
    if "momentum" in after:
        after.pop("xi0", None)
    results = [simulate(robot, **options).x for options in (before, after, before, after)]
    assert np.array_equal(results[0], results[2])
    assert np.array_equal(results[1], results[3])
    assert not np.array_equal(results[0], results[1])
    assert np.array_equal(results[1], fresh(robot, **after))


def test_options_changed_in_place_have_an_effect(robot: System) -> None:
    """Arrays, tables and lists that change between two calls have their effect."""
    x0, times = np.array([0.3, -0.2]), np.array([0.0, 0.25, 1.0])
    springs: dict[str, tuple[float, float]] = {"joint1": (3.0, 0.1)}
    gains, forces = {"joint1": 2.0}, [Damper("joint2", 0.1)]
    options: dict[str, Any] = {
        **START, "x0": x0, "times": times, "springs": springs,
        "forces": forces, "prescribed": {},
    }  # fmt: skip
    forces.append(PD({"joint1": 0.5}, gains, 0.1))  # type: ignore[arg-type]

    def result() -> np.ndarray:
        return simulate(robot, **options).x

    changes: list[Callable[[], Any]] = [
        lambda: x0.__setitem__(0, 0.5),
        lambda: times.__setitem__(1, 0.5),
        lambda: springs.__setitem__("joint1", (3.0, 0.4)),
        lambda: gains.__setitem__("joint1", 5.0),
        lambda: forces.__setitem__(0, Damper("joint2", 0.7)),
        lambda: options["prescribed"].__setitem__("joint2", "0.1*t"),
    ]
    last = result()
    assert np.array_equal(last, result())
    for change in changes:
        change()
        changed = result()
        assert not np.array_equal(changed, last)
        assert np.array_equal(changed, fresh(robot, **options))
        last = changed


def test_controller_changed_in_place_has_an_effect(robot: System) -> None:
    """A controller whose function uses a changed variable has its effect."""
    gain = [1.0]
    controller = Controller(
        lambda state: {"joint1": -gain[0] * state.x["joint1"]}, 0.1, ("joint1",)
    )
    first = simulate(robot, **START, forces=controller).x
    gain[0] = 4.0
    assert not np.array_equal(first, simulate(robot, **START, forces=controller).x)


def test_new_force_with_the_same_function_is_built_again(robot: System) -> None:
    """A function is evaluated again for each new force, because its variables may have changed."""
    gain = [1.0]

    def torque(state: Any) -> dict[str, Any]:
        return {"joint1": -gain[0] * state.x["joint1"]}

    first = simulate(robot, **START, forces=Torque(torque)).x
    gain[0] = 4.0
    assert not np.array_equal(first, simulate(robot, **START, forces=Torque(torque)).x)


def test_equal_values_of_wrong_type_are_still_rejected(robot: System) -> None:
    """True is not 1, although both are equal."""
    simulate(robot, **START, rtol=1.0e-3, passive=False, forces=())
    for option, value in {"duration": True, "passive": 0, "friction": True}.items():
        with pytest.raises(InputError, match=option):
            simulate(robot, **{**START, option: value})
    with pytest.raises(InputError, match="rtol conflicts"):
        Scene(system=robot, **START, method=DOP853(1e-6), rtol=1e-8)


def test_default_tolerance_stays_a_default(robot: System) -> None:
    """A tolerance from the user differs from an equal default."""
    rtol = float(Scene(system=robot, **START).rtol)
    Scene(system=robot, **START, method=DOP853(1e-6))
    with pytest.raises(InputError, match="rtol conflicts"):
        Scene(system=robot, **START, method=DOP853(1e-6), rtol=rtol)


def test_scenes_of_one_structure_share_force_model_and_report_times(robot: System) -> None:
    """Scenes that differ in their initial states share the checked options."""
    options: dict[str, Any] = {**START, "springs": {"joint1": (3.0, 0.1)}}
    first, second = (
        Scene(system=robot, **{**options, "x0": x0}) for x0 in ([0.1, 0.2], [0.3, 0.4])
    )
    assert first.force_model is second.force_model
    assert first.report_times is second.report_times
    assert not np.array_equal(first.start.x, second.start.x)


def test_changes_of_a_scene_do_not_reach_another_of_its_structure(robot: System) -> None:
    """Scenes share no table that can change."""
    options: dict[str, Any] = {**START, "prescribed": {"joint1": 0.2}}
    first = Scene(system=robot, **options)
    first.prescribed.clear()  # type: ignore[attr-defined]
    assert list(Scene(system=robot, **options).prescribed) == ["joint1"]


@pytest.mark.parametrize("outputs", ["all", "shape"])
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("falling_cat", {"xi0": np.ones(6)}),
        ("falling_cat", {"momentum": 0}),
        ("falling_cat", {"method": "Variational(0.01)", "momentum": np.ones(6)}),
        ("planar_chain5", {"forces": Wrench([0.1, 0.2, 0.3]), "xi0": [1, 2, 3]}),
        ("planar_chain5", {"prescribed": {"joint2": "0.1*t"}, "momentum": [1, 2, 3]}),
    ],
)
@pytest.mark.sampled
def test_prepared_start_equals_the_start_of_members(
    name: str, options: dict[str, Any], outputs: Any
) -> None:
    """The copies of a prepared start have the bits that the assembly of members computes."""
    system = load(name)
    rng = np.random.default_rng(0)
    for _ in range(3):
        x0, xdot0 = rng.normal(size=(2, system.m))
        given: dict[str, Any] = {"x0": x0, "xdot0": xdot0, "duration": 1, "outputs": outputs}
        scene = Scene(system=system, **given, **options)
        plan = plan_of(scene)
        flow, ((_, expected),) = CompiledFlow.of_plan(plan), flows_of(plan, scene.given)
        for array in ("y0", "parameters", "path"):
            assert np.array_equal(getattr(flow, array), getattr(expected, array)[0])


def test_attitude_changed_in_a_table_has_an_effect() -> None:
    """A ball that follows another attitude moves differently; equal scenes share the structure."""
    system = ball_tree(5, 2)
    ball = system.space.balls[1].name
    options: dict[str, Any] = {"duration": 0.5, "seed": 1}
    slow, quick = Attitude(["0.3*t", 0.1, 0.0]), Attitude(["0.4*t", 0.1, 0.0])

    def poses(plan: Any) -> np.ndarray:
        return simulate(system, prescribed={ball: plan}, **options).q

    first, other = poses(slow), poses(quick)
    assert not np.array_equal(first, other)
    assert np.array_equal(first, poses(slow))
    assert np.array_equal(other, poses(["0.4*t", 0.1, 0.0]))


STATED: dict[str, dict[str, Any]] = {
    "nothing but times": {"times": [0.5, 1.0]},
    "twist": {"xi0": np.array([0.1, 0.2, 0.4]), "duration": 1.0},
    "momentum": {"momentum": np.array([0.1, 0.2, 0.4]), "duration": 1.0, "method": "DOP853"},
    "pose": {"pose0": np.array([0.1, 0.2, 0.3]), "times": np.array([0.3, 1.0])},
    "velocity": {"v0": np.array([0.1, 0.2, 0.3, 0.1, 0.2]), "duration": 1.0},
    "forces": {"forces": [Damper("joint1", 0.1)], "springs": {"joint1": (3.0, 0.1)}},
    "prescribed": {"prescribed": {"joint1": "0.3*t"}, "duration": 1.0},
}


@pytest.mark.parametrize("stated", STATED)
def test_repeated_scene_equals_a_scene_that_checks_all_options(stated: str, robot: System) -> None:
    """A scene of an earlier call's structure has the fields of Scene(...)."""
    options = dict(STATED[stated])
    options["x0"] = np.array([0.2, 0.1])
    if "v0" not in options:
        options["xdot0"] = np.array([0.3, 0.4])
    scene_of(robot, options)
    for name in ARRAYS_OF_STATE:
        if name in options:
            options[name] = options[name] + 0.125
    repeated, scene = scene_of(robot, options), Scene(system=robot, **options)
    assert vars(repeated)["_shared"] is vars(scene)["_shared"]
    for name, value in vars(scene).items():
        if name in ("_given", "_once"):
            continue
        other = vars(repeated)[name]
        same = np.array_equal(other, value) if isinstance(value, np.ndarray) else other == value
        assert same or other is value or name in ("forces", "_held", "_parameters"), name
    assert tuple(vars(repeated)["forces"]) == tuple(vars(scene)["forces"])
    for name, value in vars(scene.given).items():
        assert np.array_equal(value, vars(repeated.given)[name]) or value is None
    assert np.array_equal(simulate(repeated).x, simulate(scene).x)


@pytest.mark.parametrize("name", ["x0", "xdot0", "xi0", "momentum"])
def test_repeated_call_rejects_invalid_numbers(name: str, robot: System) -> None:
    """NaN, infinity and wrong lengths are rejected after a valid call of the same structure."""
    size = 2 if name.startswith("x") and name != "xi0" else 3
    options = {**START, name: np.full(size, 0.1)}
    simulate(robot, **options)
    for value in (np.nan, np.inf, -np.inf):
        wrong = np.full(size, 0.1)
        wrong[-1] = value
        with pytest.raises(ShapeError, match=f"{name} must be finite"):
            simulate(robot, **{**options, name: wrong})
    with pytest.raises(ShapeError, match=f"{name}: expected . numbers"):
        simulate(robot, **{**options, name: np.zeros(size + 1)})
    vague = {**options, "x0": np.array([1e12, 0.1])}
    if name == "x0":
        with pytest.raises(InputError, match="only accurate to"):
            simulate(robot, **vague)


@pytest.mark.parametrize("kind", [np.array, list, tuple])
def test_repeated_call_takes_arrays_and_lists_without_other_checks(
    kind: Callable[..., Any], robot: System, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A state as lists has the bits of one as arrays, and repeats the checks of the state only."""
    options = {**START, "x0": [1, 0], "xdot0": [0, 1]}
    expected = fresh(robot, **{**options, "x0": np.array([0.5, 0]), "xdot0": np.array([0.0, 1])})
    simulate(robot, **{**options, "x0": kind([1, 0]), "xdot0": kind([0, 1])})
    checks = MagicMock(side_effect=AssertionError("all options are checked again"))
    monkeypatch.setattr(Scene, "__post_init__", checks)
    repeated = simulate(robot, **{**options, "x0": kind([0.5, 0]), "xdot0": kind([0, 1])})
    assert np.array_equal(repeated.x, expected)
    with pytest.raises(ShapeError, match="x0 must be finite"):
        simulate(robot, **{**options, "x0": kind([np.nan, 0]), "xdot0": kind([0, 1])})


@pytest.mark.parametrize("kind", [np.array, list])
def test_arrays_changed_after_a_call_leave_its_scene_unchanged(
    kind: Callable[..., Any], robot: System
) -> None:
    """`compare` and copies of the scene use the initial state of the call."""
    for _ in range(2):  # the first call of a structure, and a repeated one
        x0, xi0 = kind([0.3, -0.2]), kind([0.1, 0.2, 0.4])
        trajectory = simulate(robot, **{**START, "x0": x0, "xi0": xi0})
        x0[0] += 0.5
        xi0[0] += 0.5
        start = trajectory.scene.start
        assert np.array_equal(start.x, [0.3, -0.2])
        assert np.array_equal(np.asarray(trajectory.scene.x0), start.x)
        assert np.array_equal(start.xi, [0.1, 0.2, 0.4])


def test_trajectory_is_freed_without_garbage_collection(robot: System) -> None:
    """A repeated call creates no cycle of references, which would keep its memory."""
    simulate(robot, **START)
    gc.collect()
    gc.disable()
    try:
        trajectory = simulate(robot, **START)
        kept = weakref.ref(trajectory.motion)
        del trajectory
        assert kept() is None
    finally:
        gc.enable()
