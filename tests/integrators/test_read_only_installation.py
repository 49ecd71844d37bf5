"""Tests of installations that cannot be written: code is cached by PINRED_CACHE_DIR, or nowhere."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from shutil import copytree, ignore_patterns

import pytest

import pinred

# Create all steppers, and compile one function. Print its result, and whether it was compiled.
PROGRAM = """
import sys
import numpy as np
from pinred.integrators.methods import METHODS
from pinred.integrators.stepping.intrinsics import from_lanes
for kind in METHODS.values():
    (kind(1e-8, 1e-10) if kind.adaptive else kind(0.02))._stepper()
out = np.zeros((1, 2))
from_lanes(np.arange(8.0)[None], out)
print(out.tolist(), "numba" in sys.modules)
"""


@pytest.fixture(scope="module")
def install(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a copy of the package in which Python cannot write, even for root.

    Permissions do not stop root, but files in place of the cache folders stop everybody.
    """
    source, tmp_path = Path(pinred.__file__).parent, tmp_path_factory.mktemp("installation")
    unwanted = ignore_patterns("__pycache__", "shipped")  # without bitcode, so that it compiles
    copytree(source, tmp_path / "site/pinred", ignore=unwanted)
    for folder in [tmp_path / "site/pinred", *(tmp_path / "site/pinred").rglob("*/")]:
        if folder.is_dir():
            (folder / "__pycache__").touch()
    return tmp_path / "site"


def run(program: str, install: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a program with a package, and without a home."""
    unwanted = ("XDG_", "NUMBA_", "PINRED_CACHE")
    environment = {k: v for k, v in os.environ.items() if not k.startswith(unwanted)}
    environment |= {"HOME": "/proc/no-home", "PYTHONPATH": str(install)} | variables
    return subprocess.run(
        [sys.executable, "-c", program], cwd=install, env=environment,
        capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.mark.slow
def test_read_only_installation_caches_in_named_folder(install: Path, tmp_path: Path) -> None:
    """The first process stores the code in the named folder, and the second one loads it."""
    folders = {"PINRED_CACHE_DIR": str(tmp_path / "cache"), "XDG_DATA_HOME": str(tmp_path / "data")}
    for is_compiled in (True, False):
        done = run(PROGRAM, install, **folders)
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout == f"[[0.0, 1.0]] {is_compiled}\n"
    assert len(list((tmp_path / "cache").iterdir())) == 1


@pytest.mark.slow
def test_installation_without_writable_folder_compiles_in_memory(install: Path) -> None:
    """A CacheWarning is issued, and the result is the same."""
    done = run(PROGRAM, install)
    assert done.stdout == "[[0.0, 1.0]] True\n", done.stderr
    assert "CacheWarning" in done.stderr
