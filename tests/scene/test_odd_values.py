"""Values of unusual types and sizes: a pinred error names the option and the fix."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import run
from robot_texts import FLOATING, write

import pinred
from pinred.forces import PotentialEnergy, Torque
from pinred.scene.initial_state import large_angles

HUGE = 10**400


def _any(name: str, value: Any) -> Any:
    return {name: value}


@pytest.fixture(scope="module")
def cat() -> pinred.System:
    """A robot with three joints."""
    return pinred.load("falling_cat")


@pytest.mark.parametrize("odd", [np.arange(4.0), np.array(["a", "b"]), ["all"], HUGE, b"x"])
@pytest.mark.parametrize("name", ["outputs", "method", "engine", "forces", "keyframe"])
def test_value_in_place_of_text_is_refused(name: str, odd: Any, cat: pinred.System) -> None:
    """Arrays, lists and numbers are refused in a line that names the option."""
    with pytest.raises(pinred.InputError, match=name) as caught:
        pinred.simulate(cat, duration=0.1, **{name: odd})
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize(
    "name", ["x0", "xdot0", "xi0", "momentum", "pose0", "q0", "v0", "times", "rtol", "duration"]
)
def test_number_beyond_float_range_is_refused(name: str, cat: pinred.System) -> None:
    """10**400 is refused, and the message names the option."""
    for value in (HUGE, [HUGE], -HUGE):
        with pytest.raises(pinred.InputError):
            pinred.Scene(system=cat, **_any(name, value))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"method": "RK5"}, "unknown method 'RK5'"),
        ({"method": "RKMK4"}, "needs a step"),
        ({"pose0": [1.0, 2.0]}, "pose"),
        ({"forces": "gravity"}, "forces must be a list"),
        ({"forces": [Torque({"knee": 1.0})]}, "knee"),
        ({"springs": {"knee": (1.0, 0.0)}}, "knee"),
        ({"prescribed": {"knee": 0.0}}, "knee"),
        ({"events": 3}, "events"),
        ({"parameters": {"knee.mass": 1.0}}, "knee"),
        ({"outputs": "none"}, "outputs must be one of"),
        ({"times": [1.0, 0.0]}, "times must increase"),
        ({"rtol": -1.0}, "rtol"),
        ({}, "has no default initial state"),
    ],
)
def test_wrong_option_is_reported_before_missing_state(
    options: dict[str, Any], words: str, tmp_path: Path
) -> None:
    """The file states no initial state, which is reported only if every option is right."""
    with pytest.raises(pinred.InputError) as caught:
        pinred.simulate(pinred.load(write(tmp_path, FLOATING)), **options)
    assert words in str(caught.value)


@pytest.mark.parametrize("odd", [True, np.array(True), np.timedelta64(3, "s")])
@pytest.mark.parametrize("name", ["momentum", "xdot0", "x0", "rtol", "duration", "parameters"])
def test_bool_and_timedelta_are_refused_as_numbers(name: str, odd: Any, cat: pinred.System) -> None:
    """True is not a mass of 1 kg, and a timedelta is not a duration."""
    given = {"parameters": {"front.mass": odd}, "x0": [odd] * cat.m, "xdot0": [odd] * cat.m}
    with pytest.raises(pinred.InputError, match=r"must be (numbers|a number)"):
        pinred.Scene(system=cat, **_any(name, given.get(name, odd)))


@pytest.mark.parametrize(
    "seeds", [3, [1.5], ["a"], [[1]], [-1], "12", {1: 2}, [[1, 2], [3]], [True]]
)
def test_seeds_must_be_a_list_of_whole_numbers(seeds: Any, cat: pinred.System) -> None:
    """Other seeds are refused."""
    with pytest.raises(pinred.InputError, match=r"seeds? must be a"):
        pinred.simulate_many(cat, seeds=seeds, duration=0.1)


@pytest.mark.parametrize("lock", [np.array(3), 3, {"bend": HUGE}, {"bend": [1, 2]}, [1]])
def test_locks_must_be_names_or_values_by_name(lock: Any) -> None:
    """Other locks are refused."""
    with pytest.raises(pinred.InputError, match="lock"):
        pinred.load("falling_cat", lock=lock)


def test_invalid_roots_and_meshes_are_refused() -> None:
    """Random inputs detected these cases."""
    given: Any = ({"root": 3}, {"root": [1]}, {"meshes": np.array(1.0)}, {"meshes": "x" * 3000})
    for options in given:
        with pytest.raises(pinred.InputError, match=next(iter(options))):
            pinred.load("falling_cat", **options)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda t, *_: {"bend": 1.0 if t < 0.5 else 0.0}, "truth value"),
        (lambda t, *_: {"bend": math.sin(t)}, "got nan"),
        (lambda t, *_: {"bend": np.sin(t)}, "a function of NumPy"),
        (lambda t, *_: {"bend": math.sin(t) * t}, "is NaN at all times"),
        (lambda _t, x, *_: {"bend": x[7]}, "out of bounds"),
    ],
)
def test_python_branch_in_force_names_casadi_replacement(
    function: Any, message: str, cat: pinred.System
) -> None:
    """The error names the CasADi function; nothing else is printed."""
    with pytest.raises(pinred.InputError, match=message) as caught:
        pinred.Scene(system=cat, forces=Torque(function))
    assert "casadi.if_else" in str(caught.value)
    assert "casadi.sin" in str(caught.value)
    assert str(caught.value).count("\n") == 0


def test_potential_with_math_or_unknown_joint_is_refused(cat: pinred.System) -> None:
    """Unknown joints have a separate error message."""
    with pytest.raises(pinred.InputError, match=r"casadi\.sin"):
        pinred.Scene(system=cat, forces=PotentialEnergy(lambda x: math.cos(x[0])))
    with pytest.raises(pinred.InputError, match="no shape joint 'bendd'; did you mean 'bend'"):
        pinred.Scene(system=cat, forces=Torque(lambda _t, x, *_: {"bend": x["bendd"]}))


def test_huge_angle_is_refused(cat: pinred.System) -> None:
    """1e15 rad has a resolution of 0.1 rad; a million turns are accepted."""
    with pytest.raises(
        pinred.InputError, match=r"'bend', 1e\+15 rad, is only accurate to 0\.1 rad"
    ):
        pinred.Scene(system=cat, x0=[1e15, 0, 0])
    with pytest.raises(pinred.InputError, match="only accurate to"):
        pinred.simulate_many(
            cat, x0=np.array([[0, 0, 0], [0, 0, 1e15]]), duration=0.1, invalid="raise"
        )
    assert pinred.Scene(system=cat, x0=[1e6, 0, 0]).start.x[0] == 1e6


def test_angle_above_a_turn_prints_a_note(
    cat: pinred.System, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command line and explain show the value in degrees."""
    note = "note: joint 'bend' begins at 90 rad, 14.3 turns; in degrees that would be 1.571 rad"
    assert f"note: {large_angles(np.array([90.0, 0, 0]), cat)}" == note
    code, out, _ = run(
        capsys,
        "compare",
        "falling_cat",
        "--x0",
        "bend=90",
        "--momentum",
        "0",
        "--xdot0",
        "1,2,3",
        "--duration",
        "0.01",
    )
    assert (code, note in out) == (0, True)
    pinred.simulate(cat, x0=[90.0, 0, 0], duration=0.01, explain=True)
    assert note in capsys.readouterr().out
    pinred.simulate(cat, x0=[6.0, 0, 0], duration=0.01, explain=True)
    assert "note:" not in capsys.readouterr().out


def test_far_too_long_equal_steps_raise_an_error(cat: pinred.System) -> None:
    """Three long steps would give an energy of 1e27 J."""
    with pytest.raises(pinred.IntegrationError, match=r"rotates by .* rad within one step of 1 s"):
        pinred.simulate(cat, method="RKMK4(1.0)", duration=3.0)
    assert pinred.simulate(cat, method="RKMK4(0.01)", duration=0.1).run.steps == 10
    assert cat.initial is not None
    start: dict[str, Any] = {
        "x0": [cat.initial.x] * 2,
        "xdot0": cat.initial.xdot,
        "xi0": cat.initial.xi,
    }
    many = pinred.simulate_many(cat, **start, method="RKMK4(1.0)", duration=3.0)
    assert [failure.member for failure in many.failures] == [0, 1]
    assert "cannot resolve" in many.failures[0].reason
    with pytest.raises(pinred.IntegrationError, match=r"rotates by .* rad within one step of 1 s"):
        many[0]
    assert not pinred.simulate_many(cat, seeds=[0], method="RKMK4(0.01)", duration=0.1).failures


@pytest.mark.parametrize("mass", [1e-30, 1e-40])
def test_extreme_units_are_reported_as_ill_scaled(mass: float, tmp_path: Path) -> None:
    """The message names the cure."""
    text = FLOATING.replace('mass value="2.0"', f'mass value="{2 * mass}"').replace(
        'ixx="1" iyy="2" izz="2.5"', f'ixx="{mass}" iyy="{2 * mass}" izz="{2.5 * mass}"'
    )
    system = pinred.load(write(tmp_path, text))
    with pytest.raises(pinred.ModelError, match=r"ill-scaled: it has masses .* write it in units"):
        pinred.simulate(system, x0=[0.1], xdot0=[1.0], xi0=[0, 0, 0, 0.1, 0.2, 0.3], duration=0.1)
