"""The command line: exit codes, one-line errors, files, and a fast start."""

from __future__ import annotations

import csv
import os
from pathlib import Path

import numpy as np
import pytest
from commands import python, refused, run
from robot_texts import FLOATING, write

import pinred
from pinred.cli.command_line import COMMANDS
from pinred.integrators.methods import METHODS
from pinred.lie import GROUPS
from pinred.scene.scene_options import ENGINES, OUTPUTS
from pinred.system.find_robot_files import bundled_robots


def test_compare_prints_verdict_and_exits_with_zero(capsys: pytest.CaptureFixture[str]) -> None:
    """The table of the comparison is printed."""
    code, out, err = run(capsys, "compare", "falling_cat", "--duration", "1")
    assert (code, err) == (0, "")
    assert "SE3 ×" in out
    assert "verdict: PASSED" in out


@pytest.mark.by_hand
@pytest.mark.slow
def test_compare_accepts_prescribed_joint_and_method(capsys: pytest.CaptureFixture[str]) -> None:
    """Values by joint, a formula and a method with options pass the comparison."""
    code, out, err = run(
        capsys, "compare", "falling_cat", "--duration", "0.5", "--x0", "bend=-0.5,twist=0.3",
        "--momentum", "0", "--prescribed", "sway=0.4*(1 - cos(pi*t))", "--method", "Radau",
    )  # fmt: skip
    assert (code, err) == (0, "")
    assert "verdict: PASSED" in out


@pytest.mark.slow
def test_compare_that_cannot_tell_exits_with_three(capsys: pytest.CaptureFixture[str]) -> None:
    """The verdict is neither PASSED nor FAILED."""
    code, out, _ = run(
        capsys, "compare", "double_spherical_pendulum", "--x0", "2,1,2.5", "--xdot0", "4,-5,6",
        "--xi0", "3", "--duration", "10", "--rtol", "1e-6", "--atol", "1e-8",
    )  # fmt: skip
    assert code == 3
    assert "verdict: CANNOT TELL" in out


def test_compare_with_long_steps_exits_with_one(capsys: pytest.CaptureFixture[str]) -> None:
    """The steps are too long for the tolerance."""
    code, out, _ = run(
        capsys, "compare", "falling_cat", "--duration", "2", "--method", "RKMK4(0.1)",
    )  # fmt: skip
    assert code == 1
    assert "verdict: FAILED" in out


def test_compare_prints_the_seed(capsys: pytest.CaptureFixture[str]) -> None:
    """The seed of a random state allows repeating the run."""
    code, out, _ = run(capsys, "compare", "rigid_body", "--seed", "3", "--duration", "1")
    assert code == 0
    assert "seed 3" in out


def test_inspect_prints_reduced_quantities(capsys: pytest.CaptureFixture[str]) -> None:
    """Group, joints, I, A, M, |B|, symmetries and skipped parts at a shape."""
    code, out, _ = run(capsys, "inspect", "reaction_wheel_satellite", "--at", "-0.5,1,2,3")
    assert code == 0
    system = pinred.load("reaction_wheel_satellite")
    seen = pinred.inspect(system, [-0.5, 1.0, 2.0, 3.0])
    for words in ("group SE3", "locked inertia (6, 6)", "local connection (6, 4)",
                  "reduced metric (4, 4)", "curvature", "x =      (-0.5, 1, 2, 3)",
                  f"{seen.curvature_norm:.6g}", f"→ {seen.reduced_size} numbers"):  # fmt: skip
        assert words in out
    for name in system.shape_names:
        assert name in out
    assert len(seen.cyclic) == 3
    assert f"cyclic joints, whose momentum is constant: {', '.join(seen.cyclic)}" in out
    # Full: pose 7, twist 6, and an angle (cos and sin if continuous) and a rate a joint.
    assert seen.full_size == system.model.nq + system.model.nv
    # Reduced: quaternion, (x, π) of the hinge, angles of the three cyclic wheels.
    assert seen.reduced_size == 4 + 2 + 3


def test_inspect_of_pivot_in_gravity_names_the_conserved_axis(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Gravity reduces SO(3) to rotations about the vertical."""
    arguments = ("inspect", "coupled_spatial", "--group", "SO3", "--gravity", "0,0,-9.81")
    code, out, _ = run(capsys, *arguments)
    assert code == 0
    assert "conserves angular momentum about the direction of gravity" in out
    assert "integrated  16 → 13 numbers" in out


def test_inspect_reports_gravity_that_breaks_the_symmetry(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The reduced quantities are printed all the same."""
    code, out, _ = run(capsys, "inspect", "double_spherical_pendulum", "--gravity", "1,0,0")
    assert code == 0
    assert "breaks the SO2 symmetry" in out
    assert "locked inertia" in out


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_simulate_writes_states_of_the_python_api(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, suffix: str
) -> None:
    """Other tools can open the files."""
    path = tmp_path / f"traj{suffix}"
    code, out, _ = run(
        capsys,
        "simulate",
        "coupled_planar",
        "--duration",
        "2",
        "--samples",
        "5",
        "--out",
        str(path),
    )
    assert code == 0
    assert str(path) in out
    assert os.listdir(tmp_path) == [path.name]
    system = pinred.load("coupled_planar")
    traj = pinred.simulate(system, duration=2.0, times=np.linspace(0.0, 2.0, 5))
    if suffix == ".npz":
        with np.load(path, allow_pickle=False) as file:
            assert str(file["robot"]) == "coupled_planar"
            assert list(file["joints"]) == list(system.shape_names)
            for name in ("t", "x", "xdot", "xi", "pose", "q", "v", "body_momentum", "energy"):
                np.testing.assert_array_equal(file[name], getattr(traj, name))
        return
    with path.open(encoding="utf-8") as text:
        rows = list(csv.DictReader(text))
    assert len(rows) == 5
    for k, row in enumerate(rows):
        assert float(row["t"]) == traj.t[k]
        assert float(row["pose.theta"]) == traj.pose[k, 2]
        assert float(row["x.hinge"]) == traj.x[k, 0]
        assert float(row["energy"]) == traj.energy[k]


def test_failed_write_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No partial file remains."""
    traj = pinred.simulate(pinred.load("coupled_planar"), duration=0.1)
    path = tmp_path / "traj.csv"
    path.write_text("old")

    def broken(file: object, *_: object, **__: object) -> None:
        file.write(b"half")  # type: ignore[attr-defined]
        raise OSError("disk full")

    monkeypatch.setattr(np, "savetxt", broken)
    with pytest.raises(pinred.OutputError, match="disk full"):
        traj.save(path)
    assert os.listdir(tmp_path) == ["traj.csv"]
    assert path.read_text() == "old"


def test_robots_lists_bundled_robots(capsys: pytest.CaptureFixture[str]) -> None:
    """The list has groups and descriptions."""
    code, out, _ = run(capsys, "robots")
    assert code == 0
    for name, robot in bundled_robots().items():
        assert f"{name} " in out
        assert robot.description in out


def test_both_engines_pass_the_comparison(capsys: pytest.CaptureFixture[str]) -> None:
    """The table names the engine."""
    for engine in ("compiled", "pinocchio"):
        code, out, _ = run(capsys, "compare", "cartpole", "--duration", "1", "--engine", engine)
        assert code == 0
        assert f"reduced ({engine})" in out
    code, _, err = run(capsys, "compare", "cartpole", "--engine", "steam")
    assert code == 2
    assert "engine: expected one of compiled, pinocchio" in err


def test_cache_lists_and_clears_kernels(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The cache is listed, cleared and empty."""
    monkeypatch.setenv("PINRED_CACHE_DIR", str(tmp_path / "kernels"))
    assert run(capsys, "compare", "cartpole", "--duration", "0.1")[0] == 0
    code, out, _ = run(capsys, "cache")
    assert code == 0
    assert out.startswith("2 compiled objects, ")
    code, out, _ = run(capsys, "cache", "--clear")
    assert out.startswith("2 compiled objects removed")
    assert run(capsys, "cache")[1].startswith("0 compiled objects")


@pytest.mark.by_hand
def test_cache_warm_prepares_the_calls_on_a_robot(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A second run finds everything, and so do simulations, batches and flows."""
    monkeypatch.setenv("PINRED_CACHE_DIR", str(tmp_path))
    code, out, _ = run(capsys, "cache", "warm", "elroys_beanie")
    assert code == 0
    for call in ("simulate(method=Radau)", "simulate_many", "flow.jacobian", "flow.vjp"):
        assert f" s  {call}" in out
    stored = sorted(path.name for path in tmp_path.rglob("*") if path.is_file())
    assert run(capsys, "cache", "warm", "elroys_beanie")[0] == 0
    system = pinred.load("elroys_beanie")
    pinred.simulate(system, seed=3, method="AdaptiveGauss")
    pinred.simulate_many(system, seeds=[1, 2], duration=0.1)
    pinred.flow(system, seed=1, duration=0.1).jacobian()
    assert sorted(path.name for path in tmp_path.rglob("*") if path.is_file()) == stored


def test_cache_refuses_other_words(capsys: pytest.CaptureFixture[str]) -> None:
    """The message shows the form."""
    assert "pinred cache warm ROBOT" in refused(capsys, "cache", "cool", "falling_cat")


@pytest.mark.slow
def test_bench_kernels_prints_ratios_to_aba(capsys: pytest.CaptureFixture[str]) -> None:
    """Kernels are much faster than ABA from Python."""
    ratios: dict[str, float] = {}
    for _ in range(3):  # whatever else the machine does at the time, once it is not in the way
        code, out, _ = run(capsys, "bench", "kernels", "coupled_planar", "falling_cat")
        assert code == 0
        rows = {line.split()[0]: float(line.split()[-1]) for line in out.splitlines()[2:]}
        assert set(rows) == {"coupled_planar", "falling_cat"}
        ratios = {name: max(ratio, ratios.get(name, 0.0)) for name, ratio in rows.items()}
        if ratios["coupled_planar"] > 25.0 and ratios["falling_cat"] > 2.0:
            break
    assert ratios["coupled_planar"] > 25.0
    assert ratios["falling_cat"] > 2.0


URDF = """<robot name="r"><link name="base"><inertial><mass value="{mass}"/>
<inertia ixx="{ixx}" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="tip"><inertial><origin xyz="1 0 0"/><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="elbow" type="continuous"><parent link="base"/><child link="tip"/>
<axis xyz="0 1 0"/></joint></robot>"""


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("compare", "missing.urdf"), "no such file"),
        (("compare", "text.urdf"), "not XML"),
        (("compare", "massless.urdf"), "mass"),
        (("compare", "negative.urdf"), "negative mass -1"),
        (("compare", "flat.urdf", "--strict"), "triangle inequality"),
        (("compare", "good.urdf", "--group", "SO4"), "unknown group 'SO4'; the groups are R, SO2"),
        (
            ("compare", "good.urdf", "--group", "SO2", "--gravity", "9,0,0"),
            "breaks the SO2 symmetry",
        ),
        (("compare", "good.urdf", "--lock", "knee"), "no joint 'knee'; the joints are elbow"),
        (("compare", "good.urdf", "--duration", "0"), "duration must be finite and above zero"),
        (("compare", "good.urdf", "--duration", "-3"), "duration"),
        (("compare", "good.urdf", "--duration", "soon"), "--duration"),
        (("compare", "good.urdf", "--rtol", "nan"), "rtol"),
        (("compare", "good.urdf", "--x0", "1,2"), r"x0: expected 1 number: elbow, got 2"),
        (("compare", "good.urdf", "--x0", "nan"), "finite"),
        (("compare", "good.urdf", "--x0", "a"), "--x0 takes numbers"),
        (("compare", "good.urdf", "--x0", "elbow=a"), "--x0 takes numbers, or JOINT=NUMBER for"),
        (("compare", "good.urdf", "--x0", "1,elbow=1"), "JOINT=V1,V2,V3 for a ball, got '1'"),
        (("compare", "good.urdf", "--x0", "elbow=1,elbow=2"), "--x0 has joint 'elbow' twice"),
        (
            ("compare", "good.urdf", "--xdot0", "ebow=1"),
            "xdot0: no shape joint 'ebow'; did",
        ),
        (("compare", "good.urdf", "--q0", "1,2"), "q0 must have shape (9,), got (2,)"),
        (("compare", "good.urdf", "--v0", "elbow=1"), "--v0 takes numbers"),
        (("compare", "good.urdf", "--seed", "1", "--v0", "0"), "do not combine it with v0"),
        (
            ("compare", "good.urdf", "--prescribed", "elbow"),
            "--prescribed takes JOINT=NUMBER, JOINT=FORMULA",
        ),
        (("compare", "good.urdf", "--prescribed", "elbow=sin(x)"), "prescribed['elbow']: the expr"),
        (("compare", "good.urdf", "--prescribed", "knee=0"), "no shape joint 'knee'"),
        (
            ("compare", "good.urdf", "--prescribed", "elbow=0", "--prescribed", "elbow=1"),
            "--prescribed has joint 'elbow' twice",
        ),
        (
            ("compare", "good.urdf", "--method", "Gauss"),
            "method 'Gauss' needs a step",
        ),
        (("compare", "good.urdf", "--gravity", "1,2"), "gravity must have shape (3,)"),
        (("compare", "good.urdf", "--springs", "elbow"), "--springs takes JOINT=STIFFNESS"),
        (("inspect", "good.urdf", "--at", "0,0"), "expected 1 number: elbow, got 2"),
        (("simulate", "good.urdf", "--out", "traj.txt"), "suffix must be .npz or .csv or .h5"),
        (("simulate", "good.urdf", "--out", "no/traj.npz"), "no folder"),
        (("simulate", "good.urdf", "--out", "t.npz", "--samples", "1"), "--samples"),
        (("simulate", "good.urdf"), "--out"),
        (("compare", "falling_dog"), "did you mean falling_cat"),
        (("inspect",), "ROBOT"),
        ((), "COMMAND"),
        (("fly",), "fly"),
    ],
)
def test_bad_input_is_one_line_and_exit_two(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    words: str,
) -> None:
    """The message is one line on standard error."""
    monkeypatch.chdir(tmp_path)
    Path("good.urdf").write_text(URDF.format(mass=1, ixx=1))
    Path("negative.urdf").write_text(URDF.format(mass=-1, ixx=1))
    Path("flat.urdf").write_text(URDF.format(mass=1, ixx=3))
    Path("massless.urdf").write_text('<robot name="r"><link name="base"/></robot>')
    Path("text.urdf").write_text("hello")
    assert words in refused(capsys, *arguments)
    assert not list(tmp_path.glob("*.npz"))


def test_doubtful_robot_is_warned_about_or_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """--strict, and a strict scene, turn the warning into an error."""
    robot = write(tmp_path, FLOATING.replace('izz="2.5"', 'izz="4"'))
    code, out, err = run(capsys, "inspect", str(robot))
    assert code == 0
    assert "SE3" in out
    assert err.startswith("pinred: warning: 'arm': ")
    assert err.count("\n") == 1
    code, out, err = run(capsys, "inspect", str(robot), "--strict")
    assert (code, out) == (2, "")
    assert "triangle inequality" in err
    scene = tmp_path / "scene.toml"
    scene.write_text("robot = 'arm.urdf'\n[load]\nstrict = true\n")
    code, out, err = run(capsys, "run", str(scene))
    assert code == 2
    assert "triangle inequality" in err


def test_import_and_help_do_not_import_heavy_packages() -> None:
    """This holds for `import pinred` and for `pinred --help`."""
    heavy = "{'pinocchio', 'numpy', 'scipy', 'meshcat', 'casadi', 'numba', 'matplotlib'}"
    assert python(f"import sys, pinred; print({heavy} & set(sys.modules))") == "set()\n"
    code = (
        "import sys\nfrom pinred.cli.command_line import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        f"print({heavy} & set(sys.modules))"
    )
    assert python(code).endswith("set()\n")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(capsys: pytest.CaptureFixture[str], command: str) -> None:
    """The module of a command is imported when the command is used."""
    code, out, _ = run(capsys, command, "--help")
    assert code == 0
    assert f"pinred {command}" in out
    assert COMMANDS[command][1:] in " ".join(out.split())


def test_help_names_every_method(capsys: pytest.CaptureFixture[str]) -> None:
    """Also groups, engines and outputs."""
    for command in ("simulate", "compare"):
        _, out, _ = run(capsys, command, "--help")
        assert "(default: auto)" in out
        for name in (*METHODS, *GROUPS, *ENGINES, *OUTPUTS):
            assert name in out
