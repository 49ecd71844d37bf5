"""Run the tutorials and compare their printed numbers with independent results."""

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
from pinred.system.find_robot_files import has_example_robots

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent
PATHS = sorted((ROOT / "examples/tutorials").glob("*.py"))
NUMBER = r"(-?[\d.]+(?:e-?\d+)?)"


@dataclass(frozen=True)
class Output:
    """The text that a tutorial printed, and its global names after the run."""

    text: str
    names: dict[str, Any]

    def numbers(self, pattern: str) -> list[float]:
        """Return the numbers at the only match of a pattern, in which N stands for a number."""
        (match,) = re.findall(pattern.replace("N", NUMBER), self.text)
        return [float(text) for text in ([match] if isinstance(match, str) else match)]


@pytest.fixture(scope="module")
def run_tutorial(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Output]:
    """Run each requested tutorial once, in an empty folder, and check that it writes no files."""
    outputs: dict[str, Output] = {}

    def run(start: str) -> Output:
        (path,) = (path for path in PATHS if path.name.startswith(start))
        if start in ("04", "20") and not has_example_robots():
            pytest.skip("example-robot-data is not installed")
        if start not in outputs:
            folder, before = tmp_path_factory.mktemp("student"), Path.cwd()
            os.chdir(folder)
            try:
                with redirect_stdout(StringIO()) as stream:
                    names = runpy.run_path(str(path), run_name="__main__")
            finally:
                os.chdir(before)
            assert list(folder.iterdir()) == []
            outputs[start] = Output(stream.getvalue(), names)
        return outputs[start]

    return run


def turned_by_momentum_map(
    system: pinred.System, shape: Callable[[float], Array], duration: float, steps: int = 2000
) -> Array:
    """Return the rotation of the base under a prescribed shape, (3,) [rad].

    Uses Pinocchio's centroidal momentum matrix at the midpoint of each step, with A_G v = 0.

    Args:
        system: A floating robot.
        shape: Shape as a function of time [rad | m].
        duration: Duration of the motion [s].
        steps: Number of steps.
    """
    model, data = system.model, system.model.createData()
    q, h = pin.neutral(model), duration / steps
    first = pin.Quaternion(q[3:7])
    for k in range(steps):
        before, middle, after = (shape((k + fraction) * h) for fraction in (0.0, 0.5, 1.0))
        xdot = (after - before) / h
        q = system.q(q[:7], middle)
        map_ = pin.computeCentroidalMap(model, data, q)
        xi = -np.linalg.solve(map_[:, :6], map_[:, 6:] @ xdot)
        q = pin.integrate(model, q, h * np.concatenate([xi, xdot]))
    return np.asarray(pin.log3((first.inverse() * pin.Quaternion(q[3:7])).matrix()))


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.name)
def test_tutorial_has_standard_structure(path: Path) -> None:
    """Each tutorial has at most 120 lines, starts with a text cell and contains assertions."""
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 120
    assert text.startswith(f"# %% [markdown]\n# # {int(path.name[:2])}. ")
    assert text.count("# %% [markdown]") >= 4
    assert "np.testing.assert_allclose(" in text
    assert f"tutorials/{path.name}" in (ROOT / "docs/tutorials.md").read_text(encoding="utf-8")


def test_tutorials_are_numbered_consecutively() -> None:
    """The numbers are consecutive, starting at 1."""
    assert [int(path.name[:2]) for path in PATHS] == list(range(1, len(PATHS) + 1))


def test_tutorial_elroys_beanie_prints_reference_values(
    run_tutorial: Callable[[str], Output],
) -> None:
    """I = 3, A = 1/3, M = 2/3; three periods of 2π/3 s at μ = 0.7; one turn of the propeller."""
    output = run_tutorial("01")
    for name, value in (("I", 3.0), ("A", 1 / 3), ("M", 2 / 3)):
        assert output.numbers(rf"\n{name} +N +N\n") == pytest.approx([value, value], abs=1e-9)
    turned = output.numbers(r"turned in three periods: N rad, by hand N rad")
    assert turned == pytest.approx(2 * [0.7 * 3 * (2 * np.pi / 3) / 3], abs=1e-8)
    assert output.numbers(r"turns the body by N rad") == pytest.approx([-2 * np.pi / 3], abs=1e-8)
    assert output.text.count("verdict: PASSED") == 1


def test_tutorial_coupled_planar_prints_reference_values(
    run_tutorial: Callable[[str], Output],
) -> None:
    """A = (0, −1/30, 4/15) and M = 11/60; accelerations agree with ABA."""
    output = run_tutorial("02")
    (components,) = re.findall(r"A by hand +\[(.*?)\] +by pinred \[(.*?)\]", output.text)
    for entries in components:
        np.testing.assert_allclose(
            np.array(entries.split(), float), [0, -1 / 30, 4 / 15], atol=1e-8
        )
    assert output.numbers("M by hand +N +by pinred N") == pytest.approx(2 * [11 / 60], rel=1e-14)
    assert output.numbers(r"x = N rad, by hand N rad") == pytest.approx(2 * [0.3 + 12.0], abs=1e-8)
    system = pinred.load("coupled_planar")
    v = np.array([0.4, -0.7, 0.9, 1.2])
    vdot = pin.aba(
        system.model, system.model.createData(), system.q(np.zeros(3), [0.3]), v, np.zeros(4)
    )
    # Pinocchio's planar joint has its linear velocity in the body, as ours: v̇ is ξ̇, ẍ.
    np.testing.assert_allclose(output.names["vdot"], vdot, atol=1e-12)


@pytest.mark.by_hand
def test_tutorial_falling_cat_prints_reference_values(
    run_tutorial: Callable[[str], Output],
) -> None:
    """The rotation by the large loop agrees with the centroidal map; the cat rolls by 180°."""
    output = run_tutorial("03")

    def circle(t: float, radius: float = 1.2) -> Array:
        return radius * np.array([np.cos(2 * np.pi * t), np.sin(2 * np.pi * t), 0.0])

    turn = turned_by_momentum_map(pinred.load("falling_cat"), circle, 1.0)
    size = float(np.linalg.norm(turn))
    assert output.numbers("in 1 s +N rad") == pytest.approx([size], rel=1e-6)
    assert output.numbers(r"in 0\.3 s +N rad") == pytest.approx([size], rel=1e-6)
    assert output.numbers("backwards +N rad") == pytest.approx([size], rel=1e-6)
    np.testing.assert_allclose(output.names["turned"](output.names["traj"]), turn, atol=1e-5)
    assert output.numbers("the cat turns by N°") == pytest.approx([180.0], abs=0.02)
    off = [float(text) for text in re.findall(r"([\d.]+)%", output.text)]
    assert np.divide(off[:2], off[1:]) == pytest.approx([2.0, 2.0], rel=0.02)


def test_tutorial_quadruped_flight_prints_reference_values(
    run_tutorial: Callable[[str], Output],
) -> None:
    """Flight height and time follow from free fall; the pitch agrees with the centroidal map."""
    output = run_tutorial("04")
    assert output.numbers("flight of N s, N m high") == pytest.approx(
        [2 * 2.0 / 9.81, 2.0**2 / (2 * 9.81)], abs=6e-4
    )
    solo = pinred.load("solo12")
    hips, knees = ([name.endswith(end) for name in solo.shape_names] for end in ("HFE", "KFE"))

    def legs(t: float) -> Array:
        hip, knee = 0.4 + 0.8 * np.sin(2 * np.pi * t), -1.4 + 0.9 * np.cos(2 * np.pi * t)
        return np.asarray(hip * np.array(hips) + knee * np.array(knees))

    pitch = np.degrees(turned_by_momentum_map(solo, legs, 1.0)[1])
    assert output.numbers("the body pitches by N°, Stokes says N°") == pytest.approx(
        [pitch, pitch], rel=1e-5
    )
    nodded, final = output.numbers("it nods by up to N°, in the end by N°")
    assert nodded > 5.0
    assert abs(final) < 1e-6


@pytest.mark.by_hand
def test_tutorial_satellite_arms_prints_reference_values(
    run_tutorial: Callable[[str], Output],
) -> None:
    """One loop agrees with the centroidal map; four turn by 90°; the drives do no net work."""
    output = run_tutorial("05")
    satellite = pinred.load("satellite_two_arms")

    def arm(t: float) -> Array:
        x = np.zeros(6)
        x[:2] = 0.8 * np.cos(2 * np.pi * t), 0.8 * np.sin(2 * np.pi * t)
        return x

    turn = np.degrees(turned_by_momentum_map(satellite, arm, 1.0))
    (components,) = re.findall(r"one loop turns the bus by \[(.*?)\]", output.text)
    np.testing.assert_allclose(np.array(components.split(), float), turn, atol=1e-4)
    wrong, right = output.numbers("wrong by N% and N")
    assert wrong > 10.0
    assert right < 1e-12
    assert output.numbers("turn the bus by N°") == pytest.approx([90.0], abs=1e-5)
    most, end = output.numbers(r"work of the drives: up to N J, in the end N J")
    assert most > 1.0
    assert abs(end) < 1e-9


@pytest.mark.by_hand
def test_tutorial_integrators_prints_reference_values(
    run_tutorial: Callable[[str], Output],
) -> None:
    """Orders are 2, 4 and 6, errors are against ABA, and energy drifts with RKMK4 only."""
    output = run_tutorial("06")
    rows = [line.split() for line in output.text.splitlines()[1:]]
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
        name: output.numbers(rf"{name} .*drift of energy N by 50 s, N by 100 s")
        for name in ("RKMK4", "Gauss2", "Gauss6")
    }
    assert drift["RKMK4"][1] > 1.7 * drift["RKMK4"][0]
    for name in ("Gauss2", "Gauss6"):
        assert drift[name][1] < 1.2 * drift[name][0]
    assert drift["Gauss6"][1] < 1e-4 * drift["RKMK4"][1]
    explicit, implicit = output.numbers(r"stiff: N evaluations of DOP853, N evaluations of Radau")
    assert explicit > 30 * implicit


def test_tutorial_cat_in_one_formula_prints_reference_values(
    run_tutorial: Callable[[str], Output],
) -> None:
    """The bend for half a turn, and the phases of four bends, agree with the closed form."""
    output = run_tutorial("07")
    assert output.numbers("bent by N° it turns over") == pytest.approx([59.42646], abs=5e-6)
    rows = re.findall(r"(\d+)° +([\d.]+) +([\d.]+)", output.text)
    assert len(rows) == 4
    for degrees, printed, _ in rows:
        half = np.radians(float(degrees)) / 2.0
        c, s = np.cos(half), np.sin(half)
        roll = 2.0 * np.pi * (0.25 * c / (0.25 * c**2 + s**2) - 1.0)
        assert np.cos(float(printed)) == pytest.approx(np.cos(roll), abs=1e-8)


@pytest.mark.by_hand
def test_tutorial_trusted_height_function_prints_reference_values(
    run_tutorial: Callable[[str], Output],
) -> None:
    """Purcell's stroke has its published value; the volume is off by less than 0.5 %."""
    output = run_tutorial("08")
    displacement = output.numbers("the circle moves it by N,")
    assert displacement == pytest.approx([0.0512808243], abs=1e-9)
    assert output.numbers(r"middle +link: off by N %") == pytest.approx([26.6], abs=0.1)
    (error,) = output.numbers("the volume is off by N %")
    assert error < 0.5


@pytest.mark.by_hand
def test_tutorial_hand_that_stays_put_prints_reference_values(
    run_tutorial: Callable[[str], Output],
) -> None:
    """The controlled hand strays by less than a hundredth of the way with frozen joints."""
    output = run_tutorial("09")
    (uncontrolled,) = output.numbers("with frozen joints the hand strays by N m")
    (controlled,) = output.numbers("held, it strays by N m")
    assert controlled < 0.01 * uncontrolled
    assert output.text.count("verdict: PASSED") == 1


@pytest.mark.by_hand
def test_tutorial_identification_prints_reference_values(
    run_tutorial: Callable[[str], Output],
) -> None:
    """The estimates of payload and damping are within four standard deviations."""
    output = run_tutorial("12")
    assert "verdict: PASSED" in output.text
    for label in ("mass [kg]", "x [m]", "y [m]", "z [m]", "damping"):
        estimate, spread, true = output.numbers(rf"{re.escape(label)} +N ± N +\(really N\)")
        assert abs(estimate - true) < 4.0 * spread
    (residual,) = output.numbers(r"residual N rad")
    assert residual == pytest.approx(1e-3, rel=0.2)


@pytest.mark.by_hand
def test_tutorial_best_stroke_prints_reference_values(
    run_tutorial: Callable[[str], Output],
) -> None:
    """The largest rotation is the theoretical bound; rotation per length agrees with SciPy."""
    output = run_tutorial("13")
    turn, percentage = output.numbers(r"turns by N rad, the polygon by N% of that")
    assert turn == pytest.approx(0.033787199534, abs=1e-12)
    assert 99.99 <= percentage <= 100.0
    best = output.names["best"]
    pose = by_pinocchio(pinred.load("three_rods"), best.gait, np.zeros(3))
    assert pose[2] / best.phase.length == pytest.approx(2.38599, abs=6e-6)
    assert output.text.count("verdict: PASSED") == 1


@pytest.mark.by_hand
def test_tutorial_satellite_turns_by_its_arms_prints_reference_values(
    run_tutorial: Callable[[str], Output],
) -> None:
    """The quarter turn agrees with the centroidal map and with full ABA."""
    output = run_tutorial("14")
    plan = output.names["plan"]
    turn = turned_by_momentum_map(
        pinred.load("satellite_two_arms"), lambda t: plan.gait.at(t)[0], plan.gait.period
    )
    np.testing.assert_allclose(plan.cycles * turn, [0.0, 0.0, np.pi / 2], atol=1e-4)
    (components,) = re.findall(r"the bus turns by \[(.*?)\] degrees", output.text)
    np.testing.assert_allclose(np.array(components.split(), float), [0.0, 0.0, 90.0], atol=1e-5)
    (missed,) = output.numbers("missed by N rad")
    assert missed < 1e-8
    assert output.text.count("verdict: PASSED") == 1


@pytest.mark.by_hand
def test_tutorial_turning_over_in_flight_prints_reference_values(
    run_tutorial: Callable[[str], Output],
) -> None:
    """Half a turn by the centroidal map of the curves; limits hold at all times."""
    output = run_tutorial("15")
    solo, plan = pinred.load("solo12"), output.names["traj"].scene.prescribed
    values = output.names["traj"].scene.parameters
    times, curves = output.names["times"], output.names["curves"]
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
    assert output.text.count("verdict: PASSED") == 1


@pytest.mark.by_hand
def test_tutorial_attitude_control_prints_reference_values(
    run_tutorial: Callable[[str], Output],
) -> None:
    """Both controllers reach the goal and stay; thruster impulses change the momentum."""
    output = run_tutorial("16")
    assert output.text.count("verdict: PASSED") == 2
    assert "observed by forces: attitude of the base" in output.text
    for name in ("by_wheels", "by_thrusters"):
        traj = output.names[name]
        (time,) = traj.events["settled"].t
        angle = 2.0 * np.arccos(np.abs(traj(float(time)).pose[6]))
        assert angle == pytest.approx(np.radians(1.0), rel=1e-6)
        assert 2.0 * np.arccos(np.abs(traj.pose[-1, 6])) < np.radians(1.0)
    np.testing.assert_allclose(
        output.names["by_thrusters"].momentum_balance.residual, 0.0, atol=1e-7
    )


def test_tutorial_without_matplotlib_omits_figures(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Without matplotlib a tutorial omits its figures and runs to its end."""
    for name in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.chdir(tmp_path)
    with redirect_stdout(StringIO()) as out:
        names = runpy.run_path(str(PATHS[0]), run_name="__main__")
    assert names["drawing"] is False
    assert "verdict: PASSED" in out.getvalue()


def as_notebook(text: str) -> Any:
    """Return the notebook that editors create from a script in cells."""
    v4: Any = nbformat.v4  # has no type annotations
    cells = []
    for cell in re.split(r"^# %%", text, flags=re.MULTILINE)[1:]:
        kind, _, body = cell.partition("\n")
        if kind.strip() == "[markdown]":
            lines = [line.removeprefix("#").removeprefix(" ") for line in body.strip().splitlines()]
            cells.append(v4.new_markdown_cell("\n".join(lines)))
        else:
            cells.append(v4.new_code_cell(body.strip()))
    return v4.new_notebook(cells=cells)


@pytest.mark.by_hand
def test_tutorial_runs_as_notebook(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All cells run in a Jupyter kernel, and figures are displayed as images."""
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


@pytest.mark.by_hand
def test_tutorial_steady_spins_prints_reference_values(
    run_tutorial: Callable[[str], Output],
) -> None:
    """λ = √(1·0.5/2.5) at Ω = 1; a wheel on the middle axis makes the spin stable."""
    output = run_tutorial("10")
    growth = np.sqrt(0.2)
    assert output.numbers(r"grows by N 1/s, by hand N 1/s") == pytest.approx(2 * [growth], abs=1e-8)
    assert output.numbers("measured in a simulation: N") == pytest.approx([growth], rel=1e-3)
    rows = re.findall(r"wheel of ([\d.]+) N m s: (\w+) ", output.text)
    assert [verdict for _, verdict in rows] == 4 * ["unstable"] + ["stable"]
    assert output.text.count("verdict: PASSED") == 1


@pytest.mark.by_hand
def test_tutorial_double_spherical_pendulum_prints_reference_values(
    run_tutorial: Callable[[str], Output],
) -> None:
    """Frequencies have their published values; ABA confirms the equilibria."""
    output = run_tutorial("11")
    assert "14 relative equilibria found at momentum 2" in output.text
    (frequencies,) = re.findall(r"\nfrequencies \[(.*?)\]", output.text)
    expected = [4.16816, 5.13036, 8.30001]
    np.testing.assert_allclose(np.array(frequencies.split(), float), expected, atol=1e-5)
    assert output.numbers("largest acceleration by ABA.*: N") == pytest.approx([0.0], abs=1e-11)
    assert output.numbers("follows it to N of") == pytest.approx([0.0], abs=1e-2)


@pytest.mark.by_hand
def test_tutorial_twisting_somersault_prints_reference_values(
    run_tutorial: Callable[[str], Output],
) -> None:
    """Pinocchio's momentum map gives the tilt of the kick; the dives have whole twists."""
    output, system = run_tutorial("17"), pinred.load("diver")
    up = np.array([np.pi, 0.0, 0.0])

    def shape(t: float) -> Array:
        arms = np.concatenate([np.zeros(3), (1.0 - t) * up, up])
        return system.space.integrate(system.space.neutral, arms)

    (tilt,) = output.numbers("tilts the body by N degrees")
    arm, middle = system.space.balls[1], system.space.neutral
    assert arm.name == "left_shoulder"
    model, angle = system.model, np.zeros(3)
    steps = 200
    for k in range(steps):
        middle = shape((k + 0.5) / steps)
        map_ = pin.computeCentroidalMap(model, model.createData(), system.q([0] * 6 + [1], middle))
        rates = np.zeros(9)
        rates[arm.v] = -up / steps
        angle -= np.linalg.solve(map_[:, :6], map_[:, 6:] @ rates)[3:]
    assert tilt == pytest.approx(np.degrees(np.linalg.norm(angle)), abs=2e-3)
    dives = re.findall(r"dive (\d+): .* s, ([\d.]+) somersaults, ([\d.]+) twists", output.text)
    assert [(code, round(float(m), 3), round(float(n), 3)) for code, m, n in dives] == [
        ("5132", 1.5, 1.0), ("5134", 1.5, 2.0), ("5156", 2.5, 3.0),
    ]  # fmt: skip
    assert output.text.count("verdict: PASSED") == 1


@pytest.mark.by_hand
def test_tutorial_parallel_legs_prints_reference_values(
    run_tutorial: Callable[[str], Output],
) -> None:
    """Four turns make a whole one; Pinocchio's momentum map confirms the first quarter."""
    output, system = run_tutorial("18"), pinred.load("parallel_biped")
    half, whole = output.numbers("at ±N rad, 4 turns pitch it by N°")
    assert whole == pytest.approx(-360.0, abs=1e-5)
    traj, period = output.names["traj"], output.names["gait"].period
    at = [system.shape_names.index(name) for name in output.names["hips"]]
    assert traj.x[0][at] == pytest.approx([-half, half] * 2, abs=1e-6)
    pose = traj(period).pose
    relative = system.group.compose(system.group.inverse(traj.pose[0]), pose)
    turn = turned_by_momentum_map(system, lambda t: traj(t).x, period)
    np.testing.assert_allclose(turn, system.group.log(relative)[3:], atol=1e-5)
    assert np.degrees(turn[1]) == pytest.approx(-90.0, abs=1.0)
    missed, lag = (output.numbers(f"{text} N°")[0] for text in ("attitude by", "plan by up to"))
    assert missed < 10.0 * lag < 3.0
    assert output.numbers("largest error of .*: N rad/s")[0] < 1e-12
    assert output.text.count("verdict: PASSED") == 1


@pytest.mark.by_hand
def test_tutorial_catching_a_satellite_prints_reference_values(
    run_tutorial: Callable[[str], Output],
) -> None:
    """Momentum and energy of the tumbling body; Carnot's loss; all momentum ends in the wheels."""
    output = run_tutorial("19")
    twist = np.array([0.02, -0.01, 0.03, 0.15, 0.30, -0.20])
    sizes = np.array([25.0, 25.0, 25.0, 2.0, 3.0, 4.0])
    momentum = sizes * twist  # of the free body; its attitude is the identity at the start
    before, lost = output.names["capture"].momentum_before, output.names["capture"].energy_lost
    np.testing.assert_allclose(before, momentum, atol=1e-9)
    energy = 0.5 * float(sizes @ twist**2)
    (shown, after) = output.numbers(r"energy before N J, after N J")
    assert shown == pytest.approx(energy, abs=1e-4)
    assert after == pytest.approx(energy - lost, abs=1e-4)
    (entries,) = re.findall(
        r"angular momentum: \[(.*?)\] N m s, in the wheels: \[(.*?)\]", output.text
    )
    total, wheels = (np.array(text.split(), float) for text in entries)
    np.testing.assert_allclose(wheels, total, atol=5e-4)
    # Angular momentum about the centre of mass: that about the origin less c × p, in any axes.
    end = output.names["end"]
    model = output.names["capture"].system.model
    com = pin.centerOfMass(model, model.createData(), end.q)
    spin = momentum[3:] - np.cross(com, momentum[:3])
    assert np.linalg.norm(total) == pytest.approx(np.linalg.norm(spin), abs=1e-6)


def test_tutorial_drop_and_landing_prints_reference_values(
    run_tutorial: Callable[[str], Output],
) -> None:
    """The fall is ½gt²; the energy lost is ½ λ·(J H⁻¹ Jᵀ) λ; the second foot meets the ground."""
    output = run_tutorial("20")
    (time,) = output.numbers(r"meets the ground at t = N s")
    assert output.numbers(r"fell N m, by hand N m") == pytest.approx(
        [0.5 * 9.81 * time**2] * 2, abs=1e-5
    )
    names = output.names
    J, H, impulse = names["J"], names["H"], names["impulse"]
    lost = 0.5 * impulse @ J @ np.linalg.solve(H, J.T) @ impulse
    assert names["landing"].energy_lost == pytest.approx(lost, rel=1e-9)
    stance, model = names["stance"], names["robot"].model
    data = model.createData()
    pin.framesForwardKinematics(model, data, stance.q[-1])
    foot = data.oMf[model.getFrameId(str(stance.ended_by), pin.FrameType.BODY)]
    assert foot.translation[2] == pytest.approx(0.0, abs=1e-9)
