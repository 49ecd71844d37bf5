"""Forces on ball joints in scene files: the same expressions and numbers as in Python."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import pinred
from pinred import InputError, PinredError
from pinred.forces import BallLimit, BallPD, BallSpring, Damper, Force, Limit, PotentialEnergy
from pinred.scene.toml.value_tables import FORCES
from pinred.signals import Attitude

MATRIX = [[3.0, 0.4, -0.2], [0.4, 2.0, 0.3], [-0.2, 0.3, 1.5]]
KINDS = {"ball_spring", "ball_pd", "ball_limit"}
CASES: dict[str, tuple[str, Callable[[], Force]]] = {
    "spring": (
        "kind = 'ball_spring'\njoint = 'hips'\nstiffness = 2",
        lambda: BallSpring("hips", 2.0),
    ),
    "spring with powers, rest as rotation vector": (
        "kind = 'ball_spring'\njoint = 'hips'\nstiffness = 2\nrest = [0.1, -0.2, 0.3]\n"
        "polynomial = [0.3, 0.1]",
        lambda: BallSpring("hips", 2.0, (0.1, -0.2, 0.3), polynomial=(0.3, 0.1)),
    ),
    "spring with matrix, rest as quaternion": (
        f"kind = 'ball_spring'\njoint = 'hips'\nstiffness = {MATRIX}\nrest = [0, 0, 1, 1]\n"
        "law = 'trace'",
        lambda: BallSpring("hips", np.array(MATRIX), (0, 0, 1, 1), law="trace"),
    ),
    "cosine": (
        "kind = 'ball_spring'\njoint = 'hips'\nstiffness = 2\nlaw = 'cosine'",
        lambda: BallSpring("hips", 2.0, law="cosine"),
    ),
    "pd": (
        "kind = 'ball_pd'\nname = 'hold'\njoint = 'hips'\nattitude = [0.1, 0, 0.4]\nkp = 3\n"
        "kd = 0.5\nlimit = 0.2\nsmooth = true",
        lambda: BallPD("hips", (0.1, 0, 0.4), 3.0, 0.5, Limit(0.2, smooth=True), name="hold"),
    ),
    "pd of a moving attitude": (
        "kind = 'ball_pd'\njoint = 'hips'\nattitude = ['0.3*sin(t)', 0, 0.1]\nkp = 3\nkd = 0.5",
        lambda: BallPD("hips", ["0.3*sin(t)", 0.0, 0.1], 3.0, 0.5),
    ),
    "pd of an attitude about a centre": (
        "kind = 'ball_pd'\njoint = 'hips'\nkp = 3\nkd = 0.5\n"
        "attitude = { attitude = { vector = ['t', 0, 0], centre = [0, 0, 0.5] } }",
        lambda: BallPD("hips", Attitude(["t", 0, 0], (0, 0, 0.5)), 3.0, 0.5),
    ),
    "limit": (
        "kind = 'ball_limit'\njoint = 'hips'\nswing = 0.8\ntwist = 0.5\naxis = 'x'\n"
        "stiffness = 20\nwidth = 0.1",
        lambda: BallLimit("hips", 0.8, 0.5, "x", 20.0, 0.1),
    ),
    "damper of an axis": (
        "kind = 'damper'\njoint = 'hips.y'\ncoefficient = 0.3",
        lambda: Damper("hips.y", 0.3),
    ),
    "potential of a quaternion": (
        "kind = 'potential'\nfunction = \"2*x['hips.qx']**2\"",
        lambda: PotentialEnergy(lambda x: 2.0 * x["hips.qx"] ** 2),
    ),
}  # fmt: skip


def in_file(folder: Path, text: str) -> Path:
    """Write a scene of the diver with one force, and return its path."""
    path = folder / "scene.toml"
    path.write_text(f"robot = 'diver'\n[[forces]]\n{text}\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("kind", CASES)
def test_force_on_ball_from_file_equals_python(kind: str, tmp_path: Path) -> None:
    """Expressions and numbers of the force model, and the name, agree exactly."""
    text, make = CASES[kind]
    model = pinred.load_scene(in_file(tmp_path, text)).force_model
    expected = pinred.Scene(system=pinred.load("diver"), forces=make()).force_model
    assert model is not None
    assert expected is not None
    assert (model.key, model.numbers.tolist()) == (expected.key, expected.numbers.tolist())
    assert model.labels == expected.labels


def test_cases_cover_every_kind_of_force_on_balls() -> None:
    """Each kind has a case above."""
    kinds = {text.split("\n")[0].split("=")[1].strip(" '") for text, _ in CASES.values()}
    assert kinds >= KINDS
    assert {name for name in FORCES if name.startswith("ball")} == KINDS


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("kind = 'ball_spring'\njoint = 'hip'\nstiffness = 1",
         "line 4: forces.0..joint: unknown joint \"hip\"; did you mean 'hips'"),
        ("kind = 'ball_spring'\njoint = 'hips'\nstiffness = 1\nrest = [0, 1]",
         "forces.0.: rest of a spring hips: expected a rotation vector of 3"),
        ("kind = 'ball_spring'\njoint = 'hips'\nstiffness = [[1, 0, 0]]",
         "forces.0..stiffness: must be a list of 3 entries"),
        ("kind = 'ball_spring'\njoint = 'hips'\nstiffness = 1\nlaw = 'hooke'",
         "forces.0..law: unknown value \"hooke\"; it can be angle, cosine"),
        ("kind = 'ball_pd'\njoint = 'hips'\nkp = 1\nkd = 0",
         "forces.0.: 'attitude' is missing: desired attitude"),
        ("kind = 'ball_pd'\njoint = 'knees'\nattitude = [0, 0, 0]\nkp = 1\nkd = 0",
         "knees"),
        ("kind = 'ball_limit'\njoint = 'hips'", "forces.0.: ball limit: give swing, twist, or"),
        ("kind = 'ball_limit'\njoint = 'hips'\nswing = 4",
         "forces.0.: swing of ball limit: expected an angle between 0 and π, got 4.0"),
    ],
)  # fmt: skip
def test_invalid_force_on_ball_in_file_is_refused(tmp_path: Path, text: str, message: str) -> None:
    """The message names the place in the file, and what is expected there."""
    with pytest.raises((InputError, PinredError), match=message):
        pinred.load_scene(in_file(tmp_path, text))
