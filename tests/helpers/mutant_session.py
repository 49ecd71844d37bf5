"""A pytest session that runs selected tests on mutants, each mutant in a fork.

All modules are imported and all tests are collected once. In a fork, the functions of a module
get the code of the mutant, and kernels and integrators that were compiled before are not used.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
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

import pytest
from line_coverage import IMPORT, LineCoverage, Recorder, leave_numba_alone
from mutations import Mutant

LONG = 20.0  # tests that take longer are not run [s]
_IN_KERNELS = (
    "forces",
    "kernels",
    "lie",
    "reduction",
)  # packages whose functions may generate kernels
_VALIDATION = (
    "kernels/validation",
    "kernels/reference_state",
)  # modules of these packages that never generate a kernel


def is_woven(path: Path) -> bool:
    """Return whether numba may compile functions of a module, or code that they generate.

    numba's cache ignores the constants of a function. A mutant of such a module would therefore
    run the machine code that was cached without the mutant.
    """
    text = path.read_text()
    return "compiling import" in text or "llvmlite import" in text


class MutantSession:
    """The pytest plugin."""

    def __init__(
        self,
        package: Path,
        modules: list[str],
        ask: Callable[[MutantSession], None],
        *,
        seconds: float,
        budget: float,
    ) -> None:
        """Prepare the session.

        Args:
            package: Folder of the package.
            modules: Modules of the package that will be mutated.
            ask: Function that is called with the session when all tests are collected.
            seconds: Time limit for the tests of one mutant [s].
            budget: Limit on the total duration of the tests of a mutant [s], measured without it.
                The quickest tests run first, and at least one test runs.
        """
        self._package, self._ask = package, ask
        self._seconds, self._budget = seconds, budget
        self._recorder = Recorder(package, modules)
        self._items: dict[str, pytest.Item] = {}
        self._functions: list[FunctionType] = []
        self._killers: defaultdict[str, Counter[str]] = defaultdict(Counter)
        self._passes: dict[tuple[str, str], bool] = {}
        self._session: pytest.Session
        self.covering = LineCoverage()

    @pytest.hookimpl(wrapper=True)
    def pytest_collection(self, session: pytest.Session) -> Iterator[None]:
        """Record the lines that run during imports, before any test."""
        self._session = session
        with self._recorder.traced():
            return (yield)

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Run mutants instead of all tests."""
        self._items = {item.nodeid: item for item in session.items}
        objects = gc.get_objects()
        self._functions = [
            candidate for candidate in objects if isinstance(candidate, FunctionType)
        ]
        gc.freeze()  # so that forks share these objects instead of copying them
        self._ask(self)
        return True

    def cover(self, path: Path) -> None:
        """Record the lines that each test runs, or read them from a file.

        Raises SystemExit if a test fails without a mutant.
        """
        if not path.exists():
            for _ in range(2):  # the second pass measures without compilation
                failed = self._forked(lambda: self._recorded(path), 3600.0)
                if failed:
                    raise SystemExit(f"a test fails without a mutant: {failed}")
                if max(LineCoverage.read(path).seconds.values(), default=0.0) < LONG / 5.0:
                    break
        self.covering = LineCoverage.read(path)

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
        """Return the tests to run on a mutant, those most likely to kill it first."""
        covering = self.covering
        candidates = covering.tests(module, mutant.line, mutant.end) if mutant.inside else []
        # Compiled code is not traced, so any test of the module may run the line.
        is_compiled = module.startswith("integrators") or self._woven(module)
        if not mutant.inside or (not candidates and is_compiled):
            candidates = covering.of_module(module)
        candidates = [test for test in candidates if covering.seconds[test] < LONG]
        killers = [name for name, _ in self._killers[module].most_common(3) if name in candidates]
        remaining = self._budget
        selected: list[str] = []
        for name in dict.fromkeys([*killers, *candidates]):
            remaining -= covering.seconds[name]
            if remaining > 0.0 or not selected:
                selected.append(name)
        return selected

    def killed(self, module: str, test: str) -> None:
        """Record that a test killed a mutant of a module; it runs first on the next mutant."""
        if test in self._items:
            self._killers[module][test] += 1

    def outcome(self, module: str, mutant: Mutant) -> str | None:
        """Return the outcome of a mutant, or None if its module must be imported again."""
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
        return (
            "survived" if tests else "not run"
        )  # tests that also fail without the mutant are ignored

    def _passes_without(self, module: str, test: str) -> bool:
        """Return whether a test passes without a mutant if everything is compiled again."""
        if test not in self._items or not (module.startswith(_IN_KERNELS) or self._woven(module)):
            return True
        key = (module.split("/", maxsplit=1)[0], test)
        if key not in self._passes:
            self._passes[key] = not self._forked(
                partial(self._run, module, [], [test]), self._seconds
            )
        return self._passes[key]

    def _changed(self, module: str, mutant: Mutant) -> list[tuple[FunctionType, CodeType]] | None:
        """Return the functions that a mutant changes with their new code, or None if unknown."""
        path = str(self._package / module)
        before, after = (
            _codes(compile(source, path, "exec", dont_inherit=True))
            for source in (mutant.source, mutant.tree)
        )
        if before.keys() != after.keys():
            return None
        keys = {key for key, code in before.items() if code != after[key]}
        changed = [
            (function, after[key])
            for function in self._functions
            if function.__code__.co_filename == path and (key := _key(function.__code__)) in keys
        ]
        if any(len(f.__code__.co_freevars) != len(code.co_freevars) for f, code in changed):
            return None
        return changed or None

    def _run(
        self, module: str, changed: list[tuple[FunctionType, CodeType]], tests: list[str]
    ) -> str:
        for function, code in changed:
            function.__code__ = code
        with tempfile.TemporaryDirectory() as folder:
            if self._woven(module):
                _compile_again(str(self._package / module))
            if module.startswith(_IN_KERNELS) and not module.startswith(_VALIDATION):
                os.environ["PINRED_CACHE_DIR"] = folder
            items = [self._items[name] for name in tests]
            for item, next_item in zip(items, [*items[1:], None], strict=True):
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=next_item)
                if self._session.testsfailed:
                    return item.nodeid
        return ""

    def _woven(self, module: str) -> bool:
        """Return whether numba may compile functions of a module, or code that they generate."""
        return is_woven(self._package / module)

    def _forked(self, work: Callable[[], str], seconds: float) -> str:
        """Call a function in a fork; return its result, or the reason why the fork failed."""
        with tempfile.TemporaryDirectory() as folder:
            answer = Path(folder) / "said"
            child = os.fork()
            if not child:
                code = 70
                try:
                    os.setsid()
                    devnull = os.open(os.devnull, os.O_RDWR)
                    for descriptor in (0, 1, 2):
                        os.dup2(devnull, descriptor)
                    answer.write_text(work())
                    code = 0
                except BaseException:
                    with suppress(BaseException):
                        answer.write_text(f"an error: {traceback.format_exc()[-300:]}")
                finally:
                    os._exit(code)
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                if os.waitpid(child, os.WNOHANG)[0]:
                    return answer.read_text() if answer.exists() else "an error"
                time.sleep(0.005)
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return "time"


def _compile_again(path: str) -> None:
    """Compile functions again if they depend on a source file; the others stay in the cache.

    Args:
        path: Path of the source file.
    """
    from pinred.integrators.stepping import compiling  # the copy with the mutants

    module = vars(compiling)
    shipped_name = module["shipped_name"]

    def name_of_mutant(function: Any, *details: Any) -> str:
        name: str = shipped_name(function, *details)
        return f"{name}-{os.getpid()}" if _depends(function, path) else name

    module["shipped_name"] = name_of_mutant


def _depends(value: object, path: str) -> bool:
    """Return whether a function or class uses code of a source file, directly or indirectly."""
    pending, seen = [value], set[int]()
    while pending:
        value = pending.pop()
        value = getattr(value, "py_func", None) or getattr(value, "generator", value)
        if id(value) in seen:
            continue
        seen.add(id(value))
        if isinstance(value, type):
            module = sys.modules.get(value.__module__)
            if getattr(module, "__file__", None) == path:
                return True
        if not isinstance(value, FunctionType):
            continue
        if value.__code__.co_filename == path:
            return True
        codes = [value.__code__]
        for code in codes:
            codes += [constant for constant in code.co_consts if isinstance(constant, CodeType)]
        names = {name for code in codes for name in code.co_names}
        pending += [value.__globals__[name] for name in names if name in value.__globals__]
        pending += [cell.cell_contents for cell in value.__closure__ or ()]
    return False


def _codes(code: CodeType) -> dict[tuple[str, int, int], CodeType]:
    """Return the code of all functions of a module by their keys."""
    codes, pending = {}, [code]
    while pending:
        for constant in pending.pop().co_consts:
            if isinstance(constant, CodeType):
                codes[_key(constant)] = constant
                pending.append(constant)
    return codes


def _key(code: CodeType) -> tuple[str, int, int]:
    columns: Any = [first for *_, first, _ in code.co_positions() if first]
    is_ambiguous = "<" in code.co_name  # a line may contain several lambdas or comprehensions
    return code.co_qualname, code.co_firstlineno, min(columns, default=0) if is_ambiguous else 0
