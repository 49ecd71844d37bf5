"""Time of first calls with empty caches."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.errors import InputError
from ...common.waiting import Progress, one_by_one
from .timing import Table

_ROUNDS = 3  # number of processes
_DURATION = 0.5  # of the motions [s]
_ROBOT = "falling_cat"
_PROGRAM = "from {module} import print_time; print_time({call!r})"


def _simulate(system: Any, method: str = "auto") -> Any:
    from ...simulation.simulate import simulate

    return simulate(system, seed=1, duration=_DURATION, method=method)


def _simulate_many(system: Any) -> Any:
    from ...simulation.simulate_many import simulate_many

    return simulate_many(system, seeds=range(8), times=[_DURATION])


def _flow(system: Any) -> Any:
    from ...simulation.flow_map.flow import flow

    return flow(system, wrt=["x0"], seed=1, duration=_DURATION)


def _compare(system: Any) -> Any:
    from ...judge.compare import compare

    return compare(_simulate(system))


CALLS: dict[str, Callable[[Any], Any]] = {
    "simulate": _simulate,
    "simulate, Radau": lambda system: _simulate(system, "Radau"),
    "simulate, Gauss": lambda system: _simulate(system, "Gauss(0.01)"),
    "simulate_many": _simulate_many,
    "flow.jacobian": lambda system: _flow(system).jacobian(),
    "flow.vjp": lambda system: _flow(system).vjp({"pose": np.ones(system.group.dim)}),
    "simulate, compare": _compare,
}


@checks_arguments
def bench_first_calls(
    calls: Sequence[str] = (), *, progress: Progress | bool | None = None
) -> Table:
    """Measure first calls in fresh processes with empty caches, after the robot was loaded.

    Args:
        calls: Names of CALLS; by default all.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        A row for each call: the median time, with machine code generated from the package's
        bitcode [s].
    Raises:
        InputError: A call is unknown.
    """
    names = list(calls) or list(CALLS)
    if unknown := [name for name in names if name not in CALLS]:
        raise InputError(f"no call '{unknown[0]}'; the calls are {', '.join(CALLS)}")

    def measure(name: str) -> SimpleNamespace:
        seconds = float(np.median([_in_fresh_process(name) for _ in range(_ROUNDS)]))
        return SimpleNamespace(call=name, seconds=seconds)

    rows = tuple(one_by_one(names, measure, progress, "calls"))
    return Table("first_calls", rows, {"seconds": "s"})


def _in_fresh_process(call: str) -> float:
    """Return the time of a call in a process with an empty cache [s]."""
    program = _PROGRAM.format(module=__name__, call=call)
    with TemporaryDirectory() as cache:
        # Installed packages contain bytecode, so the processes write and read it.
        settings = {"PINRED_CACHE_DIR": cache, "PYTHONDONTWRITEBYTECODE": ""}
        done = subprocess.run(
            [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, check=True,
            env={**os.environ, **settings},
        )  # fmt: skip
    return float(done.stdout)


def print_time(call: str) -> None:
    """Print the time of a call, one of CALLS, in this process [s]."""
    from ...system.load import load

    system = load(_ROBOT)
    began = time.perf_counter()
    CALLS[call](system)
    print(time.perf_counter() - began)
