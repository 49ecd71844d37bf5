"""Modules import without POSIX: modules and flags of POSIX are used in functions only."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
POSIX = {"crypt", "fcntl", "grp", "posix", "pty", "pwd", "resource", "syslog", "termios", "tty"}
FLAGS = {"O_CLOEXEC", "O_DIRECTORY", "O_NOFOLLOW", "O_NONBLOCK", "O_PATH", "SIGALRM", "SIGKILL"}
FLAGS |= {"fork", "geteuid", "getuid", "killpg", "setsid", "setitimer", "ITIMER_REAL"}


def executed_at_import(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes that run when a module is imported, which excludes function bodies."""
    yield node
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            yield from executed_at_import(child)


def find_posix(code: str) -> list[str]:
    """Return the POSIX-only modules and attributes that a module uses when it is imported."""
    found = []
    for node in executed_at_import(ast.parse(code)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names if alias.name.split(".")[0] in POSIX]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found += [str(node.module)] if str(node.module).split(".")[0] in POSIX else []
            if node.module in {"os", "signal"}:
                found += [alias.name for alias in node.names if alias.name in FLAGS]
        elif (
            isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.value.id in {"os", "signal"}
            and node.attr in FLAGS
        ):
            found.append(f"{node.value.id}.{node.attr}")
    return found


def test_no_module_needs_posix_at_import() -> None:
    """No module of pinred imports a POSIX-only module, or reads a POSIX-only flag, at its top."""
    paths = sorted((ROOT / "pinred").rglob("*.py"))
    assert len(paths) > 100
    codes = {str(path.relative_to(ROOT)): path.read_text("utf-8") for path in paths}
    words = re.compile(rf"\b({'|'.join(POSIX | FLAGS)})\b")  # most modules contain none
    found = {path: find_posix(code) for path, code in codes.items() if words.search(code)}
    assert {path: names for path, names in found.items() if names} == {}


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("import os, fcntl", ["fcntl"]),
        ("from resource import RLIMIT_AS", ["resource"]),
        ("try:\n    import pwd\nexcept ImportError:\n    pass", ["pwd"]),
        ("class A:\n    flags = os.O_NOFOLLOW", ["os.O_NOFOLLOW"]),
        ("from os import geteuid", ["geteuid"]),
        ("from . import resource", []),
        ("def f():\n    import fcntl\n    return os.O_NOFOLLOW", []),
        ("FLAG = getattr(os, 'O_NOFOLLOW', 0)", []),
    ],
)
def test_scan_finds_what_runs_at_import(code: str, found: list[str]) -> None:
    """Statements in functions do not count; all others do."""
    assert find_posix(code) == found
