"""Every public function and command with joint stops: it works, or refuses by name."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinred
from pinred.cli.command_line import main

TEXT = """robot = "falling_cat"
[start]
xdot0 = [3.0, -2.0, 1.0]
[run]
duration = 0.5
[stops]
bend = [-0.6, 0.6]
sway = [-0.5, 0.5, 0.6]
"""
CAT = pinred.load("falling_cat")
STOPS: dict[str, Any] = {"bend": (-0.6, 0.6), "sway": pinred.Stop(-0.5, 0.5, 0.6)}
SCENE = pinred.Scene(system=CAT, stops=STOPS, xdot0=[3.0, -2.0, 1.0], duration=0.5)
RATES = {"xdot0": np.array([[3.0, -2.0, 1.0], [2.0, 1.0, 1.0]])}
ANY = pinred.InputError
Call = Callable[[pinred.Trajectory, Path], object]

CALLS: dict[str, Call] = {
    "simulate": lambda traj, _: pinred.simulate(traj.scene, check=True),
    "simulate_many": lambda *_: pinred.simulate_many(SCENE, members=RATES),
    "sweep": lambda *_: pinred.sweep(SCENE, {"sway.stop.upper": pinred.Values([0.4, 0.5])}),
    "compare": lambda traj, _: pinred.compare(traj),
    "flow": lambda *_: pinred.flow(SCENE, wrt=["xdot0"]).jacobian(),
    "release": lambda traj, _: pinred.release(traj, "back"),
    "land": lambda traj, _: pinred.land(traj, "back"),
    "chain": lambda traj, _: pinred.chain(traj),
    "plot": lambda traj, _: pinred.plot(traj, "energy"),
    "save_html": lambda traj, folder: pinred.save_html(traj, folder / "motion.html", ghost=True),
    "save_film": lambda traj, folder: pinred.save_film(traj, folder / "a.gif", size=(64, 48)),
    "save": lambda traj, folder: traj.save(folder / "motion.npz"),
    "load_scene": lambda _, folder: pinred.simulate(pinred.load_scene(folder / "scene.toml")),
}
# Functions of a system or another object, which has no stops.
WITHOUT_STOPS = {
    "branches", "casadi_functions", "corrected_integral", "extremal", "feel", "flatness",
    "follow_mixed", "inspect", "mixed_connection", "optimal_frame", "optimise_gait", "phase",
    "phase_slopes", "relative_equilibria", "reorient", "rigid_body_phase", "simulate_mixed",
}  # fmt: skip
ELSEWHERE = {
    "capture": "tests/simulation/contact", "play": "as save_html", "save_rrd": "as save_html",
    "simulate_chain": "tests/simulation/contact", "floquet": "tests/analysis",
}  # fmt: skip
REFUSED: dict[str, tuple[Call, str]] = {
    "linearise": (lambda traj, _: pinred.linearise(traj), "stops: only simulate.*take stops. Omit"),
    "lyapunov": (lambda traj, _: pinred.lyapunov(traj), "stops: only simulate.*take stops. Omit"),
    "Gauss": (lambda *_: pinred.simulate(SCENE, method="Gauss(0.01, 4)"), "Gauss4.*Use DOP853"),
    "RKMK4": (lambda *_: pinred.simulate(SCENE, method="RKMK4(0.01)"), "RKMK4.*Use DOP853"),
    "Variational": (
        lambda *_: pinred.simulate(SCENE, method="Variational(0.01)"), "Variational.*Use DOP853",
    ),
    "step": (lambda *_: pinred.flow(SCENE).step(0.01).linear(SCENE.start), "stops: a single step"),
    "cuda": (lambda *_: pinred.simulate_many(SCENE, members=RATES, device="cuda"), "Omit device"),
}  # fmt: skip


@pytest.fixture(scope="module", name="traj")
def _traj() -> pinred.Trajectory:
    """Return a motion with two impacts."""
    return pinred.simulate(SCENE)


@pytest.mark.parametrize("name", CALLS)
def test_calls_take_stops(name: str, traj: pinred.Trajectory, tmp_path: Path) -> None:
    """These functions take scenes and motions with stops."""
    (tmp_path / "scene.toml").write_text(TEXT, "utf-8")
    assert len(traj.impacts) == 2
    CALLS[name](traj, tmp_path)


@pytest.mark.parametrize("name", REFUSED)
def test_calls_refuse_stops_by_name(name: str, traj: pinred.Trajectory, tmp_path: Path) -> None:
    """These functions name stops and a remedy."""
    call, message = REFUSED[name]
    with pytest.raises(ANY, match=rf"(?s){message}"):
        call(traj, tmp_path)


def test_all_public_functions_are_in_the_tables() -> None:
    """A new function that takes a system, a scene or a motion needs a row here."""
    names = {"system", "scene", "traj", "source", "connection", "a", "whole"}
    functions = {
        name: value for name in dir(pinred) if inspect.isfunction(value := getattr(pinred, name))
    }
    taking = {n for n, f in functions.items() if names & set(inspect.signature(f).parameters)}
    listed = {*CALLS, *REFUSED, *WITHOUT_STOPS, *ELSEWHERE}
    assert taking - listed - {"load", "read_recording"} == set()
    assert {n for n in listed if n in dir(pinred)} - set(functions) - {"Gauss", "RKMK4"} <= {
        "Variational"
    }


@pytest.mark.parametrize(
    ("command", "code"),
    [
        (["simulate", "falling_cat", "--xdot0", "3,-2,1", "--duration", "0.3", "--stops",
          "bend=-0.6,0.6", "--check-steps", "--checkpoint", "FOLDER/a.ckpt", "--out",
          "FOLDER/a.npz"], 0),
        (["compare", "falling_cat", "--xdot0", "3,-2,1", "--duration", "0.3", "--stops",
          "bend=-0.6,0.6"], 0),
        (["run", "FOLDER/scene.toml"], 0),
        (["plot", "FOLDER/scene.toml", "--out", "FOLDER/a.png"], 0),
        (["play", "FOLDER/scene.toml", "--out", "FOLDER/a.html"], 0),
        (["release", "FOLDER/scene.toml", "--link", "back"], 0),
        (["land", "FOLDER/scene.toml", "--frame", "back"], 0),
        (["simulate", "falling_cat", "--stops", "bend=-0.6,0.6", "--method", "Gauss(0.01,4)",
          "--out", "FOLDER/a.npz"], 2),
    ],
)  # fmt: skip
def test_commands_take_stops_or_refuse_them(command: list[str], code: int, tmp_path: Path) -> None:
    """Exit codes of the commands that take stops."""
    (tmp_path / "scene.toml").write_text(TEXT, "utf-8")
    assert main([part.replace("FOLDER", str(tmp_path)) for part in command]) == code


def test_arguments_have_no_stops_where_systems_are_expected() -> None:
    """Functions of systems name the type that they expect."""
    calls: list[Callable[[Any], object]] = [
        pinred.Reduction, pinred.inspect, pinred.casadi_functions,
        lambda scene: pinred.relative_equilibria(scene, momentum=1.0),
        lambda scene: pinred.branches(scene, momentum=(0.5, 1.0)),
    ]  # fmt: skip
    for call in calls:
        with pytest.raises(ANY, match="a System, got Scene"):
            call(SCENE)
