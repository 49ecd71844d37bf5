"""A line tells a user who waits what is compiled; elsewhere nothing is written."""

from __future__ import annotations

import time

import pytest
from numba import njit

from pinred.common import compile_notice, progress
from pinred.common.compile_notice import notice_of_compiling
from pinred.integrators.stepping import numba_functions, numba_notice


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pretend that somebody watches, and has little patience."""
    monkeypatch.setattr(compile_notice, "is_watched", lambda: True)
    monkeypatch.setattr(compile_notice, "_PATIENCE", 0.02)


@pytest.mark.usefixtures("watched")
def test_long_work_is_announced_once_and_short_work_never(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The line is written while the work goes on."""
    with notice_of_compiling("the equations of 'cat'"):
        pass
    time.sleep(0.1)
    assert capsys.readouterr().err == ""
    with notice_of_compiling("the equations of 'cat'"):
        time.sleep(0.2)
        said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "pinred compiles the equations of 'cat'" in said
    assert capsys.readouterr().err == ""


def test_nothing_is_written_without_a_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Standard error of tests is no terminal."""
    monkeypatch.setattr(compile_notice, "_PATIENCE", 0.0)
    assert not progress.is_watched()
    with notice_of_compiling("the equations of 'cat'"):
        time.sleep(0.05)
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("watched")
@pytest.mark.parametrize(("package", "count"), [("pinred", 1), ("elsewhere", 0)])
def test_compilations_of_numba_are_announced_for_functions_of_pinred(
    package: str, count: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One line for a function and the function that it calls; none for those of others."""
    monkeypatch.setattr(compile_notice, "_PATIENCE", 0.0)

    def inner(x: float) -> float:
        return x + 1.0

    def outer(x: float) -> float:
        return called(x) * 2.0

    inner.__module__ = outer.__module__ = f"{package}.module"
    called = njit(inner)
    assert njit(outer)(1.0) == 4.0
    assert capsys.readouterr().err.count("pinred compiles an integrator") == count
    assert numba_functions.__name__.startswith(f"{numba_notice._PACKAGE}.")
