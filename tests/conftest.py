"""Hypothesis profile: failures print what reproduces them; no time limit on noisy machines.

And the browser that the tests of pages share.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import settings

import pinred
from pinred.views.playback.headless_browser import Browser, browser, find_browser

settings.register_profile("pinred", deadline=None, print_blob=True)
settings.load_profile("pinred")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What opens pages is slow."""
    for item in items:
        if item.get_closest_marker("browser"):
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="module")
def screen() -> Iterator[Browser]:
    """One browser for all tests of a file; they are skipped where there is none."""
    try:
        find_browser()
    except pinred.InputError as error:
        pytest.skip(str(error))
    with browser() as opened:
        yield opened
