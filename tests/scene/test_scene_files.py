"""Scene files: the same motion as the Scene written in Python, and `pinred run`."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import MISSING, fields
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.cli.command_line import main
from pinred.common.argument_kinds import Default
from pinred.forces import (
    PD,
    ComputedTorque,
    Damper,
    Friction,
    PotentialEnergy,
    Spring,
    Torque,
    Wrench,
)
from pinred.forces.force import Force, Limit
from pinred.integrators.methods import (
    DOP853,
    METHODS,
    RKMK4,
    AdaptiveGauss,
    Gauss,
    Method,
    Radau,
    Tsit5,
    Variational,
)
from pinred.scene.scene_options import LOAD, METHOD_TABLES
from pinred.scene.toml.reader import IMPACTS, SCENE, read_scene_file
from pinred.scene.toml.value_tables import FORCES
from pinred.signals import Constant, Expression, Fourier, Hold, Linear, Spline
from pinred.system.find_robot_files import has_example_robots

EXAMPLES = Path(__file__).parents[2] / "examples"


def written(folder: Path, text: str, name: str = "scene.toml") -> Path:
    """A file with a text in a folder."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def assert_same_motion(scene: pinred.Scene, other: pinred.Scene, engine: Any = "compiled") -> None:
    """Both scenes give the same states, bit for bit."""
    ours = pinred.simulate(scene, engine=engine).outputs
    theirs = pinred.simulate(other, engine=engine).outputs
    assert type(ours) is type(theirs)
    for entry in fields(ours):
        np.testing.assert_array_equal(getattr(ours, entry.name), getattr(theirs, entry.name))


HEAD = """
robot = "falling_cat"
start = { x0 = [0.3, -0.2, 0.4], xi0 = [0.1, 0, 0, 0.2, -0.1, 0.3] }
run = { duration = 0.5, samples = 6 }
"""
CSV = "time,angle,torque\n0,0.3,0.1\n0.2,0.35,-0.2\n0.4,0.5,0.3\n0.6,0.4,0\n"
TIMES, ANGLES, TORQUES = [0.0, 0.2, 0.4, 0.6], [0.3, 0.35, 0.5, 0.4], [0.1, -0.2, 0.3, 0.0]


def scene_in_python(**options: Any) -> pinred.Scene:
    """The scene of HEAD."""
    return pinred.Scene(
        system=pinred.load("falling_cat"),
        x0=[0.3, -0.2, 0.4],
        xi0=[0.1, 0.0, 0.0, 0.2, -0.1, 0.3],
        duration=0.5,
        times=np.linspace(0.0, 0.5, 6),
        **options,
    )


def sine(t: Any, x: Any, xdot: Any, mu: Any) -> Any:
    """0.1 sin(3t) x₀ + 0.02 ẋ₂ μ₄."""
    import casadi as ca

    return 0.1 * ca.sin(3 * t) * x[0] + 0.02 * xdot[2] * mu[4]


def well(x: Any) -> Any:
    """x₀² x₂ / 2."""
    return 0.5 * x[0] ** 2 * x[2]


SINE = "0.1*sin(3*t)*x['bend'] + 0.02*xdot[2]*mu[4]"
FORCE_CASES: dict[str, tuple[str, Callable[[], Force]]] = {
    "spring": (
        "kind = 'spring'\njoint = 'bend'\nstiffness = 2\nrest = 0.1",
        lambda: Spring("bend", 2.0, 0.1),
    ),
    "spring between": (
        "kind = 'spring'\njoint = 'bend'\nstiffness = 2\nto = 'twist'",
        lambda: Spring("bend", 2.0, to="twist"),
    ),
    "damper": (
        "kind = 'damper'\njoint = 'bend'\ncoefficient = 0.2\nto = 'sway'",
        lambda: Damper("bend", 0.2, to="sway"),
    ),
    "spring with powers": (
        "kind = 'spring'\njoint = 'bend'\nstiffness = 2\npolynomial = [0.2, 0.4]",
        lambda: Spring("bend", 2.0, polynomial=(0.2, 0.4)),
    ),
    "damper with powers": (
        "kind = 'damper'\njoint = 'bend'\ncoefficient = 0.2\npolynomial = [0.1, 0.3]",
        lambda: Damper("bend", 0.2, polynomial=(0.1, 0.3)),
    ),
    "friction": (
        "kind = 'friction'\njoint = 'bend'\nmost = 0.2\nwidth = 0.1",
        lambda: Friction("bend", 0.2, 0.1),
    ),
    "potential": (
        "kind = 'potential'\nname = 'well'\nfunction = \"0.5*x['bend']**2*x[2]\"",
        lambda: PotentialEnergy(well, name="well"),
    ),
    "torque by formula": (
        f'kind = "torque"\nfunction = {{ sway = "{SINE}", twist = 0.05 }}',
        lambda: Torque({"sway": sine, "twist": 0.05}),
    ),
    "torque by formula is Python's": (
        f'kind = "torque"\nfunction = {{ sway = "{SINE}" }}',
        lambda: Torque(lambda *state: {"sway": sine(*state)}),
    ),
    "torque by table": (
        "kind = 'torque'\nfunction.bend = { linear = { file = 't.csv', columns = [0, 2] } }",
        lambda: Torque({"bend": Linear(TIMES, TORQUES)}),
    ),
    "torque held, limited": (
        "kind = 'torque'\nlimit = { bend = 0.15 }\n"
        "function.bend.hold = { times = [0, 0.2, 0.4, 0.6], values = [0.1, -0.2, 0.3, 0] }",
        lambda: Torque({"bend": Hold(TIMES, TORQUES)}, limit=Limit({"bend": 0.15})),
    ),
    "pd": (
        "kind = 'pd'\nkp = 2\nkd = { bend = 0.1, sway = 0.2 }\nlimit = 0.3\nsmooth = true\n"
        "reference = { bend = '0.3 + 0.1*t', sway = 0.2 }",
        lambda: PD(
            {"bend": Expression("0.3 + 0.1*t"), "sway": 0.2},
            kp=2.0, kd={"bend": 0.1, "sway": 0.2}, limit=Limit(0.3, smooth=True),
        ),
    ),
    "computed torque": (
        "kind = 'computed_torque'\nkp = 9\nkd = 6\n"
        "reference.bend.spline = { file = 't.csv', columns = ['time', 'angle'], end = 'clamped' }\n"
        "reference.sway = -0.2\nreference.twist = '0.4*cos(t)'",
        lambda: ComputedTorque(
            {
                "bend": Spline(TIMES, ANGLES, end="clamped"),
                "sway": -0.2,
                "twist": Expression("0.4*cos(t)"),
            },
            kp=9.0, kd=6.0,
        ),
    ),
    "wrench": (
        f'kind = "wrench"\nname = "jet"\nfunction = [0.1, 0, 0, "{SINE}", '
        "{ fourier = { sines = [0.1], period = 2 } }, 0]",
        lambda: Wrench(
            [0.1, 0.0, 0.0, sine, Fourier(0.0, [], [0.1], 2.0), 0.0], name="jet"
        ),
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", FORCE_CASES)
@pytest.mark.sampled
def test_force_from_file_matches_python(kind: str, tmp_path: Path) -> None:
    """A force from a file gives the motion of the same force in Python."""
    text, force = FORCE_CASES[kind]
    written(tmp_path, CSV, "t.csv")
    scene = pinred.load_scene(written(tmp_path, f"{HEAD}[[forces]]\n{text}\n"))
    plain = pinred.simulate(scene_in_python()).x
    assert_same_motion(scene, scene_in_python(forces=[force()]))
    assert np.abs(pinred.simulate(scene).x - plain).max() > 1e-4


def test_cases_cover_every_kind_of_force() -> None:
    """Each kind has a case above; test_ball_forces_in_files.py has those of forces on balls."""
    kinds = {text.split("\n")[0].split("=")[1].strip(" '\"") for text, _ in FORCE_CASES.values()}
    assert kinds == {name for name in FORCES if not name.startswith("ball")}


SIGNAL_CASES = {
    "number": ("0.25", Constant(0.25)),
    "formula": ("'0.3*sin(2*t) + exp(-t)'", Expression("0.3*sin(2*t) + exp(-t)")),
    "spline": (
        "{ spline = { times = [0, 0.2, 0.4, 0.6], values = [0.3, 0.35, 0.5, 0.4] } }",
        Spline(TIMES, ANGLES),
    ),
    "spline of a file": ("{ spline = { file = 't.csv' } }", Spline(TIMES, ANGLES)),
    "fourier": (
        "{ fourier = { mean = 0.1, cosines = [0.2, 0.1], sines = [0.3], period = 0.7 } }",
        Fourier(0.1, [0.2, 0.1], [0.3], 0.7),
    ),
}


@pytest.mark.parametrize(
    "engine", ["compiled", pytest.param("pinocchio", marks=pytest.mark.by_hand)]
)
@pytest.mark.parametrize("kind", SIGNAL_CASES)
@pytest.mark.sampled
def test_prescribed_signal_from_file_matches_python(kind: str, engine: str, tmp_path: Path) -> None:
    """The prescribed joint moves as with the signal in Python."""
    text, signal = SIGNAL_CASES[kind]
    written(tmp_path, CSV, "t.csv")
    scene = pinred.load_scene(written(tmp_path, f"{HEAD}[prescribed]\nsway = {text}\n"))
    assert_same_motion(scene, scene_in_python(prescribed={"sway": signal}), engine)
    t = scene.report_times
    np.testing.assert_allclose(pinred.simulate(scene).x[:, 1], signal.value(t), atol=1e-12)


def test_springs_and_joints_by_name_match_python(tmp_path: Path) -> None:
    """The short form of springs, and shapes by name, match Python."""
    text = (
        "robot = 'falling_cat'\nsprings = { bend = [2, 0.1], twist = [1.0, 0] }\n"
        "[start]\nx0 = { twist = 0.4 }\nxdot0 = { bend = 1 }\nmomentum = 0\n"
        "pose0 = [1, 2, 3, 0, 0, 0, 1]\n"
        "[run]\ntimes = [0, 0.1, 0.5]\nrtol = 1e-9\natol = 1e-11\noutputs = 'shape'\n"
    )
    other = pinred.Scene(
        system=pinred.load("falling_cat"),
        x0=[0.0, 0.0, 0.4], xdot0=[1.0, 0.0, 0.0], momentum=0, pose0=[1, 2, 3, 0, 0, 0, 1],
        times=[0.0, 0.1, 0.5], rtol=1e-9, atol=1e-11, outputs="shape",
        springs={"bend": (2.0, 0.1), "twist": (1.0, 0.0)},
    )  # fmt: skip
    assert_same_motion(pinred.load_scene(written(tmp_path, text)), other)


@pytest.mark.parametrize(
    ("text", "method"),
    [
        ("{ name = 'auto' }", "auto"),
        ("{ name = 'RKMK4', step = 0.01 }", RKMK4(0.01)),
        ("{ name = 'DOP853', rtol = 1e-8, max_step = 0.05 }", DOP853(rtol=1e-8, max_step=0.05)),
        ("{ name = 'Gauss', step = 0.01, order = 4 }", Gauss(0.01, 4)),
        ("{ name = 'AdaptiveGauss' }", AdaptiveGauss()),
        ("{ name = 'Variational', step = 0.02 }", Variational(0.02)),
        ("{ name = 'Radau', atol = 1e-7 }", Radau(atol=1e-7)),
        ("{ name = 'Tsit5', rtol = 1e-7 }", Tsit5(rtol=1e-7)),
    ],
)
@pytest.mark.sampled
def test_method_from_file_matches_python(text: str, method: Any, tmp_path: Path) -> None:
    """The integrator of the file is the one of Python."""
    scene = pinred.load_scene(
        written(tmp_path, f"robot='cartpole'\nrun={{duration=0.5, method={text}}}")
    )
    assert scene.method == method
    assert_same_motion(
        scene, pinred.Scene(system=pinred.load("cartpole"), duration=0.5, method=method)
    )


@pytest.mark.slow
def test_load_options_and_seed_match_python(tmp_path: Path) -> None:
    """Group, gravity, locked joints and seed match Python."""
    text = (
        "robot = 'satellite_two_arms'\nstart = { seed = 3 }\nrun = { duration = 0.3 }\n"
        "[load]\ngroup = 'SE3'\ngravity = [0, 0, -2]\n"
        "lock = { left_wrist = 0.3, right_elbow = 0 }\n"
    )
    scene = pinred.load_scene(written(tmp_path, text))
    system = pinred.load(
        "satellite_two_arms", group="SE3", gravity=[0, 0, -2],
        lock={"left_wrist": 0.3, "right_elbow": 0.0},
    )  # fmt: skip
    assert scene.system.shape_names == system.shape_names
    assert_same_motion(scene, pinred.Scene(system=system, seed=3, duration=0.3))
    listed = text.replace("{ left_wrist = 0.3, right_elbow = 0 }", "['left_wrist', 'right_elbow']")
    assert pinred.load_scene(written(tmp_path, listed)).system.m == 4


def test_paths_are_relative_to_the_scene_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The current folder does not matter."""
    (tmp_path / "models").mkdir()
    robot = (EXAMPLES / "heavy_top.urdf").read_text(encoding="utf-8")
    written(tmp_path, robot, "models/top.urdf")
    written(tmp_path, robot, "plain")
    written(tmp_path, "0,0\n1,0.1\n", "models/t.csv")
    monkeypatch.chdir(EXAMPLES)
    for name in ("models/top.urdf", "plain", str(tmp_path / "models/top.urdf")):
        text = (
            f"robot = '{name}'\nload = {{ group = 'SO3' }}\nstart = {{ xi0 = [0, 0.1, 1] }}\n"
            "run = { duration = 0.1 }\n[[forces]]\nkind = 'wrench'\n"
            "function = [{ linear = { file = 'models/t.csv' } }, 0, 0]\n"
        )
        scene = pinred.load_scene(written(tmp_path, text))
        assert scene.system.mass == pytest.approx(1.0)
    assert read_scene_file(tmp_path / "scene.toml").engine == "compiled"


def test_momentum_of_one_dimensional_group_is_a_number(tmp_path: Path) -> None:
    """A list is not needed."""
    text = "robot = 'cartpole'\nstart = { x0 = [0.2], momentum = 0.7 }\n"
    scene = pinred.load_scene(written(tmp_path, text))
    assert scene.start.mu == pytest.approx([0.7])


def test_keys_are_the_options_of_python() -> None:
    """Every option has a key of the same name, and there are no other keys."""
    scene = {entry.name for entry in fields(pinred.Scene)} - {"system"}
    tables = [SCENE.keys[name].node for name in ("start", "run")]
    keys = {key for table in tables for key in table.keys}  # type: ignore[attr-defined]
    keys |= set(SCENE.keys) - {"robot", "load", "start", "run", "sweep", "second", "phases"}
    assert keys == scene | {"samples", "engine", "check", "checkpoint"}
    for call in (pinred.capture, pinred.release, pinred.land):
        impact = set(IMPACTS[call.__name__].node.keys)  # type: ignore[attr-defined]
        arguments = set(signature(call).parameters) - {"a", "b", "state", "name"}
        assert impact - {"align"} == arguments
    assert set(LOAD.keys) == {
        "group",
        "gravity",
        "lock",
        "balls",
        "loops",
        "root",
        "strict",
        "meshes",
    }
    for kind in FORCES.values():
        table = kind.table
        wanted = {entry.name for entry in fields(kind.make)}  # type: ignore[arg-type]
        assert set(table.keys) - {"smooth"} == wanted
        assert ("smooth" in table.keys) == ("limit" in wanted)
    assert set(METHOD_TABLES) == {"auto", *METHODS}
    for name, method in METHODS.items():
        assert set(METHOD_TABLES[name].keys) == {entry.name for entry in fields(method)}
        for entry in fields(method):  # the defaults are as the tables say
            said = METHOD_TABLES[name].keys[entry.name].default
            if entry.default is MISSING:
                assert said == ""
            elif isinstance(entry.default, Default):
                scenes, own = said.split(", or ")
                assert scenes == f"a tenth of run.{entry.name}"
                assert float(own.split(" beside ")[0]) == entry.default
            elif said != "none":
                assert said == entry.default or float(said) == entry.default


PATHS = sorted(EXAMPLES.glob("*.toml"))
LONG = {"cat_turns_over", "solo12_free_fall"}  # whose comparison takes several seconds


@pytest.mark.by_hand("springs_between_joints")
@pytest.mark.slow
@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, marks=pytest.mark.by_hand) if path.stem in LONG else path
        for path in PATHS
    ],
    ids=lambda path: path.stem,
)
@pytest.mark.sampled(8)
def test_example_passes_comparison_with_aba(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """From any folder, cut to one second."""
    if "solo12" in path.stem and not has_example_robots():
        pytest.skip("needs example-robot-data")
    monkeypatch.chdir(tmp_path)
    assert path.read_text(encoding="utf-8").startswith("# ")
    assert main(["run", str(path), "--validate"]) == 0
    assert capsys.readouterr().out.startswith("ok: ")
    full = pinred.load_scene(path)
    traj = pinred.simulate(full, times=None, duration=min(full.end, 1.0))
    report = pinred.compare(traj)
    assert report.passed
    # The other route is as near.
    readable = pinred.simulate(traj.scene, method="auto", engine="pinocchio")
    bounds = (report.shape_bounds, report.rotation_bounds, report.position_bounds)
    worst = max(float(each.max(initial=0.0)) for each in bounds)
    scale = max(1.0, float(np.abs(traj.q).max()))
    np.testing.assert_allclose(readable.q, traj.q, rtol=0, atol=2 * worst * scale)


def test_cat_example_turns_by_half_a_turn() -> None:
    """About its long axis and without momentum."""
    traj = pinred.simulate(pinred.load_scene(EXAMPLES / "cat_turns_over.toml"))
    group = traj.system.group
    turn = group.log(group.compose(group.inverse(traj.pose[0]), traj.pose[-1]))[3:]
    assert math.pi - 0.05 < np.linalg.norm(turn) < math.pi + 0.05
    assert abs(turn[0]) > 0.99 * np.linalg.norm(turn)
    np.testing.assert_allclose(traj.x[-1], 0.0, atol=1e-12)
    model, data = traj.system.model, traj.system.model.createData()
    for q, v in zip(traj.q, traj.v, strict=True):
        momentum = pin.computeCentroidalMomentum(model, data, q, v)
        np.testing.assert_allclose(momentum.angular, 0.0, atol=1e-12)


def test_top_example_precesses_at_two_radians_per_second() -> None:
    """At a tilt of 60° (Lagrange)."""
    traj = pinred.simulate(pinred.load_scene(EXAMPLES / "heavy_top.toml"))
    axis = traj.system.group.matrix(traj.pose)[:, :3, 2]
    np.testing.assert_allclose(axis[:, 2], 0.5, atol=1e-8)
    turned = np.unwrap(np.arctan2(axis[:, 1], axis[:, 0]))
    np.testing.assert_allclose(turned - turned[0], 2.0 * traj.t, atol=1e-7)


@pytest.mark.slow
def test_run_prints_summary_and_writes_motion(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command compares the motion and exits with 0."""
    path, out = str(EXAMPLES / "thruster.toml"), tmp_path / "traj.npz"
    assert main(["run", path, "--out", str(out), "--compare", "--explain"]) == 0
    printed = capsys.readouterr().out
    traj = pinred.simulate(pinred.load_scene(path))
    work = traj.energy_balance.work[-1, 0]
    for words in (
        "skipped: ", "reaction_wheel_satellite: SE3 × 4 joints, 5 s", "steps ", "wall time",
        f"work of thruster [J]  {work:.6g}", "energy balance", "momentum balance",
        f"written to {out}", "verdict: PASSED",
    ):  # fmt: skip
        assert words in printed
    with np.load(out) as file:
        np.testing.assert_array_equal(file["q"], traj.q)


def test_run_with_coarse_steps_exits_with_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The comparison fails."""
    text = "robot = 'falling_cat'\nrun = { duration = 1, method = { name = 'RKMK4', step = 0.2 } }"
    assert main(["run", str(written(tmp_path, text)), "--compare"]) == 1
    assert "verdict: FAILED" in capsys.readouterr().out


def test_run_engine_option_replaces_engine_of_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without the base, no balances are printed."""
    path = written(
        tmp_path,
        "robot = 'cartpole'\nrun = { duration = 0.2, engine = 'pinocchio', outputs = 'shape' }",
    )
    assert main(["run", str(path)]) == 0
    printed = capsys.readouterr().out
    assert "(pinocchio)" in printed
    assert "no balance" in printed
    assert main(["run", str(path), "--engine", "compiled"]) == 0
    assert "(compiled)" in capsys.readouterr().out


@pytest.mark.by_hand
def test_two_processes_write_the_same_bytes(tmp_path: Path) -> None:
    """The same scene gives the same file."""
    files = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for seed, file in enumerate(files):
        subprocess.run(
            [sys.executable, "-m", "pinred", "run", str(EXAMPLES / "thruster.toml"), "--out", file],
            check=True, capture_output=True,
            env=dict(os.environ, PYTHONHASHSEED=str(seed)),
        )  # fmt: skip
    assert files[0].read_bytes() == files[1].read_bytes()


def test_method_options_of_command_line_match_scene(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """--method, --step and --outputs of simulate and compare."""
    out = tmp_path / "traj.npz"
    arguments = ["simulate", "falling_cat", "--duration", "0.5", "--samples", "5"]
    arguments += ["--out", str(out)]
    extra = ["--method", "RKMK4", "--step", "0.01", "--outputs", "shape"]
    assert main([*arguments, *extra]) == 0
    assert "RKMK4" in capsys.readouterr().out
    traj = pinred.simulate(
        pinred.load("falling_cat"), duration=0.5, times=np.linspace(0, 0.5, 5),
        method=RKMK4(0.01), outputs="shape",
    )  # fmt: skip
    with np.load(out) as file:
        np.testing.assert_array_equal(file["x"], traj.x)
        assert "pose" not in file
    cases: list[tuple[list[str], Method]] = [
        (["--method", "Gauss", "--step", "0.01", "--order", "4"], Gauss(0.01, 4)),
        (["--method", "Gauss(0.01, order=4)"], Gauss(0.01, 4)),
        (["--method", "Variational", "--step", "0.01"], Variational(0.01)),
        (["--method", "Radau", "--rtol", "1e-6"], Radau(1e-7, 1e-13)),
        (["--method", "Radau(1e-6)"], Radau(1e-6, 1e-10)),
    ]
    for given, method in cases:
        assert main([*arguments, *given]) == 0
        assert method.name in capsys.readouterr().out
        found = pinred.simulate(
            pinred.load("falling_cat"), times=np.linspace(0, 0.5, 5), method=method
        )
        with np.load(out) as file:
            np.testing.assert_array_equal(file["x"], found.x)
    for wrong, words in (
        (["--method", "RKMK4"], "method 'RKMK4' needs a step, as in RKMK4(0.01)"),
        (["--method", "Gauss", "--order", "4"], "needs a step, as in Gauss(0.01)"),
        (["--method", "Radau", "--step", "0.1"], "requires --method"),
        (["--method", "RKMK4(0.1)", "--step", "0.1"], "must be a name, or a name with options"),
        (["--method", "DOP853(1e-8)", "--rtol", "1e-6"], "rtol conflicts with the tol"),
        (["--step", "0.1"], "requires --method"),
        (["--method", "Euler"], f"the methods are {', '.join(METHODS)}"),
        (["--method", "Radau", "--order", "4"], "--order P requires --method Gauss"),
        (["--method", "Gauss", "--step", "0.1", "--order", "5"], "order must be one of 2"),
        (["--outputs", "base"], "outputs must be one of all, shape"),
        ([*extra, "--engine", "pinocchio"], "expected none with engine"),
    ):
        assert main([*arguments, *wrong]) == 2
        assert words in capsys.readouterr().err
