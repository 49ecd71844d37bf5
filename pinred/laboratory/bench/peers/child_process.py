"""First run of a solver in a child process, for libraries that may abort the whole process."""

from __future__ import annotations

import faulthandler
import os
import warnings
from collections.abc import Callable

from ....common.errors import IntegrationError


def check_in_child_process(run: Callable[[], object], who: str) -> None:
    """Run a function once in a child process.

    Some libraries abort instead of raising. Exceptions of `run` are ignored here; the timed run
    raises them again.

    Args:
        run: Function to call.
        who: Name of the tool in messages.
    Raises:
        IntegrationError: The child process was killed.
    """
    with warnings.catch_warnings():  # JAX warns about fork, but the child does not use JAX
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
