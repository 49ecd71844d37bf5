"""Hypothesis profiles: failures print what reproduces them; no time limit on noisy machines.

And the browser that the tests of pages share.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import settings

import pinred
from pinred.views.playback.headless_browser import Browser, browser, find_browser

settings.register_profile("pinred", deadline=None, print_blob=True, max_examples=20)
settings.register_profile("by hand", settings.get_profile("pinred"), max_examples=200)
settings.load_profile("pinred")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that runs what is left out otherwise."""
    parser.addoption("--by-hand", action="store_true", help="run the tests marked by_hand, too")


def pytest_configure(config: pytest.Config) -> None:
    """Try more examples where time is no matter."""
    if config.getoption("--by-hand"):
        settings.load_profile("by hand")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """What opens pages is slow; what is run by hand is left out unless asked for."""
    for item in items:
        if item.get_closest_marker("browser") or item.get_closest_marker("by_hand"):
            item.add_marker(pytest.mark.slow)
    if not config.getoption("--by-hand"):
        left_out = [item for item in items if item.get_closest_marker("by_hand")]
        items[:] = [item for item in items if not item.get_closest_marker("by_hand")]
        config.hook.pytest_deselected(items=left_out)


@pytest.fixture(scope="module")
def screen() -> Iterator[Browser]:
    """One browser for all tests of a file; they are skipped where there is none."""
    try:
        find_browser()
    except pinred.InputError as error:
        pytest.skip(str(error))
    with browser() as opened:
        yield opened
