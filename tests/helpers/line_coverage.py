"""Record the tests that run each line of the package.

Only lines inside functions are recorded. Lines at module level run when a module is first
imported. A line that runs before any test counts for all tests of its module. Code compiled by
numba is not traced.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

from numba.core.dispatcher import Dispatcher

IMPORT = ""  # test name that stands for code that runs before any test
_OPTIMISED = 1  # the flag CO_OPTIMIZED, set in function code but not in modules and class bodies


@dataclass
class LineCoverage:
    """The lines that tests run, and the time of the tests.

    Attributes:
        seconds: Duration of each test [s].
        lines: Tests that ran a line, by module and line number.
    """

    seconds: dict[str, float] = field(default_factory=dict)
    lines: dict[str, dict[int, list[str]]] = field(default_factory=dict)

    def tests(self, module: str, line: int, end: int) -> list[str]:
        """Return the tests that run a line from `line` to `end`, in the order of `quickest`."""
        tests_of_line = self.lines.get(module, {})
        names = {test for k in range(line, end + 1) for test in tests_of_line.get(k, [])}
        return self.of_module(module) if IMPORT in names else self.quickest(names)

    def of_module(self, module: str) -> list[str]:
        """Return all tests, starting with those that run any function of a module.

        The remaining tests may run the module in a subprocess.
        """
        names = {t for tests in self.lines.get(module, {}).values() for t in tests} - {IMPORT}
        return [*self.quickest(names), *self.quickest(set(self.seconds) - names)]

    def quickest(self, tests: set[str]) -> list[str]:
        """Return tests in ascending order of their duration.

        The duration of the k-th case of a parametrized test is multiplied by k, because later cases
        rarely detect faults that earlier cases miss.
        """
        cases_so_far: Counter[str] = Counter()
        weights = {}
        for test in sorted(tests, key=lambda test: (self.seconds.get(test, 0.0), test)):
            cases_so_far[name := test.split("[")[0]] += 1
            weights[test] = self.seconds.get(test, 0.0) * cases_so_far[name]
        return sorted(weights, key=lambda test: (weights[test], test))

    def write(self, path: Path) -> None:
        """Write the record as JSON."""
        path.write_text(json.dumps({"seconds": self.seconds, "lines": self.lines}))

    @staticmethod
    def read(path: Path) -> LineCoverage:
        """Read a record from a file of `write`."""
        record = json.loads(path.read_text())
        lines = {
            module: {int(line): tests for line, tests in by_line.items()}
            for module, by_line in record["lines"].items()
        }
        return LineCoverage(record["seconds"], lines)


class Recorder:
    """Records the lines that run in some modules, during tests and during imports."""

    def __init__(self, package: Path, modules: Sequence[str]) -> None:
        """Prepare the recorder for modules of a package, given as a folder."""
        self._files = {str(package / module): module for module in modules}
        self._now: set[tuple[str, int]] | None = None
        self.found = LineCoverage()

    @contextmanager
    def traced(self, test: str = IMPORT) -> Iterator[None]:
        """Record the lines that run inside the context under the name of a test."""
        self._now = executed = set[tuple[str, int]]()
        start = time.perf_counter()
        sys.settrace(self._trace)
        threading.settrace(self._trace)
        try:
            yield
        finally:
            sys.settrace(None)
            threading.settrace(None)
            self._now = None
            if test != IMPORT:
                self.found.seconds[test] = time.perf_counter() - start
            for module, line in executed:
                lines = self.found.lines.setdefault(module, defaultdict(list))
                lines[line].append(test)

    def _trace(self, frame: FrameType, _event: str, _: Any) -> Any:
        code = frame.f_code
        module = self._files.get(code.co_filename)
        if module is None or self._now is None or not code.co_flags & _OPTIMISED:
            return None
        self._now.add((module, frame.f_lineno))

        def line(frame: FrameType, event: str, _: Any) -> Any:
            if self._now is not None and event == "line":
                self._now.add((module, frame.f_lineno))
            return line

        return line


def leave_numba_alone() -> None:
    """Disable tracing inside numba's compiler, which would be slow."""
    compile_traced = Dispatcher.compile

    def compile_untraced(self: Dispatcher, sig: Any) -> Any:
        tracing = sys.gettrace()
        sys.settrace(None)
        try:
            return compile_traced(self, sig)
        finally:
            sys.settrace(tracing)

    Dispatcher.compile = compile_untraced  # type: ignore[method-assign]
