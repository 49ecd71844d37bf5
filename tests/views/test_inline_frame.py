"""Pages in notebook cells: their element, and their pictures in a browser."""

from __future__ import annotations

import io
import re
import sys
from html import unescape
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from headless_browser import Browser
from PIL import Image

import pinred
from pinred.views.playback.page import inline_frame, is_notebook


def test_frame_contains_the_page() -> None:
    """Any text survives the attribute, and the page may only run scripts."""
    text = "<p title='a' id=\"b\">&amp; ü</p><script>1 < 2 && '%'</script>"
    frame = inline_frame(text.encode())
    found = re.search(r'srcdoc="([^"]*)"', frame)
    assert found is not None
    assert unescape(found[1]) == text
    assert 'sandbox="allow-scripts"' in frame


def test_notebooks_are_recognised(monkeypatch: pytest.MonkeyPatch) -> None:
    """IPython in a terminal has no kernel; marimo says whether it runs."""
    assert not is_notebook()
    for shell, wanted in ((SimpleNamespace(), False), (SimpleNamespace(kernel=1), True)):
        ipython = SimpleNamespace(get_ipython=lambda shell=shell: shell)
        monkeypatch.setitem(sys.modules, "IPython", ipython)
        assert is_notebook() is wanted


@pytest.mark.browser
def test_frame_fills_its_cell_behind_elements_of_the_notebook(
    screen: Browser, tmp_path: Path
) -> None:
    """Notebooks of marimo wrap each iframe in an element without height."""
    frame = inline_frame(b"<p>page</p>")
    wrapped = frame.replace("<iframe", "<div><iframe").replace("</iframe>", "</iframe></div>")
    assert wrapped != frame
    cell = tmp_path / "cell.html"
    for html in (frame, wrapped):
        cell.write_text(f"<!DOCTYPE html><body>{html}</body>", encoding="utf-8")
        screen.open(cell.as_uri(), width=640, height=560)
        box = "document.querySelector('iframe').getBoundingClientRect()"
        assert screen.run(f"{box}.height") > 500.0
        assert screen.run(f"{box}.width") > 600.0


@pytest.mark.browser
def test_page_is_drawn_in_a_cell(screen: Browser, tmp_path: Path) -> None:
    """The page of `feel` is drawn inside the iframe, in a narrow cell."""
    with pinred.feel(pinred.load("three_rods"), show=False, wait=False) as player:
        cell = tmp_path / "cell.html"
        cell.write_text(f"<!DOCTYPE html><body>{player._repr_html_()}</body>", encoding="utf-8")

    def colours() -> int:
        image = Image.open(io.BytesIO(screen.screenshot())).convert("RGB")
        return len(np.unique(np.asarray(image).reshape(-1, 3), axis=0))

    screen.open(cell.as_uri(), width=640, height=560)
    screen.wait_for("document.querySelector('iframe') !== null")
    for _ in range(20):
        if (count := colours()) > 400:
            break
    assert count > 400
    errors = [event for event in screen.events if event["method"] == "Runtime.exceptionThrown"]
    assert errors == []
