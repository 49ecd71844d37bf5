"""Tests of gait files against gaits and connections created in Python."""

from __future__ import annotations

import tomllib
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from assertions import close
from three_links import CENTRES, LENGTH, LINKS

import pinred

ROOT = Path(__file__).parents[2]
HEAD = "robot = 'three_rods'\n"
CIRCLE = "[gait]\nkind = 'fourier'\nmean = [0.0, 0.0]\ncos = [[1.0, 0.0]]\nsin = [[0.0, 1.0]]\n"


def read(folder: Path, text: str) -> pinred.GaitFile:
    """Read a file with this text, and validate the text against the schema."""
    path = folder / "gait.toml"
    path.write_text(text, "utf-8")
    contents = pinred.load_gait(path)
    jsonschema.validate(tomllib.loads(text), pinred.gait_schema())
    return contents


def test_example_file_is_purcells_circle() -> None:
    """The example file gives the published displacement."""
    file = pinred.load_gait(ROOT / "examples/gaits/purcell_circle.toml")
    p = pinred.phase(file.connection, file.path, file.momentum, tolerance=1e-12)
    assert float(np.hypot(*p.pose[:2])) == pytest.approx(0.0512808243, abs=5e-11)


@pytest.mark.parametrize(
    ("text", "shape"),
    [
        ("kind = 'waypoints'\npoints = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]", [0.0, 0.0]),
        ("kind = 'spline'\npoints = [[0.1, 0.0], [1, 0], [0, 1]]\nperiod = 2", [0.1, 0.0]),
        (
            "kind = 'strokes'\nstart = [0.2, 0]\n"
            "moves = [{alpha1 = 1}, {alpha2 = 1}, {alpha1 = -1, alpha2 = -1}]",
            [0.2, 0.0],
        ),
    ],
)
def test_load_gait_reads_each_kind_of_gait(text: str, shape: list[float], tmp_path: Path) -> None:
    """Each kind has the name of its function."""
    file = read(tmp_path, f"{HEAD}[gait]\n{text}\n")
    close(file.path.at(0.0)[0], shape)
    assert file.connection.joints == ("alpha1", "alpha2")


def test_load_gait_reads_recorded_joint_data(tmp_path: Path) -> None:
    """The data file is relative to the gait file."""
    t = np.linspace(0.0, 1.0, 21)
    x = np.stack([np.cos(2 * np.pi * t), np.sin(2 * np.pi * t)], axis=1)
    np.savez(tmp_path / "loop.npz", t=t, x=x)
    file = read(tmp_path, f"{HEAD}[gait]\nkind = 'recorded'\nfile = 'loop.npz'\n")
    close(file.path.at(0.25)[0], [0.0, 1.0], 1e-12)


def test_load_gait_reads_each_kind_of_connection(tmp_path: Path) -> None:
    """Wheels, fluid, momentum and base equal those created in Python."""
    wheels = ", ".join(
        f"{{kind = 'wheel', link = '{name}', at = [{CENTRES[name]}, 0.0, 0.0]}}" for name in LINKS
    )
    gait = CIRCLE.replace("[0.0, 0.0]\ncos = [[1.0", "[1.0, -0.5]\ncos = [[0.3")
    file = read(tmp_path, f"{HEAD}[connection]\nkind = 'kinematic'\nwheels = [{wheels}]\n{gait}")
    x = [0.9, -0.4]
    own = [pinred.Wheel(name, (CENTRES[name], 0.0, 0.0)) for name in LINKS]
    same = pinred.Connection.kinematic(pinred.load("three_rods"), own)
    close(file.connection.local(x), same.local(x))
    bodies = "\n".join(
        f"bodies.{name} = {{kind = 'ellipse', a = {0.5 * LENGTH}, b = 0.04}}" for name in LINKS
    )
    text = f"{HEAD}base = 'front'\n[connection]\nkind = 'fluid'\ndensity = 1.3\n{bodies}\n{CIRCLE}"
    fluid = read(tmp_path, text)
    ellipses = {name: pinred.Ellipse(0.5 * LENGTH, 0.04) for name in LINKS}
    swimmer = pinred.Connection.fluid(pinred.load("three_rods"), 1.3, ellipses)
    close(fluid.connection.local(x), swimmer.seen_from("front").local(x))
    close(read(tmp_path, f"{HEAD}momentum = [0.1, 0.2, 0.3]\n{CIRCLE}").momentum, [0.1, 0.2, 0.3])
    close(read(tmp_path, f"{HEAD}momentum = 0\n{CIRCLE}").momentum, np.zeros(3))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            f"{HEAD}[optimise]\nobjectives = 'rotation'\n",
            "objectives: unknown key",
        ),
        (
            f"{HEAD}[optimise]\ncost = 'love'\n",
            "cost: unknown value .love.; it can be length",
        ),
        (f"{HEAD}[optimise]\nwinding = 2\n", "winding: must be a whole number from 1 to 1"),
        (f"{HEAD}[optimise]\nlimits = [[1.0, 2.0, 3.0]]\n", "limits"),
        (f"{HEAD}[reorient]\ncycles = 2\n", "'target' is missing"),
        (
            f"{HEAD}[reorient]\ntarget = 0.3\nspeeds = -1.0\n",
            "speeds: must be finite and",
        ),
        (f"{HEAD}[gait]\nkind = 'circle'\n", r"line 3: gait.kind: unknown kind .circle."),
        (
            f"{HEAD}momentum = [1.0]\n{CIRCLE}",
            r"line 2: momentum: expected 3 numbers: px, py, L, got 1",
        ),
        (f"{HEAD}base = 'nope'\n{CIRCLE}", r"base: the base: no moving link 'nope'"),
        (f"{HEAD}[gait]\nkind = 'waypoints'\npoints = [[0.0], [1.0]]\n", "moves 1 joints"),
        (f"{HEAD}[connection]\nkind = 'kinematic'\nwheels = []\n{CIRCLE}", "needs 3 wheels"),
        (f"robot = 'nobody.urdf'\n{CIRCLE}", "no such file"),
        ("robot = ", "not TOML"),
        (f"{HEAD}speed = 1.0\n{CIRCLE}", "unknown key"),
    ],
)
def test_load_gait_rejects_invalid_files(text: str, message: str, tmp_path: Path) -> None:
    """The message is one line with file, line and key."""
    path = tmp_path / "gait.toml"
    path.write_text(text, "utf-8")
    with pytest.raises(pinred.PinredError, match=message) as caught:
        pinred.load_gait(path)
    assert "gait.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_gait_signals_prescribe_joints_periodically() -> None:
    """Signals of shifted and reversed gaits prescribe the joints, too."""
    gait = pinred.Gait.fourier(
        [0.2, 0.0, -0.1], [[0.3, 0.0, 0.2], [0.1, 0.0, 0.0]], [[0.0, 0.4, 0.1], [0.0, 0.1, 0.1]]
    )
    cat = pinred.load("falling_cat")
    for path in (gait, gait.shifted(0.3), gait.reversed().lasting(2.0)):
        plans = path.signals(cat.shape_names)
        traj = pinred.simulate(
            cat, prescribed=plans, momentum=0, times=np.linspace(0.0, 1.7 * path.period, 7)
        )
        close(traj.x, path.at(traj.t)[0], 1e-12)
        close(traj.xdot, path.at(traj.t)[1], 1e-11)
    corners = pinred.Gait.waypoints([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    with pytest.raises(pinred.InputError, match="one Fourier series"):
        corners.signals(["a", "b"])


def test_load_gait_reads_objectives_as_python_options(tmp_path: Path) -> None:
    """Missing options have Python's defaults."""
    text = f"""{HEAD}[optimise]
objective = "rotation"
cost = "none"
winding = 1
limits = {{ alpha1 = 1.5, alpha2 = [-1.0, 1.2] }}
harmonics = 1
starts = 1
[reorient]
target = 0.3
limits = [2.5, [-2.0, 2.0]]
x0 = {{ alpha1 = 0.4, alpha2 = 0.5 }}
"""
    file = read(tmp_path, text)
    assert file.gait is None
    best = pinred.optimise_gait(file.connection, **file.optimise)
    same = pinred.optimise_gait(
        file.connection, cost=None, limits={"alpha1": 1.5, "alpha2": [-1.0, 1.2]}, harmonics=1,
        starts=1,
    )  # fmt: skip
    assert best.value == pytest.approx(same.value, rel=1e-12)
    assert (best.gait.limits[1] >= [-1.0, -1.0]).all()
    plan = pinred.reorient(file.system, **file.reorient)
    assert plan.missed < 1e-8
    close(plan.gait.at(0.0)[0], [0.4, 0.5], 1e-12)
    with pytest.raises(pinred.InputError, match="no gait of 'three_rods'"):
        _ = file.path
    tumbling = read(tmp_path, f"momentum = [0.0, 0.0, 0.01]\n{text}")
    close(tumbling.reorient["momentum"], [0.0, 0.0, 0.01])


def test_gait_file_of_ball_gives_phase_of_python(tmp_path: Path) -> None:
    """Axes have labels, the centre a joint name, and recorded data has one column for each axis."""
    head = "robot = 'falling_cat_ball'\ncentre = {spine = [0.1, -0.4, 0.2]}\n"
    moves = "moves = [{'spine.y' = 0.7}, {'spine.z' = 0.9}, {'spine.y' = -0.7, 'spine.z' = -0.9}]"
    file = read(tmp_path, f"{head}[gait]\nkind = 'strokes'\nstart = [0.1, 0.0, 0.3]\n{moves}\n")
    assert file.connection.joints == ("spine.x", "spine.y", "spine.z")
    corners = [[0.1, 0.0, 0.3], [0.1, 0.7, 0.3], [0.1, 0.7, 1.2]]
    cat = pinred.Connection.mechanical(pinred.load("falling_cat_ball"))
    quaternion = cat.space.integrate(cat.space.neutral, np.array([0.1, -0.4, 0.2]))
    expected = pinred.phase(cat.in_chart(quaternion), pinred.Gait.waypoints(corners)).pose
    close(pinred.phase(file.connection, file.path).pose, expected, 1e-12)
    assert np.abs(pinred.phase(cat, file.path).pose - expected).max() > 1e-2
    points = np.stack([np.linspace(0.0, 1.0, 41), *np.zeros((3, 41))], axis=1)
    points[:, 2] = np.cos(2.0 * np.pi * points[:, 0])
    points[:, 3] = np.sin(2.0 * np.pi * points[:, 0])
    np.savetxt(
        tmp_path / "loop.csv", points, "%.17g", ",", header="t,spine.x,spine.y,spine.z", comments=""
    )
    file = read(tmp_path, f"{head}[gait]\nkind = 'recorded'\nfile = 'loop.csv'\n")
    circle = pinred.Gait.fourier([0.0] * 3, [[0.0, 1.0, 0.0]], [[0.0, 0.0, 1.0]])
    exact = pinred.phase(cat.in_chart(quaternion), circle).pose
    close(pinred.phase(file.connection, file.path).pose, exact, 1e-4)
    with pytest.raises(pinred.InputError, match=r"line 2: centre: no shape joint 'neck'"):
        read(tmp_path, f"{head.replace('spine', 'neck')}")
