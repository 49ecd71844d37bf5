"""Input formats of a scene: Python, the command line and files accept the same ones."""

# ruff: noqa: E501 (a case a line)

from __future__ import annotations

from pathlib import Path
from typing import Any

import aba
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import Case, cases

import pinred
from pinred import DOP853, RKMK4, AdaptiveGauss, Gauss, Radau, Tsit5
from pinred.cli.command_line import _join_negative, _parser
from pinred.cli.command_options import scene_of
from pinred.common.arrays import Array
from pinred.integrators.methods import METHODS, Method
from pinred.scene import parse_options
from pinred.scene.scene import ENGINES, Engine
from pinred.signals import Constant, Expression
from pinred.simulation.plan import plan_of

CAT = pinred.load("falling_cat")
TURNED = "0,0,1,0,0,0.6,0.8"  # up by 1 m, and about z
Q, V = f"{TURNED},0.1,-0.2,0.3", "0.1,0.2,0.3,-0.4,0.5,0.6,-0.7,0.8,0.9"
PLAN = "0.4*(1 - cos(pi*t))"

# The same scene in Python, on the command line, and in a file.
SAME: dict[str, tuple[dict[str, Any], list[str], str]] = {
    "x0 in order": ({"x0": [-0.5, 0.0, 0.2]}, ["--x0", "-0.5,0,0.2"], "[start]\nx0 = [-0.5, 0, 0.2]"),
    "x0 by joint": ({"x0": {"twist": 0.2, "bend": -0.5}}, ["--x0", "twist=0.2,bend=-0.5"], "[start]\nx0 = { twist = 0.2, bend = -0.5 }"),
    "xdot0 by joint": ({"xdot0": {"sway": -1}}, ["--xdot0", "sway=-1"], "[start]\nxdot0 = { sway = -1 }"),
    "q0": ({"q0": np.array(Q.split(","), dtype=float)}, ["--q0", Q], f"[start]\nq0 = [{Q}]"),
    "v0": ({"v0": np.array(V.split(","), dtype=float)}, ["--v0", V], f"[start]\nv0 = [{V}]"),
    "q0 and momentum": ({"q0": np.array(Q.split(","), dtype=float), "momentum": 0}, ["--q0", Q, "--momentum", "0"], f"[start]\nq0 = [{Q}]\nmomentum = 0"),
    "formula": ({"prescribed": {"sway": PLAN}}, ["--prescribed", f"sway={PLAN}"], f"[prescribed]\nsway = '{PLAN}'"),
    "number": ({"prescribed": {"sway": -0.3}}, ["--prescribed", "sway=-0.3"], "[prescribed]\nsway = -0.3"),
    "two plans": ({"prescribed": {"sway": 0, "bend": "sin(t)"}}, ["--prescribed", "sway=0", "--prescribed", "bend=sin(t)"], "[prescribed]\nsway = 0\nbend = 'sin(t)'"),
    "method": ({"method": "DOP853"}, ["--method", "DOP853"], "[run]\nmethod = 'DOP853'"),
    "method as a table": ({"method": DOP853()}, ["--method", "DOP853()"], "[run]\nmethod = { name = 'DOP853' }"),
    "auto": ({"method": "auto"}, ["--method", "auto"], "[run]\nmethod = 'auto'"),
    "a step": ({"method": "RKMK4(0.01)"}, ["--method", "RKMK4", "--step", "0.01"], "[run]\nmethod = 'RKMK4(step=0.01)'"),
    "a step and an order": ({"method": Gauss(0.01, 8)}, ["--method", "Gauss(0.01, 8)"], "[run]\nmethod = { name = 'Gauss', step = 0.01, order = 8 }"),
    "text in text": ({"method": "Gauss(0.01, solver='Newton')"}, ["--method", 'Gauss(0.01, solver="Newton")'], "[run]\nmethod = 'Gauss(0.01, solver=\"Newton\")'"),
    "the scene's tolerances": ({"method": "Radau", "rtol": 1e-7}, ["--method", "Radau", "--rtol", "1e-7"], "[run]\nmethod = 'Radau'\nrtol = 1e-7"),
    "its own tolerances": ({"method": DOP853(rtol=1e-7)}, ["--method", "DOP853(1e-7)"], "[run]\nmethod = { name = 'DOP853', rtol = 1e-7 }"),
    "equal steps, judged by rtol": ({"method": "RKMK4(0.01)", "rtol": 1e-4}, ["--method", "RKMK4(0.01)", "--rtol", "1e-4"], "[run]\nmethod = 'RKMK4(0.01)'\nrtol = 1e-4"),
}  # fmt: skip


def told(scene: pinred.Scene) -> tuple[Any, ...]:
    """All that a scene says, in forms that can be compared."""
    start, model = scene.given, scene.force_model
    arrays = (start.pose, start.x, start.xdot, start.xi, start.mu, scene.report_times)
    return (
        tuple(None if array is None else array.tolist() for array in arrays),
        (scene.rtol, scene.atol, scene.integrator, plan_of(scene).method),
        None if model is None else (model.key, model.numbers.tolist()),
    )


@pytest.mark.parametrize("name", SAME)
@pytest.mark.sampled
def test_python_command_line_and_file_give_the_same_scene(name: str, tmp_path: Path) -> None:
    """One scene in three notations."""
    options, arguments, text = SAME[name]
    path = tmp_path / "scene.toml"
    path.write_text(f"robot = 'falling_cat'\n{text}\n", encoding="utf-8")
    words = _join_negative(["compare", "falling_cat", *arguments])
    wanted = told(pinred.Scene(system=CAT, **options))
    assert told(scene_of(_parser(words).parse_args(words))) == wanted
    assert told(pinred.load_scene(path)) == wanted
    assert wanted != told(pinred.Scene(system=CAT)) or name == "auto"


def configured(values: dict[str, float]) -> Array:
    """Pinocchio's q with joints at values, by Pinocchio's own index of each."""
    q = pin.neutral(CAT.model)
    for name, value in values.items():
        q[CAT.model.joints[CAT.model.getJointId(name)].idx_q] = value
    return np.asarray(q)


def test_values_by_joint_name_follow_pinocchio_order() -> None:
    """Shapes and rates by name; joints that are not named have zero."""
    traj = pinred.simulate(
        CAT, x0={"twist": 0.2, "bend": -0.5}, xdot0={"sway": 0.7}, times=[0.0, 0.1]
    )
    np.testing.assert_allclose(traj.q[0], configured({"twist": 0.2, "bend": -0.5}), atol=1e-15)
    moved = pin.difference(CAT.model, configured({}), configured({"sway": 0.7}))
    np.testing.assert_allclose(traj.v[0], moved, atol=1e-15)
    assert traj.scene.x0 is not None
    np.testing.assert_array_equal(np.asarray(traj.scene.x0), traj.x[0])
    still = pinred.simulate(CAT, x0={}, times=[0.0, 0.1])
    np.testing.assert_array_equal(still.q[0], configured({}))


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
@settings(max_examples=15)
@given(case=cases(1, 5))
@pytest.mark.sampled
def test_q0_and_v0_motion_agrees_with_aba(engine: Engine, case: Case) -> None:
    """A motion from (q0, v0) agrees with Pinocchio's ABA for every group."""
    model = case.system.model
    traj = pinred.simulate(case.system, q0=case.q, v0=case.v, times=[0.0, 0.05], engine=engine)
    assert aba.max_difference(model, traj.q[:1], case.q[None]) < 1e-12
    np.testing.assert_allclose(traj.v[0], case.v, atol=1e-10)
    q, v = aba.integrate(model, case.q, case.v, np.array([0.05]))
    assert aba.max_difference(model, traj.q[1:], q) < 1e-7
    np.testing.assert_allclose(traj.v[1:], v, atol=1e-6 * max(1.0, float(np.abs(v).max())))


@given(case=cases(1, 5), turns=st.integers(-3, 3))
def test_q0_angles_are_wrapped_for_continuous_joints_only(case: Case, turns: int) -> None:
    """Cosine and sine do not contain whole turns; other joints keep their angle."""
    x = case.x + 2 * np.pi * turns
    q = case.system.q(case.pose, x)
    found = pinred.Scene(system=case.system, q0=q).given.x[0]
    for k, joint in enumerate(list(case.system.model.joints)[2:]):
        if joint.nq == 2:
            assert -np.pi < found[k] <= np.pi
            assert abs(np.angle(np.exp(1j * (found[k] - x[k])))) < 1e-9
        else:
            assert found[k] == x[k]


def test_q0_half_a_turn_gives_plus_pi() -> None:
    """The angle is +π, whatever the sign of the zero in the sine."""
    chain = pinred.load("coupled_planar")
    assert chain.model.nq == 4 + 1 or chain.model.nq == 4 + 2
    for zero in (0.0, -0.0):
        q = pin.neutral(chain.model)
        q[2:4] = -1.0, zero
        if chain.model.nq == 6:
            q[4:6] = -1.0, zero
            assert pinred.Scene(system=chain, q0=q).given.x[0, 0] == np.pi
        assert pinred.Scene(system=chain, q0=q).given.pose[0, 2] == np.pi


def test_members_accept_values_by_joint_and_q0() -> None:
    """Batches accept {joint: (N,) values} and single numbers; q0 and v0 have a row per member."""
    bends, count = np.linspace(-0.5, 0.5, 4), 4
    named = pinred.simulate_many(
        CAT, x0={"bend": bends, "sway": 0.1}, xdot0={"twist": 1.0}, times=[0.3]
    )
    q0 = np.array([configured({"bend": bend, "sway": 0.1}) for bend in bends])
    v0 = np.array(
        [
            pin.difference(
                CAT.model, q0[0], configured({"bend": bends[0], "sway": 0.1, "twist": 1.0})
            )
        ]
        * count
    )
    rows = pinred.simulate_many(CAT, q0=q0, v0=v0, times=[0.3])
    for k in range(count):
        q, v = aba.integrate(CAT.model, q0[k], v0[k], np.array([0.3]))
        for many in (named, rows):
            assert aba.max_difference(CAT.model, many[k].q, q) < 1e-8
            np.testing.assert_allclose(many[k].v, v, atol=1e-7)
    common = pinred.simulate_many(CAT, q0=q0[0], v0=v0, times=[0.3])
    np.testing.assert_array_equal(common[3].q, rows[0].q)


MANY_WRONG: list[tuple[dict[str, Any], str]] = [
    ({"x0": {"bend": [0.1, 0.2], "sway": [0.1, 0.2, 0.3]}}, r"x0 must have a number for each joint, or as many .* got shapes \(2,\), \(3,\)"),
    ({"x0": {"bend": [[0.1]]}}, "x0 must have a number for each joint"),
    ({"x0": {"bent": [0.1, 0.2]}}, "x0: no shape joint 'bent'; did you mean 'bend'"),
    ({"x0": {"bend": 0.1}}, "at least one of x0, xdot0, xi0, momentum, pose0, q0, v0, gravity, a number of a stop or a parameter must"),
    ({"q0": np.zeros((2, 10))}, "q0: the quaternion of a pose of SE3 must have norm 1, got 0"),
    ({"q0": np.zeros((2, 3))}, r"q0 must have shape \(10,\), got \(3,\)"),
    ({"q0": np.stack([configured({})] * 2), "x0": {"bend": 1.0}}, "q0 sets shape and pose; do not combine it with x0"),
    ({"q0": np.stack([configured({}), 2 * configured({})])}, "q0: the quaternion of a pose of SE3 must have norm 1, got 2"),
    ({"v0": np.stack([np.zeros(9), np.full(9, np.nan)])}, "v0 must be finite"),
]  # fmt: skip


@pytest.mark.parametrize(("options", "words"), MANY_WRONG)
def test_invalid_state_of_any_member_is_refused(options: dict[str, Any], words: str) -> None:
    """The state of every member is validated."""
    with pytest.raises(pinred.InputError, match=words):
        pinred.simulate_many(CAT, **options, invalid="raise")


JOINTS = "the joints are bend, sway, twist"
WRONG: list[tuple[dict[str, Any], str]] = [
    ({"x0": {"bent": 1.0}}, f"x0: no shape joint 'bent'; did you mean 'bend'? {JOINTS}"),
    ({"xdot0": {"knee": 1.0}}, f"xdot0: no shape joint 'knee'; {JOINTS}"),
    ({"x0": {0: 1.0}}, "expected text, got 0"),
    ({"x0": {"bend": "far"}}, "x0['bend'] must be numbers, got 'far'"),
    ({"x0": {"bend": np.nan}}, "x0 must be finite, but entry 0 (bend) is nan"),
    ({"x0": {"bend": [0.1, 0.2]}}, "x0: expected 3 numbers: bend, sway, twist, got shape (2, 3)"),
    ({"prescribed": {"knee": 0.0}}, f"prescribed: no shape joint 'knee'; {JOINTS}"),
    ({"q0": [0.0, 1.0]}, "q0 must have shape (10,), got (2,)"),
    ({"q0": np.full(10, np.nan)}, "q0 must be finite"),
    ({"q0": 2 * configured({})}, "q0: the quaternion of a pose of SE3 must have norm 1, got 2"),
    ({"v0": [0.0]}, "v0 must have shape (9,), got (1,)"),
    ({"q0": configured({}), "x0": [0, 0, 0]}, "q0 sets shape and pose; do not combine it with x0"),
    ({"q0": configured({}), "pose0": np.eye(4)}, "q0 sets shape and pose; do not combine it with pose0"),
    ({"v0": np.zeros(9), "xdot0": {"bend": 1}}, "v0 sets shape rate and body twist; do not combine it with xdot0"),
    ({"v0": np.zeros(9), "xi0": np.zeros(6)}, "v0 sets shape rate and body twist; do not combine it with xi0"),
    ({"v0": np.zeros(9), "momentum": 0}, "v0 sets shape rate and body twist; do not combine it with momentum"),
    ({"seed": 1, "q0": configured({})}, "seed sets a whole random state; do not combine it with q0"),
    ({"seed": 1, "v0": np.zeros(9)}, "seed sets a whole random state; do not combine it with v0"),
    ({"method": "RKMK4"}, "method 'RKMK4' needs a step, as in RKMK4(0.01)"),
    ({"method": "Gauss(order=4)"}, "method 'Gauss(order=4)' needs a step, as in Gauss(0.01)"),
    ({"method": "dop853"}, "unknown method 'dop853'; the methods are AdaptiveGauss, DOP853,"),
    ({"method": "DOP583"}, "unknown method 'DOP583'; did you mean 'DOP853'? the methods are AdaptiveGauss, DOP853,"),
    ({"method": "RKMK4(0)"}, "step must be finite and above zero, got 0"),
    ({"method": "RKMK4(nan)"}, "step must be finite and above zero, got nan"),
    ({"method": "RKMK4(0.1, 4)"}, "method RKMK4 has no 2 options; its options are step"),
    ({"method": "RKMK4(order=4)"}, "method RKMK4 has no option 'order'; its options are step"),
    ({"method": "RKMK4(0.1, step=0.1)"}, "sets step twice"),
    ({"method": "Gauss(0.1, 5)"}, "order must be one of 2"),
    ({"method": "auto(1)"}, "method auto has no options, got 'auto(1)'"),
    ({"method": ""}, "must be a name, or a name with options such as RKMK4(0.01); the methods are"),
    ({"method": "RKMK4(0.01"}, "must be a name, or a name with options"),
    ({"method": "RKMK4(1/100)"}, "must be a name, or a name with options"),
    ({"method": "RKMK4(*[0.1])"}, "must be a name, or a name with options"),
    ({"method": "__import__('os').system('true')"}, "must be a name, or a name with options"),
    ({"method": "(" * 5000}, "must be a name, or a name with options"),
    ({"method": "RKMK4(0.1)\0"}, "must be a name, or a name with options"),
    ({"method": 8}, "method must be 'auto' or AdaptiveGauss(…) or DOP853(…)"),
    ({"method": DOP853}, "method must be 'auto' or AdaptiveGauss(…) or DOP853(…)"),
    ({"rtol": 1e-8, "method": DOP853(rtol=1e-6)}, "rtol conflicts with the tolerances of the method DOP853(rtol=1e-06"),
    ({"atol": 1e-8, "method": "Radau(1e-6)"}, "atol conflicts with the tolerances of the method Radau(rtol=1e-06"),
    ({"rtol": 1e-10, "method": AdaptiveGauss(atol=1e-6)}, "rtol conflicts with the tolerances of the method"),
]  # fmt: skip


@pytest.mark.parametrize(("options", "words"), WRONG)
def test_invalid_format_is_refused_with_valid_formats(options: dict[str, Any], words: str) -> None:
    """The message shows the value and the accepted formats."""
    with pytest.raises(pinred.InputError) as caught:
        pinred.Scene(system=CAT, **options)
    assert words in str(caught.value)


def test_q0_cosine_and_sine_need_norm_one() -> None:
    """The message names the continuous joint."""
    wheel = pinred.load("reaction_wheel_satellite")
    q = pin.neutral(wheel.model)
    names = [
        n for n, j in zip(wheel.shape_names, list(wheel.model.joints)[2:], strict=True) if j.nq == 2
    ]
    index = wheel.model.joints[wheel.model.getJointId(names[-1])].idx_q
    q[index : index + 2] = 0.6, 0.9
    with pytest.raises(
        pinred.InputError, match=f"q0: cosine and sine of joint '{names[-1]}' must have norm 1"
    ):
        pinred.Scene(system=wheel, q0=q)
    q[index : index + 2] = 0.6, 0.8
    assert pinred.Scene(system=wheel, q0=q).given.x[0].max() == pytest.approx(np.arctan2(0.8, 0.6))


METHOD_VALUES = st.sampled_from(
    [
        DOP853(),
        DOP853(1e-7, max_step=0.1),
        AdaptiveGauss(max_steps=7),
        Radau(atol=1e-3),
        RKMK4(0.01),
        Gauss(0.3, 16, "Newton"),
    ]
)


@given(METHOD_VALUES)
def test_repr_of_method_parses_to_the_method(method: Method) -> None:
    """The repr of a method is accepted as text."""
    assert parse_options.parse_method(repr(method)) == method


@given(
    st.text(max_size=20)
    | st.sampled_from(list(METHODS)).flatmap(
        lambda name: st.text(max_size=12).map(lambda rest: f"{name}({rest})")
    )
)
def test_random_method_text_is_parsed_or_refused(text: str) -> None:
    """No other error than a pinred error occurs."""
    try:
        found = parse_options.parse_method(text)
    except pinred.InputError:
        return
    assert found == "auto" or isinstance(found, Method)


@pytest.mark.parametrize("name", METHODS)
def test_method_name_alone_suffices_for_step_control(name: str) -> None:
    """Methods with equal steps also need a step."""
    kind: Any = METHODS[name]
    if kind.adaptive:
        assert parse_options.parse_method(name) == kind()
    else:
        assert parse_options.parse_method(f"{name}(0.25)") == kind(0.25)
        assert parse_options.parse_method(f" {name}( step = 0.25 ) ") == kind(step=0.25)


@pytest.mark.parametrize("kind", [DOP853, AdaptiveGauss, Radau, Tsit5])
def test_method_tolerances_replace_scene_tolerances(kind: Any) -> None:
    """A method without tolerances uses the scene's; a method with tolerances keeps them."""

    def integrator(**options: Any) -> Any:
        return pinred.Scene(system=CAT, **options).integrator

    for method in (kind(), kind.__name__, kind(max_steps=99)):
        for options, wanted in (
            ({}, (1e-11, 1e-13)),
            ({"rtol": 1e-6}, (1e-7, 1e-13)),
            ({"rtol": 1e-5, "atol": 1e-8}, (1e-6, 1e-9)),
        ):
            found = integrator(method=method, **options)
            assert (found.rtol, found.atol) == pytest.approx(wanted, rel=1e-12, abs=0.0)
            assert found.max_steps == (
                99 if not isinstance(method, str) and method.max_steps == 99 else 10**6
            )
    own = kind(1e-6, 1e-9)
    assert integrator(method=own) is own
    assert integrator(method=kind(rtol=1e-6)) == kind(1e-6, kind().atol)
    # What nobody gave stays so: a scene that is changed is checked as if built anew.
    scene = pinred.Scene(system=CAT, method=kind())
    traj = pinred.simulate(scene, rtol=1e-6, duration=0.01)
    integrated: Any = plan_of(traj.scene).method
    assert integrated.rtol == pytest.approx(1e-7, rel=1e-12, abs=0.0)
    pinred.simulate(pinred.Scene(system=CAT), method=own, duration=0.01)
    with pytest.raises(pinred.InputError, match="rtol conflicts with the tolerances"):
        pinred.simulate(scene, method=own, rtol=1e-10)


def test_error_follows_rtol_of_the_scene() -> None:
    """The error against ABA follows rtol over five decades, for a method by name."""
    q0, v0 = configured({"bend": 0.5}), np.array(V.split(","), dtype=float)
    q, _ = aba.integrate(CAT.model, q0, v0, np.array([1.0]))
    for rtol in (1e-5, 1e-7, 1e-9):
        traj = pinred.simulate(
            CAT, q0=q0, v0=v0, times=[1.0], method="DOP853", rtol=rtol, atol=0.01 * rtol
        )
        assert 1e-4 * rtol < aba.max_difference(CAT.model, traj.q, q) < 10 * rtol


def test_tightest_tolerance_is_accepted_by_all_methods() -> None:
    """Round-off limits Runge–Kutta methods; 'auto' accepts the same tolerance."""
    for name, least in (
        ("DOP853", 2.3e-14),
        ("Radau", 2.3e-14),
        ("Tsit5", 2.3e-14),
        ("AdaptiveGauss", 1e-15),
    ):
        found: Any = pinred.Scene(system=CAT, method=name, rtol=1e-14).integrator
        assert found.rtol == pytest.approx(least, rel=1e-12, abs=0.0)


def test_rtol_sets_only_the_comparison_for_equal_steps() -> None:
    """With equal steps, rtol changes only the comparison."""
    coarse: dict[str, Any] = {"duration": 1.0, "method": "RKMK4(0.02)"}
    strict = pinred.simulate(CAT, **coarse)
    loose = pinred.simulate(CAT, **coarse, rtol=1e-5)
    np.testing.assert_array_equal(strict.q, loose.q)
    assert not pinred.compare(strict).passed
    assert pinred.compare(loose).passed


@pytest.mark.slow
def test_prescribed_numbers_and_formulas_become_signals() -> None:
    """The joint follows the formula, evaluated by NumPy."""
    traj = pinred.simulate(CAT, duration=0.7, prescribed={"sway": PLAN, "bend": np.float64(0.25)})
    np.testing.assert_allclose(traj.x[:, 1], 0.4 * (1 - np.cos(np.pi * traj.t)), atol=1e-13)
    np.testing.assert_allclose(traj.xdot[:, 1], 0.4 * np.pi * np.sin(np.pi * traj.t), atol=1e-12)
    np.testing.assert_array_equal(traj.x[:, 0], 0.25)
    assert traj.scene.prescribed == {"sway": Expression(PLAN), "bend": Constant(0.25)}
    assert pinred.compare(traj).passed
    # What is equal is written down once.
    again = pinred.Scene(system=CAT, duration=0.7, prescribed={"sway": PLAN, "bend": 0.25})
    assert again.force_model is traj.scene.force_model
