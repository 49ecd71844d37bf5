"""The interface by which a run is saved at its pauses and continued from there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from ..common.arrays import Array
from .stepping.run_state import LAYOUT, Runs

SavedRun = Mapping[str, Any]


class RunKeeper(Protocol):
    """The saved state of one run, as nested values (see common/packed_values.py)."""

    def saved(self) -> SavedRun | None:
        """Return the state from which the run continues; None for a new run."""

    def pause(self, state: Callable[[], dict[str, Any]]) -> None:
        """Keep a state if a save is due; the function must be called before the run continues."""

    def finish(self, state: dict[str, Any]) -> None:
        """Keep the state of the finished run, whose arrays do not change afterwards."""


def packed_registers(run: Runs) -> bytes:
    """Return the registers of a run without addresses, which differ between processes."""
    registers = np.frombuffer(bytearray(run.tobytes()), LAYOUT)
    registers["address"] = registers["closing"] = 0
    registers["tangent"] = registers["tangent"] != 0
    return registers.tobytes()


def unpacked_registers(data: bytes, first: Runs) -> Runs:
    """Return saved registers with the kernel addresses of a run before its first step.

    The register `tangent` is 1 if the run has used the tangent kernel, else 0.
    """
    run = np.frombuffer(bytearray(data), LAYOUT)
    run["address"], run["closing"] = first["address"], first["closing"]
    return run


def saved_state(
    run: Runs, reported: Array, knots: Array, rows: Array, work: Array | None = None
) -> dict[str, Any]:
    """Return the state of a run as nested values, without unused space.

    Args:
        run: Registers, (1,).
        reported: States at the report times, (T, n).
        knots: Times of the step ends, (K,) [s].
        rows: Stored states, (K, …).
        work: Work rows; None for a finished run.
    Returns:
        The state.
    """
    count = run["steps"].item() + 1
    state = {
        "run": packed_registers(run),
        "reported": reported,
        "knots": knots[:count],
        "rows": rows[:count],
    }
    return state if work is None else state | {"work": work, "capacity": len(knots)}
