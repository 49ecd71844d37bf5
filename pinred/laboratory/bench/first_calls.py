"""Time of first calls with empty caches, with shipped machine code and by compilation."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.errors import InputError
from ...common.progress import Progress, one_by_one
from .timing import Table

_ROUNDS = 3  # number of processes with shipped code; compilations are measured once
_DURATION = 0.5  # of the motions [s]
_ROBOT = "falling_cat"
_PROGRAM = "from {module} import print_time; print_time({call!r}, shipped={shipped})"


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
        A row for each call: the median time with the machine code that the package ships, the time
        when numba compiles the integrators [s], their ratio, and whether the call with shipped code
        loads numba.
    Raises:
        InputError: A call is unknown.
    """
    names = list(calls) or list(CALLS)
    if unknown := [name for name in names if name not in CALLS]:
        raise InputError(f"no call '{unknown[0]}'; the calls are {', '.join(CALLS)}")

    def measure(name: str) -> SimpleNamespace:
        results = [_in_fresh_process(name, shipped=True) for _ in range(_ROUNDS)]
        compiled, _ = _in_fresh_process(name, shipped=False)
        seconds, loaded = zip(*results, strict=True)
        shipped = float(np.median(seconds))
        return SimpleNamespace(
            call=name, shipped=shipped, compiled=compiled, ratio=compiled / shipped,
            numba="loaded" if any(loaded) else "not loaded",
        )  # fmt: skip

    rows = tuple(one_by_one(names, measure, progress, "calls"))
    return Table("first_calls", rows, {"shipped": "s", "compiled": "s"})


def _in_fresh_process(call: str, *, shipped: bool) -> tuple[float, bool]:
    """Return the time of a call in a process with an empty cache, and whether it loaded numba."""
    program = _PROGRAM.format(module=__name__, call=call, shipped=shipped)
    with TemporaryDirectory() as cache:
        # Installed packages contain bytecode, so the processes write and read it.
        settings = {"PINRED_CACHE_DIR": cache, "PYTHONDONTWRITEBYTECODE": ""}
        done = subprocess.run(
            [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, check=True,
            env={**os.environ, **settings},
        )  # fmt: skip
    seconds, loaded = done.stdout.split()
    return float(seconds), loaded == "True"


def print_time(call: str, *, shipped: bool) -> None:
    """Print the time of a call in this process, and whether numba is loaded afterwards.

    Args:
        call: Name of the call, one of CALLS.
        shipped: Whether to use the shipped machine code.
    """
    from ...integrators.stepping import shipped_code
    from ...system.load import load

    if not shipped:
        shipped_code.FOLDER = Path(os.devnull)
    system = load(_ROBOT)
    began = time.perf_counter()
    CALLS[call](system)
    print(time.perf_counter() - began, "numba" in sys.modules)
