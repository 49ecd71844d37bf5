"""Wheel and sdist, installed outside of the checkout with lowest and highest dependencies."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
UV = Path(sys.executable).with_name("uv")
CASES = [
    ("3.11", "whl", "lowest-direct"),
    ("3.11", "whl", "highest"),
    ("3.12", "tar.gz", "highest"),
    ("3.13", "whl", "highest"),
]

pytestmark = pytest.mark.by_hand


def call(*command: str | Path, folder: Path) -> str:
    """Run a command without variables that lead to the checkout; return its output."""
    private = {"PINRED_CACHE_DIR": "cache", "XDG_DATA_HOME": "data"}
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    environment |= {name: str(folder / value) for name, value in private.items()}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def find_python(version: str) -> Path:
    """Return an interpreter of a version, from pyenv or the search path; skip without one."""
    paths = [*Path.home().glob(f".pyenv/versions/{version}.*/bin/python")]
    paths += [Path(path) for path in [shutil.which(f"python{version}")] if path]
    for path in paths:
        code = "import sys; print(*sys.version_info[:2], sep='.')"
        shown = subprocess.run([path, "-c", code], capture_output=True, text=True, check=False)
        if shown.stdout.strip() == version:
            return path
    pytest.skip(f"there is no Python {version}")


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with wheel and sdist."""
    if not UV.exists():
        pytest.skip("needs uv: pip install uv")
    folder = tmp_path_factory.mktemp("dist")
    call(UV, "build", "--quiet", "--out-dir", folder, ROOT, folder=folder)
    return folder


@pytest.mark.parametrize(("python", "kind", "dependencies"), CASES)
def test_installed_package_simulates(
    built: Path, tmp_path: Path, python: str, kind: str, dependencies: str
) -> None:
    """In a new environment: doctor, compare, simulate with a checkpoint, and the recording."""
    interpreter = find_python(python)
    (package,) = built.glob(f"*.{kind}")
    pins = tmp_path / "pins.txt"
    resolve = ["pip", "compile", "--quiet", "--python-version", python]
    resolve += ["--resolution", dependencies, "--output-file", str(pins)]
    call(UV, *resolve, ROOT / "pyproject.toml", folder=tmp_path)
    call(UV, "venv", "--quiet", "--python", interpreter, "venv", folder=tmp_path)
    where = ["--quiet", "--python", "venv/bin/python"]
    call(UV, "pip", "install", *where, "--requirement", pins, package, folder=tmp_path)
    pinred = tmp_path / "venv/bin/pinred"
    assert "pinred" in call(pinred, "doctor", folder=tmp_path)
    assert "verdict: PASSED" in call(pinred, "compare", "falling_cat", folder=tmp_path)
    run = ("simulate", "cartpole", "--duration", "1", "--out", "motion.npz")
    call(pinred, *run, "--checkpoint", "run.ckpt", folder=tmp_path)
    assert (tmp_path / "run.ckpt").exists()
    code = "import pinred; print(len(pinred.read_recording('motion.npz').t), pinred.__file__)"
    count, file = call(tmp_path / "venv/bin/python", "-c", code, folder=tmp_path).split()
    assert int(count) > 1
    assert Path(file).is_relative_to(tmp_path)
