"""Lint, format, file lengths and file names; tests/test_signatures.py checks the types."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
LONGEST = 800  # lines per file


def long_files(package: Path) -> list[str]:
    """Return the paths of the Python files with more than `LONGEST` lines."""
    return [
        path.relative_to(package).as_posix()
        for path in sorted(package.rglob("*.py"))
        if len(path.read_text(encoding="utf-8").splitlines()) > LONGEST
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [("ruff", "check"), ("ruff", "format", "--check")],
    ids=" ".join,
)
def test_tool_reports_nothing(command: tuple[str, ...]) -> None:
    """The tool finds no fault in the checkout."""
    process = subprocess.run(
        [sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stdout + process.stderr


def test_files_are_short() -> None:
    """No file of the package is longer than 400 lines."""
    assert long_files(ROOT / "pinred") == []


def test_long_file_is_detected_whichever_it_is(tmp_path: Path) -> None:
    """Padding any file of the package makes the check fail for that file."""
    package = tmp_path / "pinred"
    shutil.copytree(ROOT / "pinred", package, ignore=shutil.ignore_patterns("__pycache__"))
    paths = sorted(package.rglob("*.py"))
    for path in paths:
        text = path.read_text(encoding="utf-8")
        path.write_text(text + "\n" * (LONGEST + 1 - len(text.splitlines())), encoding="utf-8")
    assert long_files(package) == [path.relative_to(package).as_posix() for path in paths]


def test_module_names_are_unique() -> None:
    """A file name alone identifies a module of the package."""
    names = Counter(path.name for path in (ROOT / "pinred").rglob("*.py"))
    shared = {name for name, count in names.items() if count > 1}
    assert shared <= {"__init__.py"}
