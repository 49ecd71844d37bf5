"""Tracebacks of errors in notebooks and IPython end at the user's call."""

from __future__ import annotations

import re
import subprocess
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]

# Cells that raise errors, and one that counts the frames that a debugger sees.
SESSION = """
from IPython.core.interactiveshell import InteractiveShell
shell = InteractiveShell.instance()
for cell in (
    "import pinred; cat = pinred.load('falling_cat')",
    "pinred.simulate(cat, duration=-1)",
    "import sys, traceback; print('frames', len(traceback.extract_tb(sys.last_traceback)))",
    "pinred.equations.euler_poincare_of_lagrangian('a', 3, [1])",
    "print('frames', len(traceback.extract_tb(sys.last_value.__cause__.__traceback__)))",
    "def ell(xi):\\n    return {}['missing']",
    "pinred.equations.euler_poincare_of_lagrangian(cat.group, ell, [0.0] * 6)",
    "try:\\n    pinred.load('1.urdf')\\nexcept pinred.LoadError:\\n    pinred.load('2.urdf')",
    "from pinred.forces import Controller\\nimport fractions",
    "def law(t, x, xdot, mu):\\n    return fractions.Fraction(1, 0)",
    "pinred.simulate(cat, forces=[Controller(law, period=0.1)], duration=1.0)",
    "print('frames', len(traceback.extract_tb(sys.last_traceback)))",
    "from unittest.mock import patch; import pinred.simulation.simulate as own",
    "def call(*_):\\n    with patch.object(own, 'as_scene', int):\\n        own.simulate(cat)",
    "call()",
    "pinred.simulate(cat, forces=[Controller(call, period=0.1)], duration=1.0)",
    "import os; os.environ['PINRED_TRACEBACK'] = '1'",
    "pinred.simulate(cat, duration=-1)",
    "pinred.equations.euler_poincare_of_lagrangian('a', 3, [1])",
    "pinred.simulate(cat, forces=[Controller(law, period=0.1)], duration=1.0)",
):
    print("CELL")
    shell.run_cell(cell)
"""


@cache
def run_session() -> list[str]:
    """Return the output of each cell, without colours."""
    command = [sys.executable, "-W", "ignore", "-c", SESSION]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return re.sub("\x1b\\[[0-9;]*m", "", result.stdout).split("CELL\n")[1:]


def test_tracebacks_in_notebooks_end_at_the_call() -> None:
    """They have no frame of pinred; frames of a user's function and earlier errors remain."""
    _, simple, frames, wrong_kind, cause, _, in_function, second, *_ = run_session()
    for text in (simple, wrong_kind, in_function, second):
        assert "contextlib" not in text  # a library that pinred calls
        assert "pinred/" not in text
        assert "<checks" not in text
    assert simple.count("----> ") == wrong_kind.count("----> ") == 1
    assert "----> 1 pinred.simulate(cat, duration=-1)\n\nInputError: duration must" in simple
    assert wrong_kind.count("InputError") == 2  # of the heading and the message
    assert "AttributeError" not in wrong_kind
    for text in (frames, cause):  # a debugger sees all frames
        assert int(text.split()[1]) >= 3
    assert "----> 2     return {}['missing']" in in_function
    assert "KeyError: 'missing'\n\nThe above exception was the direct cause" in in_function
    assert "1.urdf" in second.partition("During handling")[0]
    assert "LoadError: no such file: 2.urdf" in second


def test_exceptions_of_users_functions_show_no_frames_between() -> None:
    """The call, the function and what it calls; a fault of pinred itself has all frames."""
    *_, thrown, frames, _, _, fault, fault_below = run_session()[:-4]
    assert "pinred/" not in thrown
    assert "<checks" not in thrown
    assert "----> 1 pinred.simulate(cat, forces=[Controller(law" in thrown
    assert "----> 2     return fractions.Fraction(1, 0)" in thrown
    assert "fractions.py" in thrown
    assert "ZeroDivisionError: Fraction(1, 0)" in thrown
    assert int(frames.split()[1]) >= 6  # a debugger sees all frames
    for text in (fault, fault_below):  # a user's function calls pinred in the second
        assert "pinred/simulation/simulate.py" in text
        assert "TypeError" in text
    assert "pinred/simulation/motion.py" in fault_below


def test_environment_variable_restores_all_frames() -> None:
    """Also of the error that the first error replaces."""
    *_, simple, wrong_kind, thrown = run_session()
    assert "pinred/simulation/simulate.py" in simple
    assert wrong_kind.count("Traceback (most recent call last)") >= 1
    assert "<checks" in wrong_kind
    assert "pinred/simulation/motion.py" in thrown
