"""The examples of docs/phases.md run and print the documented numbers."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

TEXT = (Path(__file__).parents[2] / "docs/phases.md").read_text("utf-8")


@pytest.mark.by_hand
@pytest.mark.slow
def test_examples_of_phases_page_run(capsys: pytest.CaptureFixture[str]) -> None:
    """The examples run in the order of the page."""
    scope: dict[str, Any] = {}
    for code in re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL):
        exec(compile(code, "phases.md", "exec"), scope)
    output = capsys.readouterr().out
    assert "3.3787199" in output
    assert "-11.41080" in output
    before, after = (scope[name].error for name in ("before", "after"))
    assert before == pytest.approx(0.27, abs=5e-3)
    assert after == pytest.approx(0.0015, abs=1e-4)
