"""Notices about numba's compilations of pinred's functions."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from numba.core.event import Listener, register

from ...common.compile_notice import notice_of_compiling

_EVENT = "numba:compile"
# numba's functions have no type hints.
_register: Callable[[str, Listener], None] = register
_PACKAGE = __name__.partition(".")[0]


class _Notices(Listener):
    """Notices of the outermost compilations; numba lets one thread at a time compile."""

    def __init__(self) -> None:
        self._open: list[ExitStack] = []

    def on_start(self, event: Any) -> None:
        """Begin to wait, unless a function is compiled for another one."""
        stack = ExitStack()
        function = event.data["dispatcher"].py_func
        if not self._open and function.__module__.partition(".")[0] == _PACKAGE:
            stack.enter_context(notice_of_compiling("an integrator, once for all robots"))
        self._open.append(stack)

    def on_end(self, event: Any) -> None:  # noqa: ARG002
        """Stop waiting."""
        self._open.pop().close()


def announce_compilations() -> None:
    """Write a line about each compilation of pinred's functions that takes longer than a second."""
    _register(_EVENT, _Notices())
