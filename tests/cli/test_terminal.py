"""ASCII terminals, and file names that are not text: no traceback."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pinred.cli.command_line import COMMANDS, nearest_ascii

ROOT = Path(__file__).parents[2]
SCENE = "examples/cat_turns_over.toml"


def run(
    *words: str | bytes, encoding: str = "ascii", cwd: Path = ROOT
) -> subprocess.CompletedProcess[bytes]:
    """Run a command on a terminal of some encoding."""
    env = os.environ | {"PYTHONIOENCODING": encoding, "PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.run(
        [sys.executable, "-m", "pinred", *words], cwd=cwd, env=env, capture_output=True, check=False
    )


@pytest.mark.parametrize(
    "words",
    [
        ("inspect", "falling_cat"),
        pytest.param(("compare", "falling_cat", "--duration", "0.1"), marks=pytest.mark.by_hand),
        pytest.param(("run", SCENE, "--validate", "--explain"), marks=pytest.mark.by_hand),
        pytest.param(("run", SCENE, "--compare"), marks=pytest.mark.by_hand),
        ("robots",),
        ("run", "--schema"),
        pytest.param(("stress", "--only", "units"), marks=pytest.mark.by_hand),
    ],
)
@pytest.mark.sampled
def test_commands_print_ascii_on_ascii_terminal(words: tuple[str, ...]) -> None:
    """The exit code does not change."""
    done = run(*words)
    assert done.returncode == 0, done.stderr.decode()
    assert done.stdout.decode("ascii")
    assert b"Traceback" not in done.stderr


OTHERS = [pytest.param(name, marks=pytest.mark.by_hand) for name in COMMANDS if name != "gait"]


@pytest.mark.by_hand
@pytest.mark.parametrize("command", ["", "gait", *OTHERS])
def test_help_is_ascii_on_ascii_terminal(command: str) -> None:
    """Except for single letters, each page is the same as on other terminals."""
    words = [command, "--help"] if command else ["--help"]
    done = run(*words)
    assert done.returncode == 0, done.stderr.decode()
    assert done.stdout.decode("ascii").startswith("usage")
    wide = run(*words, encoding="utf-8").stdout.decode()
    assert "".join(c if c.isascii() else nearest_ascii(c) for c in wide) == done.stdout.decode()


@pytest.mark.slow
def test_errors_are_one_ascii_line() -> None:
    """The message is printed without a traceback."""
    done = run("inspect", "kätzchen×²")
    assert done.returncode == 2
    assert b"unknown robot 'katzchenx^2'" in done.stderr
    assert done.stderr.count(b"\n") == 1


@pytest.mark.by_hand
def test_nearest_ascii_keeps_encodable_characters() -> None:
    """Other characters become the nearest ASCII text."""
    assert "m/s^2" in run("inspect", "falling_cat").stdout.decode()
    assert "m/s²" in run("inspect", "falling_cat", encoding="latin-1").stdout.decode("latin-1")
    assert "m/s²" in run("inspect", "falling_cat", encoding="utf-8").stdout.decode()
    assert "".join(map(nearest_ascii, "×é\udcff中")) == "xe\\xff\\u4e2d"


@pytest.mark.by_hand
@pytest.mark.parametrize("encoding", [pytest.param("utf-8", marks=pytest.mark.by_hand), "ascii"])
def test_undecodable_file_names_are_accepted_or_refused(tmp_path: Path, encoding: str) -> None:
    """Motions and scenes accept them; robot files do not."""
    folder = Path(os.fsdecode(bytes(tmp_path) + b"/f\xff"))
    folder.mkdir()
    scene, out = bytes(folder) + b"/s\xfe.toml", bytes(folder) + b"/m\xfd.npz"
    Path(os.fsdecode(scene)).write_text("robot = 'falling_cat'\nrun = { duration = 0.1 }\n")
    done = run("run", scene, "--out", out, encoding=encoding)
    assert done.returncode == 0, done.stderr.decode()
    assert b"\\xfd.npz" in done.stdout
    page = bytes(folder) + b"/p\xfc.html"
    done = run("play", out, "--out", page, encoding=encoding)
    assert done.returncode == 0, done.stderr.decode()
    for name, content in ((b"r\xfb.urdf", "<robot name='r'><link name='a'/></robot>"),
                          (b"r\xfb.xml", "<mujoco/>")):  # fmt: skip
        robot = bytes(folder) + b"/" + name
        Path(os.fsdecode(robot)).write_text(content)
        done = run("inspect", robot, encoding=encoding)
        assert done.returncode == 2
        assert b"bytes that are not UTF-8" in done.stderr
        assert done.stderr.count(b"\n") == 1
    done = run("run", bytes(folder) + b"/gone\xfa.toml", encoding=encoding)
    assert done.returncode == 2
    assert done.stderr.count(b"\n") == 1
