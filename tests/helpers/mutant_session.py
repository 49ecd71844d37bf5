"""A session of pytest that runs some of its tests on mutants, each in a fork.

Everything is imported and all tests are collected once.  In a fork, functions of the module get
the code of the mutant; what was compiled without it is not used.
"""

from __future__ import annotations

import gc
import os
import signal
import tempfile
import time
import traceback
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import numba
import pytest
from line_coverage import IMPORT, Covering, Recorder, leave_numba_alone
from mutations import Mutant
from numba.core.caching import NullCache
from numba.core.dispatcher import Dispatcher

LONG = 20.0  # s; tests that take longer are left out
_IN_KERNELS = ("forces", "kernels", "lie", "reduction")  # what kernels may be made of
_VALIDATION = ("kernels/validation", "kernels/reference_state")  # never part of a kernel


class MutantSession:
    """The plugin.  ask: is called with it when all tests are collected.

    seconds: of a mutant's tests.  budget: of the tests that are run, quickest first, as they take
    without a mutant; at least one of them is.
    """

    def __init__(
        self,
        package: Path,
        modules: list[str],
        ask: Callable[[MutantSession], None],
        *,
        seconds: float,
        budget: float,
    ) -> None:
        """Take the package (a folder) and its modules that will be changed."""
        self._package, self._ask = package, ask
        self._seconds, self._budget = seconds, budget
        self._recorder = Recorder(package, modules)
        self._items: dict[str, pytest.Item] = {}
        self._functions: list[FunctionType] = []
        self._compiled: list[Dispatcher] = []
        self._killers: defaultdict[str, Counter[str]] = defaultdict(Counter)
        self._passes: dict[tuple[str, str], bool] = {}
        self._session: pytest.Session
        self.covering = Covering()

    @pytest.hookimpl(wrapper=True)
    def pytest_collection(self, session: pytest.Session) -> Iterator[None]:
        """Record what is run by imports, before any test."""
        self._session = session
        with self._recorder.traced():
            return (yield)

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Ask for mutants, instead of running all tests."""
        self._items = {item.nodeid: item for item in session.items}
        known = gc.get_objects()
        self._functions = [each for each in known if isinstance(each, FunctionType)]
        self._compiled = [each for each in known if isinstance(each, Dispatcher)]
        gc.freeze()  # so that forks do not copy what they only look at
        self._ask(self)
        return True

    def cover(self, path: Path) -> None:
        """Find out what tests cover, or read it from a file; raise SystemExit if one fails."""
        if not path.exists():
            for _ in range(2):  # what the first pass compiles is not the second's time
                failed = self._forked(lambda: self._recorded(path), 3600.0)
                if failed:
                    raise SystemExit(f"a test fails without a mutant: {failed}")
                if max(Covering.read(path).seconds.values(), default=0.0) < LONG / 5.0:
                    break
        self.covering = Covering.read(path)

    def _recorded(self, path: Path) -> str:
        leave_numba_alone()
        for name, item in self._items.items():
            with self._recorder.traced(name):
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=None)
            if self._session.testsfailed:
                return name
        self._recorder.found.write(path)
        return ""

    def tests(self, module: str, mutant: Mutant) -> list[str]:
        """Return the tests that are run on a mutant, the likeliest to kill it first."""
        covering = self.covering
        found = covering.tests(module, mutant.line, mutant.end) if mutant.inside else []
        if not mutant.inside or (not found and module.startswith("integrators")):
            found = covering.of_module(module)
        found = [test for test in found if covering.seconds[test] < LONG]
        killers = [name for name, _ in self._killers[module].most_common(3) if name in found]
        left = self._budget
        out: list[str] = []
        for name in dict.fromkeys([*killers, *found]):
            left -= covering.seconds[name]
            if left > 0.0 or not out:
                out.append(name)
        return out

    def killed(self, module: str, test: str) -> None:
        """Note that a test has killed a mutant of a module: it is the first for the next."""
        if test in self._items:
            self._killers[module][test] += 1

    def outcome(self, module: str, mutant: Mutant) -> str | None:
        """Return what tests say of a mutant, or None if its module must be imported anew."""
        tests = self.tests(module, mutant)
        if not tests:
            return "not run"
        lines = self.covering.lines.get(module, {})
        at_import = any(IMPORT in lines.get(k, []) for k in range(mutant.line, mutant.end + 1))
        if not mutant.inside or at_import:
            return None
        changed = self._changed(module, mutant)
        if changed is None:
            return None
        while tests and (
            failed := self._forked(partial(self._run, module, changed, tests), self._seconds)
        ):
            if self._passes_without(module, failed):
                self.killed(module, failed)
                return f"killed by {failed}"
            tests = [test for test in tests if test != failed]
        return "survived" if tests else "not run"  # those that fail without it tell nothing

    def _passes_without(self, module: str, test: str) -> bool:
        """Whether a test passes with all compiled anew, as for a mutant, but nothing changed."""
        if test not in self._items or not (module.startswith(_IN_KERNELS) or self._woven(module)):
            return True
        key = (module.split("/", maxsplit=1)[0], test)
        if key not in self._passes:
            self._passes[key] = not self._forked(
                partial(self._run, module, [], [test]), self._seconds
            )
        return self._passes[key]

    def _changed(self, module: str, mutant: Mutant) -> list[tuple[FunctionType, CodeType]] | None:
        """Return the functions that a mutant changes and what they are then, None if unknown."""
        path = str(self._package / module)
        before, after = (
            _codes(compile(source, path, "exec", dont_inherit=True))
            for source in (mutant.source, mutant.tree)
        )
        if before.keys() != after.keys():
            return None
        keys = {key for key, code in before.items() if code != after[key]}
        found = [
            (each, after[key])
            for each in self._functions
            if each.__code__.co_filename == path and (key := _key(each.__code__)) in keys
        ]
        if any(len(f.__code__.co_freevars) != len(code.co_freevars) for f, code in found):
            return None
        return found or None

    def _run(
        self, module: str, changed: list[tuple[FunctionType, CodeType]], tests: list[str]
    ) -> str:
        for function, code in changed:
            function.__code__ = code
        with tempfile.TemporaryDirectory() as own:
            if self._woven(module):
                for each in self._compiled:
                    each._cache = NullCache()  # type: ignore[attr-defined]
                numba.config.CACHE_DIR = own  # type: ignore[attr-defined]  # of those that are made from now on
            if module.startswith(_IN_KERNELS) and not module.startswith(_VALIDATION):
                os.environ["PINRED_CACHE_DIR"] = own
            items = [self._items[name] for name in tests]
            for item, then in zip(items, [*items[1:], None], strict=True):
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=then)
                if self._session.testsfailed:
                    return item.nodeid
        return ""

    def _woven(self, module: str) -> bool:
        """Whether compiled integrators may be made of functions of a module."""
        text = (self._package / module).read_text()
        return module.startswith("integrators") and "compiling import" in text

    def _forked(self, work: Callable[[], str], seconds: float) -> str:
        """Do some work in a fork and return what it returns: the test that failed, or why."""
        with tempfile.TemporaryDirectory() as place:
            said = Path(place) / "said"
            child = os.fork()
            if not child:
                code = 70
                try:
                    os.setsid()
                    nothing = os.open(os.devnull, os.O_RDWR)
                    for number in (0, 1, 2):
                        os.dup2(nothing, number)
                    said.write_text(work())
                    code = 0
                except BaseException:
                    with suppress(BaseException):
                        said.write_text(f"an error: {traceback.format_exc()[-300:]}")
                finally:
                    os._exit(code)
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                if os.waitpid(child, os.WNOHANG)[0]:
                    return said.read_text() if said.exists() else "an error"
                time.sleep(0.005)
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return "time"


def _codes(code: CodeType) -> dict[tuple[str, int, int], CodeType]:
    """Return all functions in a module's code by what tells them apart."""
    out, left = {}, [code]
    while left:
        for each in left.pop().co_consts:
            if isinstance(each, CodeType):
                out[_key(each)] = each
                left.append(each)
    return out


def _key(code: CodeType) -> tuple[str, int, int]:
    columns: Any = [first for *_, first, _ in code.co_positions() if first]
    several = "<" in code.co_name  # of which one line may have several
    return code.co_qualname, code.co_firstlineno, min(columns, default=0) if several else 0
