"""Test options, hypothesis profiles, and the browser that tests of pages share."""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from tempfile import gettempdir
from zlib import crc32

# Threads of BLAS wait for each other on machines whose cores run test processes.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when NumPy is imported
# Lines about long work depend on the speed of the machine.
os.environ["PINRED_QUIET"] = "1"  # read when pinred is imported

import pytest
from compile_ahead import compile_ahead
from headless_browser import Browser, browser, find_browser
from hypothesis import settings

import pinred

_MANY = 1000  # number of tests of a run that needs most integrators
# The default run uses the same examples every time, so that no test fails by chance.
settings.register_profile(
    "repeatable", deadline=None, print_blob=True, max_examples=5, derandomize=True, database=None
)
settings.register_profile(
    "random", deadline=None, print_blob=True, max_examples=200, derandomize=False
)
settings.load_profile("repeatable")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of longer runs."""
    parser.addoption(
        "--by-hand",
        action="store_true",
        help="also run the tests marked by_hand, and draw random examples for property tests",
    )
    parser.addoption(
        "--examples",
        type=int,
        metavar="N",
        help="run only the property tests, each with N random examples",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Choose the hypothesis profile, and listen to SIGINT."""
    if config.getoption("--by-hand") or config.getoption("--examples"):
        settings.load_profile("random")
    else:  # most kernels of tests are evaluated less often than they have instructions
        os.environ.setdefault("PINRED_CODE_LEVEL", "0")
    # A shell starts `nohup … &` with SIGINT ignored, and child processes inherit that.
    # Tests of Ctrl-C need the default handler there.
    if (
        threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    ):
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Let each process of a run of all tests import, and so cache, another share of the files.

    Pytest rewrites the assertions of a file before it compiles it, which takes longer than to
    import it. The other processes find the result.
    """
    worker = getattr(session.config, "workerinput", {})
    if not worker or session.config.args != session.config.getini("testpaths"):
        return
    gc.disable()  # until the collection has ended: it frees next to nothing
    paths = sorted(Path(__file__).parent.rglob("test_*.py"))
    sys.path[:0] = sorted({str(path.parent) for path in paths} - {*sys.path})
    for path in paths[int(worker["workerid"][2:]) :: worker["workercount"]]:
        # The collection imports, and reports, what fails here.
        with suppress(Exception, pytest.skip.Exception):
            import_module(path.stem)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark tests that open pages as slow, and deselect tests that were not requested."""
    for item in items:
        if item.get_closest_marker("browser") or _is_by_hand(item):
            item.add_marker(pytest.mark.slow)
    examples = config.getoption("--examples")
    selected = [item for item in items if not examples or _set_examples(item, examples)]
    if not config.getoption("--by-hand"):
        selected = _sampled_cases([item for item in selected if not _is_by_hand(item, "")])
        selected = [item for item in selected if not _is_by_hand(item)]
    kept = set(selected)
    config.hook.pytest_deselected(items=[item for item in items if item not in kept])
    items[:] = selected


def pytest_collection_finish(session: pytest.Session) -> None:
    """Prepare a run: exempt what lives until its end from garbage collection, share compilation.

    The modules and items of all tests are 700,000 objects, which every full collection would visit.
    The processes of a long run share the compilation of the integrators.
    """
    gc.freeze()
    gc.enable()
    run = getattr(session.config, "workerinput", {}).get("testrunuid", "")
    if run and len(session.items) > _MANY:
        compile_ahead(Path(gettempdir()) / f"pinred-{run}")


def _is_by_hand(item: pytest.Item, case: str | None = None) -> bool:
    """Return whether a marker `by_hand` names no cases, or names a case: by default the item's."""
    case = item.nodeid.partition("[")[2].removesuffix("]") if case is None else case
    return any(not mark.args or case in mark.args for mark in item.iter_markers("by_hand"))


def _sampled_cases(items: list[pytest.Item]) -> list[pytest.Item]:
    """Return the items with one of every n cases of the tests marked `sampled(n)`.

    Which case is the first depends on the name of the test, so that tests with the same cases keep
    different ones.
    """
    chosen, counts = [], Counter[str]()
    totals = Counter(_function_of(item) for item in items if item.get_closest_marker("sampled"))
    for item in items:
        name, marker = _function_of(item), item.get_closest_marker("sampled")
        every = min(marker.args[0] if marker and marker.args else 2, max(totals[name], 1))
        if marker is None or counts[name] % every == crc32(name.encode()) % every:
            chosen.append(item)
        counts[name] += 1
    return chosen


def _function_of(item: pytest.Item) -> str:
    return item.nodeid.partition("[")[0]


def _set_examples(item: pytest.Item, count: int) -> bool:
    """Set the number of examples of a property test; return whether the test is one."""
    function = getattr(item, "obj", None)
    function = getattr(function, "__func__", function)
    if not getattr(function, "is_hypothesis_test", False):
        return False
    name = "_hypothesis_internal_use_settings"
    setattr(function, name, settings(getattr(function, name), max_examples=count))
    return True


@pytest.fixture(scope="session")
def opened_browser() -> Iterator[Browser]:
    """Start one browser for all tests of a process; skip them if no browser is installed."""
    try:
        find_browser()
    except pinred.InputError as error:
        pytest.skip(str(error))
    with browser() as opened:
        yield opened


@pytest.fixture(scope="module")
def screen(opened_browser: Browser) -> Iterator[Browser]:
    """Lend the browser to the tests of a file, whose last page does not play on."""
    yield opened_browser
    opened_browser.open("about:blank", width=100, height=100)


@pytest.fixture(scope="module")
def code_of_default_level() -> Iterator[None]:
    """Compile kernels as users do, in modules that compare last bits of several kernels."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("PINRED_CODE_LEVEL", raising=False)
        yield
