"""Solution: the result of one integration, with dense output; the states of saved runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from ..common.arrays import Array, as_floats, read_only
from ..common.errors import InputError, NoConvergence, ShapeError
from .methods.method import Method, stepper_of
from .stepping.run_state import LAYOUT, Runs, copied

if TYPE_CHECKING:
    from .stepping.step_loop import Stepper


@dataclass(eq=False)
class Solution:
    """Solution of one integration: states at the report times, and at any other time.

    The kernel must stay in memory as long as `at` is called.

    Attributes:
        method: Integrator.
        times: Report times, (T,) sorted [s].
        y: States at the report times, (T, n); read-only.
        complete: Whether the integration reached its end time, and was not stopped by `watch`.
        params: Parameters of the kernel, (p,).
    """

    method: Method
    times: Array
    y: Array
    complete: bool
    params: Array = field(repr=False)
    _run: Runs = field(repr=False)
    _knots: Array = field(repr=False)
    _rows: Array = field(repr=False)

    @cached_property
    def _stepper(self) -> Stepper:
        return stepper_of(self.method)

    @property
    def steps(self) -> int:
        """Number of accepted steps."""
        return int(self._run["steps"].item())

    @property
    def rejected(self) -> int:
        """Number of rejected steps."""
        return int(self._run["rejected"].item())

    @property
    def evaluations(self) -> int:
        """Number of evaluations of the vector field."""
        return int(self._run["evaluations"].item())

    @property
    def knots(self) -> Array:
        """Times of all step ends, (K,) [s]."""
        return read_only(self._knots[: self.steps + 1])

    @property
    def states(self) -> Array:
        """States at the step ends, (K, n).

        Quaternions in these states are not normalised after the step; `at` returns unit
        quaternions.
        """
        return read_only(self._rows[: self.steps + 1, : self.y.shape[1]])

    @property
    def stored(self) -> Array:
        """States at the step ends, followed by the stored stage derivatives, (K, n + …)."""
        return read_only(self._rows[: self.steps + 1])

    def at(self, times: ArrayLike) -> Array:
        """Return the states at given times; at report times they equal the reported states.

        Only the steps that contain these times are recomputed.

        Args:
            times: Times in any order, (T,) [s].
        Returns:
            States, (T, n).
        Raises:
            InputError: A time is outside of the run.
            NoConvergence: The equations of an implicit step to one of the times did not converge.
        """
        asked = checked_times(times, float(self.knots[-1]), ordered=False)
        order = np.argsort(asked, kind="stable")
        n = self.states.shape[1]
        sorted_states = np.empty((len(asked), n))
        stepper, run = self._stepper, copied(self._run)
        stepper.loops.recall(
            run,
            self.params,
            stepper.work(n, tangent=run["tangent"].item() > 0),
            read_only(asked[order]),
            sorted_states,
            self.knots,
            self.stored,
        )
        lost = np.flatnonzero(np.isnan(sorted_states).any(axis=1))
        if lost.size:
            time = float(asked[order][lost[0]])
            last_state = self.states[np.searchsorted(self.knots, time) - 1]
            raise NoConvergence(
                f"the state at t = {time:g} s, inside a step, did not converge; use shorter steps",
                time,
                last_state,
            )
        y = np.empty_like(sorted_states)
        y[order] = sorted_states
        return y


def checked_times(times: ArrayLike, t_end: float, *, ordered: bool) -> Array:
    """Return times as a read-only array (T,) within [0, t_end].

    Args:
        times: Times [s].
        t_end: End time [s].
        ordered: Whether the times must be sorted.
    Returns:
        The times.
    Raises:
        ShapeError: The array does not have exactly one axis.
        InputError: Times are outside of the run or not sorted.
    """
    checked = np.array(as_floats(times, "times"))
    if checked.ndim != 1:
        raise ShapeError(f"times must have shape (T,), got {checked.shape}")
    if checked.size:
        if not (checked.min() >= 0.0 and checked.max() <= t_end):  # NaN is outside too
            raise InputError(f"times must lie between 0 and {t_end:g} s, got {checked}")
        if ordered and (checked[1:] < checked[:-1]).any():
            raise InputError(f"times must be sorted, got {checked}")
    return read_only(checked)


SavedRun = Mapping[str, Any]


class RunKeeper(Protocol):
    """The saved state of one run, as nested values (see common/arrays.py)."""

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
