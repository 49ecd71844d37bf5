"""Lint, format and types are part of the tests."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


@pytest.mark.parametrize(
    "command",
    [("ruff", "check"), ("ruff", "format", "--check"), ("mypy",)],
    ids=" ".join,
)
def test_clean(command: tuple[str, ...]) -> None:
    """The tool has nothing to say about the whole checkout."""
    done = subprocess.run(
        [sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_files_stay_small() -> None:
    """One idea per file: none in the package is longer than 400 lines."""
    lengths = {
        path.name: len(path.read_text(encoding="utf-8").splitlines())
        for path in (ROOT / "pinred").glob("**/*.py")
    }
    assert max(lengths.values()) <= 400, lengths


def test_imports_point_one_way() -> None:
    """The two routes to the equations and the judge stay independent of each other."""
    forbidden = {
        "full_state.py": ("reduction", "split", "lie", "equations", "canonical", "base", "flow"),
        "lie.py": ("system", "reduction"),
        "reduction.py": ("equations", "scene", "flow", "simulation"),
        "simulation.py": ("comparison", "full_state", "cli"),
    }
    for name, others in forbidden.items():
        text = (ROOT / "pinred" / name).read_text(encoding="utf-8")
        for other in others:
            assert f"from .{other} import" not in text, f"{name} imports {other}"
