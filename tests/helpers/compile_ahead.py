"""Compile the integrators once for all test processes, instead of once in each of them.

Each process takes the next method that no other process has taken.  It compiles the method and
caches the machine code on disk, where the other processes find it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np

import pinred

# The methods whose compilation takes longest come first.
_METHODS = (
    "DOP853", "Radau", "Gauss(0.01)", "Tsit5", "AdaptiveGauss", "Variational(0.01)", "RKMK4(0.01)",
)  # fmt: skip


def compile_ahead(folder: Path) -> None:
    """Compile the methods that no other process has taken.

    Args:
        folder: Folder that all processes of a test run share.
    """
    folder.mkdir(exist_ok=True)
    for name, run in _jobs():
        with suppress(FileExistsError):
            os.close(os.open(folder / name, os.O_CREAT | os.O_EXCL))
            with suppress(pinred.PinredError):  # some methods have no batches or derivatives
                run()


def _jobs() -> Iterator[tuple[str, Callable[[], object]]]:
    """Yield names and functions that compile one method each, for one kind of run."""
    cat = pinred.load("falling_cat")
    for method in _METHODS:
        yield f"run {method}", partial(pinred.simulate, cat, seed=1, duration=0.01, method=method)
    for method in _METHODS:
        many = partial(pinred.simulate_many, cat, seeds=range(8), times=[0.01], method=method)
        yield f"many {method}", many
    for method in _METHODS:
        yield f"flow {method}", partial(_derivatives, cat, method)


def _derivatives(cat: pinred.System, method: str) -> None:
    flow = pinred.flow(cat, wrt=["x0"], seed=1, duration=0.01, method=method)
    rows = len(next(iter(flow.jacobian().values())))
    flow.vjp(np.ones(rows))
