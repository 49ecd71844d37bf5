"""A first try of what may take the whole process with it."""

from __future__ import annotations

import faulthandler
import os
import warnings
from collections.abc import Callable

from ....common.errors import IntegrationError


def check_in_child_process(run: Callable[[], object], who: str) -> None:
    """Run once in a child process.  Raises IntegrationError if that is killed.

    Some libraries abort where others raise.  What `run` raises by itself is left to the
    run that counts.
    """
    with warnings.catch_warnings():  # of JAX, where it is imported: the child has no use for it
        warnings.simplefilter("ignore", RuntimeWarning)
        child = os.fork()
    if child == 0:
        try:
            faulthandler.disable()
            silent = os.open(os.devnull, os.O_WRONLY)
            os.dup2(silent, 1)
            os.dup2(silent, 2)
            run()
        finally:
            os._exit(0)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        raise IntegrationError(f"{who} aborts (signal {os.WTERMSIG(status)})")
