"""Run pinred commands in this process, and Python programs in a new interpreter."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from pinred.cli.command_line import main


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    """Return exit code, standard output and standard error of a command."""
    try:
        code = main(arguments)
    except SystemExit as stop:
        code = int(stop.code or 0)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Return the message of a command that rejects its input.

    Asserts that the exit code is 2 and that standard error has exactly one line.
    """
    code, _, error = run(capsys, *arguments)
    assert code == 2
    assert error.startswith("pinred: error: ")
    assert error.count("\n") == 1
    return error


def python(code: str, **environment: str) -> str:
    """Return the standard output of a program in a new interpreter."""
    return subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
