"""Which tests run which lines of the package.

Lines of functions only: those of modules run when something imports them first, and what does so
before any test counts for all tests of the module.  What is compiled by numba leaves no trace.
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

IMPORT = ""  # the name of the test that runs what is run before any test
_OPTIMISED = 1  # the flag of a function's code; modules and bodies of classes have none


@dataclass
class Covering:
    """What tests run.  seconds: of each test.  lines: of each module, and the tests that ran it."""

    seconds: dict[str, float] = field(default_factory=dict)
    lines: dict[str, dict[int, list[str]]] = field(default_factory=dict)

    def tests(self, module: str, line: int, end: int) -> list[str]:
        """Return the tests that run one of these lines, in the order of `quickest`."""
        known = self.lines.get(module, {})
        found = {test for k in range(line, end + 1) for test in known.get(k, [])}
        return self.of_module(module) if IMPORT in found else self.quickest(found)

    def of_module(self, module: str) -> list[str]:
        """Return all tests, first those that run any line of a function of a module.

        The others may run it in a process of their own.
        """
        found = {t for tests in self.lines.get(module, {}).values() for t in tests} - {IMPORT}
        return [*self.quickest(found), *self.quickest(set(self.seconds) - found)]

    def quickest(self, tests: set[str]) -> list[str]:
        """Return tests in the order of the time that they take.

        The k-th case of a test counts k times, for it likely sees no more than the others.
        """
        cases: Counter[str] = Counter()
        weights = {}
        for test in sorted(tests, key=lambda test: (self.seconds.get(test, 0.0), test)):
            cases[name := test.split("[")[0]] += 1
            weights[test] = self.seconds.get(test, 0.0) * cases[name]
        return sorted(weights, key=lambda test: (weights[test], test))

    def write(self, path: Path) -> None:
        """Write it as JSON."""
        path.write_text(json.dumps({"seconds": self.seconds, "lines": self.lines}))

    @staticmethod
    def read(path: Path) -> Covering:
        """Read what `write` has written."""
        read = json.loads(path.read_text())
        lines = {
            module: {int(line): tests for line, tests in known.items()}
            for module, known in read["lines"].items()
        }
        return Covering(read["seconds"], lines)


class Recorder:
    """What runs of some modules: of tests, and of what is imported before any."""

    def __init__(self, package: Path, modules: Sequence[str]) -> None:
        """Record modules of a package (a folder)."""
        self._files = {str(package / module): module for module in modules}
        self._now: set[tuple[str, int]] | None = None
        self.found = Covering()

    @contextmanager
    def traced(self, test: str = IMPORT) -> Iterator[None]:
        """Record what runs meanwhile as a test's."""
        self._now = now = set[tuple[str, int]]()
        began = time.perf_counter()
        sys.settrace(self._trace)
        threading.settrace(self._trace)
        try:
            yield
        finally:
            sys.settrace(None)
            threading.settrace(None)
            self._now = None
            if test != IMPORT:
                self.found.seconds[test] = time.perf_counter() - began
            for module, line in now:
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
    """Let numba's compiler, which is large, run without a trace."""
    traced = Dispatcher.compile

    def untraced(self: Dispatcher, sig: Any) -> Any:
        tracing = sys.gettrace()
        sys.settrace(None)
        try:
            return traced(self, sig)
        finally:
            sys.settrace(tracing)

    Dispatcher.compile = untraced  # type: ignore[method-assign]
