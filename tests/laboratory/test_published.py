"""Published and closed-form results: every row agrees, and a wrong number of a row is found."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import published_table
import pytest

import pinred
from pinred.cli.command_line import main
from pinred.laboratory.published import dynamics, locomotion
from pinred.laboratory.published.row import ROWS, Result, numbers


def numbers_in(text: str) -> list[float]:
    """Return the numbers of a cell of the table."""
    return [float(number) for number in text.split(",")]


# Other rows have the same two routes.
@pytest.mark.by_hand("diver-arm", "three-bodies-count")
@pytest.mark.slow
@pytest.mark.parametrize("name", ROWS)
def test_row_agrees_and_page_shows_its_numbers(name: str) -> None:
    """Both routes agree within the bound, and docs/published.md has their numbers."""
    result = ROWS[name].run()
    assert result.passed, f"{result.expected} | {result.found} | {result.difference:.1e}"
    quantity, expected, found, difference, source = published_table.cells()[name]
    assert (quantity, source) == (result.row.quantity, result.row.source)
    bound = result.bound + 1e-11 * float(np.abs(result.pair.expected).max())
    np.testing.assert_allclose(numbers_in(expected), result.pair.expected, rtol=0.0, atol=bound)
    np.testing.assert_allclose(numbers_in(found), result.pair.found, rtol=0.0, atol=bound)
    assert float(difference) <= 1.05 * result.bound


def test_page_lists_and_derives_all_rows() -> None:
    """The table has every row in order, and the text derives each."""
    assert list(published_table.cells()) == list(ROWS)
    assert len(ROWS) >= 20
    text = published_table.DOCUMENT.read_text(encoding="utf-8")
    text = text[text.index(published_table.END) :]
    bold = {name for heading in text.split("**")[1::2] for name in heading.strip(".").split(", ")}
    assert bold == set(ROWS)


@pytest.mark.parametrize("name", ["spheroid", "coupled-planar", "dynamic-singularity"])
def test_number_beyond_its_bound_fails(name: str) -> None:
    """A number that is off by a tenth more than the bound does not pass; NaN never does."""
    row = ROWS[name]
    pair = row.compute()
    bound = row.bound(pair.expected)
    for error, passes in ((0.9 * bound, True), (1.1 * bound, False), (np.nan, False)):
        wrong = numbers(pair.expected, pair.expected + error)
        assert replace(row, compute=partial(lambda found: found, wrong)).run().passed is passes


def test_bound_of_printed_number_is_half_a_unit() -> None:
    """The bound follows from the digits that the source prints."""
    row = ROWS["dynamic-singularity"]
    assert row.printed == "-11.41"
    assert row.bound(np.array([-11.41])) == pytest.approx(0.005, rel=1e-12)
    assert replace(row, printed="12").bound(np.array([12.0])) == 0.5


def test_numbers_of_different_counts_raise() -> None:
    """A row cannot compare two numbers with one."""
    with pytest.raises(ValueError, match="found"):
        numbers([1.0, 2.0], 1.0)


def test_rows_use_public_names() -> None:
    """Each name that the rows import is the public object of this name."""
    imported = vars(dynamics) | vars(locomotion)
    public = {name: value for name, value in imported.items() if name in dir(pinred)}
    assert len(public) > 15
    for name, value in public.items():
        assert getattr(pinred, name) is value


def test_command_shows_row_with_code(capsys: pytest.CaptureFixture[str]) -> None:
    """`pinred published ROW` prints source, both numbers and code; `--list` computes nothing."""
    assert main(["published", "spheroid"]) == 0
    out = capsys.readouterr().out
    assert "H. Lamb" in out
    assert "def spheroid() -> Numbers:" in out
    assert "1 of 1 rows agree" in out
    assert main(["published", "--list"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()[::2]] == list(ROWS)
    assert main(["published", "spheriod"]) == 2
    assert "did you mean 'spheroid'" in capsys.readouterr().err


def test_command_reports_row_that_disagrees(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A row that disagrees is marked, and the exit code is 1."""
    wrong = replace(ROWS["spheroid"], compute=lambda: numbers([1.0], [2.0]))
    monkeypatch.setitem(ROWS, "spheroid", wrong)
    monkeypatch.setattr("pinred.laboratory.published.row.Row.code", "")
    assert isinstance(wrong.run(), Result)
    assert main(["published", "spheroid"]) == 1
    assert "FAILED" in capsys.readouterr().out


@pytest.mark.by_hand
@pytest.mark.filterwarnings("ignore::pinred.ModelWarning")
def test_branches_find_fold_of_cowboy_motions() -> None:
    """`branches` finds the fold at the momentum of the closed form; it takes a minute."""
    J = ROWS["pendulum-fold"].compute().expected[1]
    system = dynamics.pendulum()
    found = pinred.branches(system, momentum=(0.995 * J, 1.01 * J), starts=40)
    assert [fold.momentum for fold in found.folds] == [pytest.approx(J, rel=1e-9)]
