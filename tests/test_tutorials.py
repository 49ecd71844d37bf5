"""The tutorials run as a student would run them, and their numbers are those of other routes."""

from __future__ import annotations

import os
import re
import runpy
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import nbformat
import numpy as np
import pinocchio as pin
import pytest
from lifts import by_pinocchio
from nbclient import NotebookClient
from scipy.interpolate import CubicSpline

import pinred
from pinred.common.arrays import Array
from pinred.system.catalogue import has_example_robots

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent
PATHS = sorted((ROOT / "examples/tutorials").glob("*.py"))
NUMBER = r"(-?[\d.]+(?:e-?\d+)?)"


@dataclass(frozen=True)
class Told:
    """What a tutorial printed, and the names in it at its end."""

    text: str
    names: dict[str, Any]

    def numbers(self, pattern: str) -> list[float]:
        """Return the numbers in the one place where the text matches; N stands for each."""
        (found,) = re.findall(pattern.replace("N", NUMBER), self.text)
        return [float(text) for text in ([found] if isinstance(found, str) else found)]


@pytest.fixture(scope="module")
def tell(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Told]:
    """Run a tutorial once, in an empty folder, where it leaves nothing."""
    told: dict[str, Told] = {}

    def run(start: str) -> Told:
        (path,) = (path for path in PATHS if path.name.startswith(start))
        if start == "04" and not has_example_robots():
            pytest.skip("example-robot-data is not installed")
        if start not in told:
            folder, before = tmp_path_factory.mktemp("student"), Path.cwd()
            os.chdir(folder)
            try:
                with redirect_stdout(StringIO()) as out:
                    names = runpy.run_path(str(path), run_name="__main__")
            finally:
                os.chdir(before)
            assert list(folder.iterdir()) == []
            told[start] = Told(out.getvalue(), names)
        return told[start]

    return run


def turned_by_momentum_map(
    system: pinred.System, shape: Callable[[float], Array], duration: float, steps: int = 2000
) -> Array:
    """Return the rotation vector by which a prescribed shape turns the base, (3,) [rad].

    By Pinocchio's centroidal momentum matrix, A_G v = 0, and the middle of each step.
    """
    model, data = system.model, system.model.createData()
    q, h = pin.neutral(model), duration / steps
    first = pin.Quaternion(q[3:7])
    for k in range(steps):
        before, middle, after = (shape((k + part) * h) for part in (0.0, 0.5, 1.0))
        xdot = (after - before) / h
        q = system.q(q[:7], middle)
        map_ = pin.computeCentroidalMap(model, data, q)
        xi = -np.linalg.solve(map_[:, :6], map_[:, 6:] @ xdot)
        q = pin.integrate(model, q, h * np.concatenate([xi, xdot]))
    return np.asarray(pin.log3((first.inverse() * pin.Quaternion(q[3:7])).matrix()))


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.name)
def test_form(path: Path) -> None:
    """Short, in cells, with text first; and everything that is compared is checked."""
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 120
    assert text.startswith(f"# %% [markdown]\n# # {int(path.name[:2])}. ")
    assert text.count("# %% [markdown]") >= 4
    assert "np.testing.assert_allclose(" in text
    assert f"tutorials/{path.name}" in (ROOT / "docs/tutorials.md").read_text(encoding="utf-8")


def test_they_are_numbered() -> None:
    """From 1 on, none left out."""
    assert [int(path.name[:2]) for path in PATHS] == list(range(1, len(PATHS) + 1))


def test_elroys_beanie(tell: Callable[[str], Told]) -> None:
    """I = 3, A = 1/3, M = 2/3; three periods of 2π/3 s at μ = 0.7; a turn of the propeller."""
    told = tell("01")
    for name, value in (("I", 3.0), ("A", 1 / 3), ("M", 2 / 3)):
        assert told.numbers(rf"\n{name} +N +N\n") == pytest.approx([value, value], abs=1e-9)
    turned = told.numbers(r"turned in three periods: N rad, by hand N rad")
    assert turned == pytest.approx(2 * [0.7 * 3 * (2 * np.pi / 3) / 3], abs=1e-8)
    assert told.numbers(r"turns the body by N rad") == pytest.approx([-2 * np.pi / 3], abs=1e-8)
    assert told.text.count("verdict: PASSED") == 1


def test_coupled_planar(tell: Callable[[str], Told]) -> None:
    """A = (0, −1/30, 4/15) and M = 11/60; both bodies turn steadily; body 2 by ABA too."""
    told = tell("02")
    (row,) = re.findall(r"A by hand +\[(.*?)\] +by pinred \[(.*?)\]", told.text)
    for entries in row:
        np.testing.assert_allclose(
            np.array(entries.split(), float), [0, -1 / 30, 4 / 15], atol=1e-8
        )
    assert told.numbers("M by hand +N +by pinred N") == pytest.approx(2 * [11 / 60], rel=1e-14)
    assert told.numbers(r"x = N rad, by hand N rad") == pytest.approx(2 * [0.3 + 12.0], abs=1e-8)
    system = pinred.load("coupled_planar")
    v = np.array([0.4, -0.7, 0.9, 1.2])
    vdot = pin.aba(
        system.model, system.model.createData(), system.q(np.zeros(3), [0.3]), v, np.zeros(4)
    )
    # Pinocchio's planar joint has its linear velocity in the body, as ours: v̇ is ξ̇, ẍ.
    np.testing.assert_allclose(told.names["vdot"], vdot, atol=1e-12)


def test_falling_cat(tell: Callable[[str], Told]) -> None:
    """The turn of the large loop by Pinocchio's centroidal map; half a turn at the end."""
    told = tell("03")

    def circle(t: float, radius: float = 1.2) -> Array:
        return radius * np.array([np.cos(2 * np.pi * t), np.sin(2 * np.pi * t), 0.0])

    turn = turned_by_momentum_map(pinred.load("falling_cat"), circle, 1.0)
    size = float(np.linalg.norm(turn))
    assert told.numbers("in 1 s +N rad") == pytest.approx([size], rel=1e-6)
    assert told.numbers(r"in 0\.3 s +N rad") == pytest.approx([size], rel=1e-6)
    assert told.numbers("backwards +N rad") == pytest.approx([size], rel=1e-6)
    np.testing.assert_allclose(told.names["turned"](told.names["traj"]), turn, atol=1e-5)
    assert told.numbers("the cat turns by N°") == pytest.approx([180.0], abs=0.02)
    off = [float(text) for text in re.findall(r"([\d.]+)%", told.text)]
    assert np.divide(off[:2], off[1:]) == pytest.approx([2.0, 2.0], rel=0.02)


def test_quadruped_flight(tell: Callable[[str], Told]) -> None:
    """Height and time of flight by Galileo, the pitch by Pinocchio's centroidal map."""
    told = tell("04")
    assert told.numbers("flight of N s, N m high") == pytest.approx(
        [2 * 2.0 / 9.81, 2.0**2 / (2 * 9.81)], abs=6e-4
    )
    solo = pinred.load("solo12")
    hips, knees = ([name.endswith(end) for name in solo.shape_names] for end in ("HFE", "KFE"))

    def legs(t: float) -> Array:
        hip, knee = 0.4 + 0.8 * np.sin(2 * np.pi * t), -1.4 + 0.9 * np.cos(2 * np.pi * t)
        return np.asarray(hip * np.array(hips) + knee * np.array(knees))

    pitch = np.degrees(turned_by_momentum_map(solo, legs, 1.0)[1])
    assert told.numbers("the body pitches by N°, Stokes says N°") == pytest.approx(
        [pitch, pitch], rel=1e-5
    )
    nodded, left = told.numbers("it nods by up to N°, in the end by N°")
    assert nodded > 5.0
    assert abs(left) < 1e-6


def test_satellite_arms(tell: Callable[[str], Told]) -> None:
    """One loop by Pinocchio's centroidal map; a quarter turn; drives that do no work."""
    told = tell("05")
    satellite = pinred.load("satellite_two_arms")

    def arm(t: float) -> Array:
        x = np.zeros(6)
        x[:2] = 0.8 * np.cos(2 * np.pi * t), 0.8 * np.sin(2 * np.pi * t)
        return x

    turn = np.degrees(turned_by_momentum_map(satellite, arm, 1.0))
    (row,) = re.findall(r"one loop turns the bus by \[(.*?)\]", told.text)
    np.testing.assert_allclose(np.array(row.split(), float), turn, atol=1e-4)
    wrong, right = told.numbers("wrong by N% and N")
    assert wrong > 10.0
    assert right < 1e-12
    assert told.numbers("turn the bus by N°") == pytest.approx([90.0], abs=1e-5)
    most, end = told.numbers(r"work of the drives: up to N J, in the end N J")
    assert most > 1.0
    assert abs(end) < 1e-9


@pytest.mark.by_hand
def test_integrators(tell: Callable[[str], Told]) -> None:
    """Orders 2, 4 and 6; errors against ABA; energy grows by RKMK4 and not by Gauss."""
    told = tell("06")
    rows = [line.split() for line in told.text.splitlines()[1:]]
    table = {(row[0], float(row[1])): list(map(float, row[2:])) for row in rows if len(row) == 7}
    assert len(table) >= 6
    assert all(momentum < 1e-13 for *_, momentum in table.values())
    for step in (0.04, 0.02, 0.01):
        assert table["RKMK4", step][0] == pytest.approx(4 / step, abs=1)
    order = np.log2(table["RKMK4", 0.02][1] / table["RKMK4", 0.01][1])
    assert order == pytest.approx(4.0, abs=0.3)
    for tolerance in (1e-5, 1e-7, 1e-9):
        assert tolerance / 10 < table["DOP853", tolerance][1] < tolerance * 10
    for name, expected in (("Gauss2", 2.0), ("Gauss6", 6.0)):
        order = np.log2(table[name, 0.02][1] / table[name, 0.01][1])
        assert order == pytest.approx(expected, abs=0.3)
    drift = {
        name: told.numbers(rf"{name} .*drift of energy N by 50 s, N by 100 s")
        for name in ("RKMK4", "Gauss2", "Gauss6")
    }
    assert drift["RKMK4"][1] > 1.7 * drift["RKMK4"][0]
    for name in ("Gauss2", "Gauss6"):
        assert drift[name][1] < 1.2 * drift[name][0]
    assert drift["Gauss6"][1] < 1e-4 * drift["RKMK4"][1]
    explicit, implicit = told.numbers(r"stiff: N evaluations of DOP853, N evaluations of Radau")
    assert explicit > 30 * implicit


def test_cat_in_one_formula(tell: Callable[[str], Told]) -> None:
    """The bend that turns it over, and the phases of four bends, by the closed form."""
    told = tell("07")
    assert told.numbers("bent by N° it turns over") == pytest.approx([59.42646], abs=5e-6)
    rows = re.findall(r"(\d+)° +([\d.]+) +([\d.]+)", told.text)
    assert len(rows) == 4
    for degrees, found, _ in rows:
        half = np.radians(float(degrees)) / 2.0
        c, s = np.cos(half), np.sin(half)
        roll = 2.0 * np.pi * (0.25 * c / (0.25 * c**2 + s**2) - 1.0)
        assert np.cos(float(found)) == pytest.approx(np.cos(roll), abs=1e-8)


def test_trusted_height_function(tell: Callable[[str], Told]) -> None:
    """Purcell's stroke as published; from a quarter off to half a per cent."""
    told = tell("08")
    moved = told.numbers("the circle moves it by N,")
    assert moved == pytest.approx([0.0512808243], abs=1e-9)
    assert told.numbers(r"middle +link: off by N %") == pytest.approx([26.6], abs=0.1)
    (off,) = told.numbers("the volume is off by N %")
    assert off < 0.5


def test_hand_that_stays_put(tell: Callable[[str], Told]) -> None:
    """Held, the hand strays by a hundredth of what it does with frozen joints."""
    told = tell("09")
    (way,) = told.numbers("with frozen joints the hand strays by N m")
    (held,) = told.numbers("held, it strays by N m")
    assert held < 0.01 * way
    assert told.text.count("verdict: PASSED") == 1


def test_identification(tell: Callable[[str], Told]) -> None:
    """The payload and the damping are found to a few of their standard deviations."""
    told = tell("12")
    assert "verdict: PASSED" in told.text
    for label in ("mass [kg]", "x [m]", "y [m]", "z [m]", "damping"):
        found, spread, true = told.numbers(rf"{re.escape(label)} +N ± N +\(really N\)")
        assert abs(found - true) < 4.0 * spread
    (residual,) = told.numbers(r"residual N rad")
    assert residual == pytest.approx(1e-3, rel=0.2)


def test_best_stroke(tell: Callable[[str], Told]) -> None:
    """What no simple loop exceeds; rotation per length, by SciPy over Pinocchio's mass matrix."""
    told = tell("13")
    turn, part = told.numbers(r"turns by N rad, the polygon by N% of that")
    assert turn == pytest.approx(0.033787199534, abs=1e-12)
    assert 99.99 <= part <= 100.0
    best = told.names["best"]
    pose = by_pinocchio(pinred.load("three_rods"), best.gait, np.zeros(3))
    assert pose[2] / best.phase.length == pytest.approx(2.38599, abs=6e-6)
    assert told.text.count("verdict: PASSED") == 1


@pytest.mark.by_hand
def test_satellite_turns_by_its_arms(tell: Callable[[str], Told]) -> None:
    """A quarter turn by Pinocchio's centroidal map; full ABA."""
    told = tell("14")
    plan = told.names["plan"]
    turn = turned_by_momentum_map(
        pinred.load("satellite_two_arms"), lambda t: plan.gait.at(t)[0], plan.gait.period
    )
    np.testing.assert_allclose(plan.cycles * turn, [0.0, 0.0, np.pi / 2], atol=1e-4)
    (row,) = re.findall(r"the bus turns by \[(.*?)\] degrees", told.text)
    np.testing.assert_allclose(np.array(row.split(), float), [0.0, 0.0, 90.0], atol=1e-5)
    (missed,) = told.numbers("missed by N rad")
    assert missed < 1e-8
    assert told.text.count("verdict: PASSED") == 1


def test_turning_over_in_flight(tell: Callable[[str], Told]) -> None:
    """Half a turn by Pinocchio's centroidal map of the curves alone; limits at other times."""
    told = tell("15")
    solo, plan = pinred.load("solo12"), told.names["traj"].scene.prescribed
    values = told.names["traj"].scene.parameters
    times, curves = told.names["times"], told.names["curves"]
    splines = {}
    for name, (spline, knots) in curves.items():
        inner = [values[knot] for knot in knots]
        ends = spline.value([times[0], times[-1]])
        splines[name] = CubicSpline(times, [ends[0], *inner, ends[1]], bc_type="clamped")
    keys = ["HAA" if n.endswith("HAA") else n[0] + n[3:] for n in solo.shape_names]
    assert [plan[n] for n in solo.shape_names] == [curves[key][0] for key in keys]

    def shape(t: float) -> Array:
        return np.array([splines[key](t) for key in keys])

    turn = turned_by_momentum_map(solo, shape, 0.9, steps=1000)
    assert np.linalg.norm(turn) == pytest.approx(np.pi, abs=1e-4)
    assert abs(turn[0]) == pytest.approx(np.pi, abs=1e-3)
    fine = np.linspace(0.0, 0.9, 1001)
    rates = np.array([splines[key](fine, 1) for key in keys])
    assert np.abs(rates[:, [0, -1]]).max() < 1e-12
    assert np.abs(rates).max() < 30.0
    swing = splines["HAA"](fine)
    assert -1.61 < swing.min() < swing.max() < 5.01
    assert told.text.count("verdict: PASSED") == 1


def test_attitude_control(tell: Callable[[str], Told]) -> None:
    """Both reach the goal, and stay; what thrusters gave is what the momentum gained."""
    told = tell("16")
    assert told.text.count("verdict: PASSED") == 2
    assert "seen by forces: attitude of the base" in told.text
    for name in ("by_wheels", "by_thrusters"):
        traj = told.names[name]
        (time,) = traj.events["settled"].t
        angle = 2.0 * np.arccos(np.abs(traj(float(time)).pose[6]))
        assert angle == pytest.approx(np.radians(1.0), rel=1e-6)
        assert 2.0 * np.arccos(np.abs(traj.pose[-1, 6])) < np.radians(1.0)
    np.testing.assert_allclose(told.names["by_thrusters"].momentum_balance.residual, 0.0, atol=1e-7)


def test_without_matplotlib(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Figures are left out where they cannot be drawn; the rest runs."""
    for name in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.chdir(tmp_path)
    with redirect_stdout(StringIO()) as out:
        names = runpy.run_path(str(PATHS[0]), run_name="__main__")
    assert names["drawing"] is False
    assert "verdict: PASSED" in out.getvalue()


def as_notebook(text: str) -> Any:
    """Return the notebook that editors make of a script in cells."""
    v4: Any = nbformat.v4  # without types
    cells = []
    for part in re.split(r"^# %%", text, flags=re.MULTILINE)[1:]:
        head, _, body = part.partition("\n")
        if head.strip() == "[markdown]":
            lines = [line.removeprefix("#").removeprefix(" ") for line in body.strip().splitlines()]
            cells.append(v4.new_markdown_cell("\n".join(lines)))
        else:
            cells.append(v4.new_code_cell(body.strip()))
    return v4.new_notebook(cells=cells)


def test_as_a_notebook(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a real kernel, too, every cell runs, and the figures are shown as pictures."""
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    book = as_notebook(PATHS[0].read_text(encoding="utf-8"))
    NotebookClient(
        book, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(ROOT)}}
    ).execute()
    outputs = [output for cell in book.cells for output in cell.get("outputs", [])]
    assert all(output["output_type"] in ("stream", "execute_result") for output in outputs)
    pictures = [output["data"] for output in outputs if output["output_type"] == "execute_result"]
    assert len(pictures) == 2
    assert all("image/png" in data for data in pictures)
    assert "".join(output.get("text", "") for output in outputs).count("verdict: PASSED") == 1


def test_steady_spins(tell: Callable[[str], Told]) -> None:
    """λ = √(1·0.5/2.5) at Ω = 1; a wheel on the middle axis ends it."""
    told = tell("10")
    growth = np.sqrt(0.2)
    assert told.numbers(r"grows by N 1/s, by hand N 1/s") == pytest.approx(2 * [growth], abs=1e-8)
    assert told.numbers("measured in a simulation: N") == pytest.approx([growth], rel=1e-3)
    rows = re.findall(r"wheel of ([\d.]+) N m s: (\w+) ", told.text)
    assert [verdict for _, verdict in rows] == 4 * ["unstable"] + ["stable"]
    assert told.text.count("verdict: PASSED") == 1


def test_double_spherical_pendulum(tell: Callable[[str], Told]) -> None:
    """Published frequencies; the straight one's pitchforks, by the second derivative of 1/I."""
    told = tell("11")
    assert "14 relative equilibria found at momentum 2" in told.text
    (row,) = re.findall(r"\nfrequencies \[(.*?)\]", told.text)
    expected = [4.16816, 5.13036, 8.30001]
    np.testing.assert_allclose(np.array(row.split(), float), expected, atol=1e-5)
    assert told.numbers("largest acceleration by ABA.*: N") == pytest.approx([0.0], abs=1e-11)
    assert told.numbers("follows it to N of") == pytest.approx([0.0], abs=1e-2)
