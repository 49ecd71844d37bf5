"""Names in messages are shortened and stay on one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pinocchio as pin
import pytest
from commands import run

import pinred

LONG = "a\nb\t" + "x" * 100_000
ONE = pin.Inertia.FromSphere(1.0, 0.2)


def chain(*names: str) -> pin.Model:
    """A floating chain with joints of these names."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(joint, ONE, pin.SE3.Identity())
    for name in names:
        joint = model.addJoint(joint, pin.JointModelRZ(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, ONE, pin.SE3.Identity())
    return model


def cat(**options: Any) -> pinred.Scene:
    """A scene of the falling cat."""
    return pinred.Scene(system=pinred.load("falling_cat"), **options)


@pytest.mark.parametrize(
    "make",
    [
        lambda: pinred.load(LONG.replace("/", "")),
        lambda: pinred.load(f"{LONG[:120]}/gone.urdf"),
        lambda: pinred.load("falling_cat", lock=[LONG]),
        lambda: pinred.load("falling_cat", root=LONG),
        lambda: cat(x0={LONG: 1.0}),
        lambda: cat(forces=pinred.forces.Damper(LONG, 1.0)),
        lambda: cat(prescribed={LONG: 1.0}),
        lambda: cat(method=LONG),
        lambda: cat(method=LONG[4:]),
        lambda: cat(keyframe=LONG),
        lambda: pinred.load_scene(LONG[:3000]),
        lambda: pinred.read_recording(Path(LONG[:200])),
        lambda: pinred.Scene(system=pinred.load(chain(LONG, LONG[::-1])), x0={"knee": 1.0}),
    ],
)
def test_long_names_are_shortened_to_one_line(make: Callable[[], Any]) -> None:
    """Names of any length are cut."""
    with pytest.raises(pinred.PinredError) as caught:
        make()
    assert "\n" not in str(caught.value)
    assert "\t" not in str(caught.value)
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize(
    "words",
    [
        ("inspect", LONG),
        ("inspect", "falling_cat", "--lock", LONG),
        ("inspect", "falling_cat", "--at", LONG),
        ("compare", "falling_cat", "--springs", LONG),
        ("compare", "falling_cat", "--x0", f"{LONG}=1"),
        ("run", LONG),
        (LONG,),
    ],
)
def test_long_names_give_one_line_on_the_terminal(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """The line on standard error can be displayed by a terminal."""
    try:
        found: Any = run(capsys, *words)
    except SystemExit as end:  # the parser's
        found = (end.code, "", capsys.readouterr().err)
    code, _, err = found
    assert code == 2
    assert err.count("\n") == 1
    assert len(err) < 4200
