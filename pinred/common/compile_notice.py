"""Lines about compilations, for a user who waits for them."""

from __future__ import annotations

from .waiting import Wait


def notice_of_compiling(what: str) -> Wait:
    """Return the wait for a compilation.

    Args:
        what: What is compiled, such as "the equations of 'solo12'".
    """
    return Wait(f"compiles {what}; the next process finds the result in its cache")
