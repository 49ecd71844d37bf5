"""Modules that an import of pinred and an inspection do not load, seen in a fresh process."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import sys
import pinred

heavy = {"casadi", "matplotlib", "numba", "pinocchio", "scipy"}
print(sorted(heavy & set(sys.modules)))
str(pinred.inspect(pinred.load("falling_cat")))
from pinred.cli.command_line import main

sys.stdout, printed = sys.stderr, sys.stdout
code = main(["inspect", "four_bar"])
sys.stdout = printed
print(code, "pinocchio" in sys.modules, "scipy.optimize" in sys.modules)
"""


def test_import_and_inspection_load_no_optimiser() -> None:
    """`import pinred` loads no large package; `inspect` loads Pinocchio, but no optimiser."""
    result = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True
    )
    assert result.stdout.splitlines() == ["[]", "0 True False"]
