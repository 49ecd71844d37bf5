"""Lint, format and types are part of the tests."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
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


ROOMS = (
    *("common", "lie", "system", "reduction", "forces", "integrators", "kernels", "scene"),
    *("simulation", "analysis", "verification", "views", "cli"),
)


def imports_of(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line and module of every import in a file: lazy ones and those for types, too."""
    here = path.relative_to(ROOT).with_suffix("").parts
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(here[: len(here) - node.level]) if node.level else ""
            module = ".".join(part for part in (base, node.module) if part)
            yield from ((node.lineno, f"{module}.{alias.name}") for alias in node.names)


def test_imports_point_down() -> None:
    """No room imports one above it, nor a face of the package."""
    upward = []
    for path in sorted((ROOT / "pinred").rglob("*.py")):
        room = path.relative_to(ROOT / "pinred").parts[0]
        if room not in ROOMS:
            continue
        allowed = ROOMS[: ROOMS.index(room) + 1]
        for line, module in imports_of(path):
            first, *rest = module.split(".")
            if first == "pinred" and (not rest or rest[0] not in allowed):
                upward.append(f"{path.relative_to(ROOT)}:{line} imports {module}")
    assert not upward, "\n".join(upward)
