"""integrate(): validate arguments, run one integration, and return its Solution.

integrate_parts() integrates over parts of time. The loop over parts is compiled, because a run with
many switches spends most of its time there.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..common.arrays import Array, as_floats, positive, read_only
from ..common.errors import (
    InputError,
    IntegrationError,
    NoConvergence,
    NonFiniteState,
    ShapeError,
    StepSizeUnderflow,
    TooManySteps,
)
from .methods.method import ErrorControl, Method, registers_of, stepper_of
from .stepping.run_state import (
    AUTO,
    DIVERGED,
    DONE,
    ENDS_KEPT,
    FIXED_POINT,
    FULL,
    LAYOUT,
    NOT_CANONICAL,
    NOT_FINITE,
    NOTHING_KEPT,
    STAGES_KEPT,
    UNDERFLOW,
    WANTED,
    Canonical,
    Quaternions,
    Runs,
    Y,
    copied,
    new_run,
)

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


Progress = Callable[[float], None]
Tangent = Callable[[], int]

_FIRST_KNOTS = 128  # initial number of entries in the arrays of step ends
# Largest size of a solution with stored stage derivatives [bytes].
MOST_STAGE_BYTES = 1 << 25


def integrate(
    method: Method,
    address: int,
    params: ArrayLike,
    y0: ArrayLike,
    t_end: float,
    times: ArrayLike,
    quaternions: Quaternions = (0, 0),
    progress: Progress | None = None,
    tangent: Tangent | None = None,
    canonical: Canonical = NOT_CANONICAL,
) -> Solution:
    """Integrate ẏ = f(y, params) from y0 to t_end.

    Args:
        method: Method with its options.
        address: Address of a kernel of f. Kernels for Gauss and AdaptiveGauss evaluate method.lanes
            states at once: entry i of state j is number i·lanes + j.
        params: Parameters, (p,).
        y0: Initial state, (n,).
        t_end: End time [s].
        times: Sorted report times within [0, t_end], (T,) [s].
        quaternions: Index in y of the first entry of the first quaternion, and number of
            consecutive quaternions (x, y, z, w); (0, 0) for none. The rate of each quaternion q is
            ½ q ω, with its body angular velocity ω.
        progress: Called repeatedly with the finished fraction of the time, 0 to 1.
        tangent: Function that returns the address of the kernel of ∂f/∂y (see call_tangent). It is
            called at most once, when the method needs it.
        canonical: Used by Variational only; see Canonical.
    Returns:
        The solution, with states at the report times and dense output.
    Raises:
        InputError: An argument is invalid.
        StepSizeUnderflow: The tolerance requires steps below round-off.
        NonFiniteState: A rate or a state is not finite.
        NoConvergence: The equations of an implicit step did not converge.
        TooManySteps: The run exceeds the limit on trial steps.
    """
    end = positive(t_end, "t_end")
    check_kernel(address)
    state = as_floats(y0, "y0")
    check_state(state, quaternions, "y0", 1)
    checked = checked_times(times, end, ordered=True)
    copied_params = read_only(np.array(as_floats(params, "params")))
    integration = Integration(
        method, address, len(state), end, checked, quaternions, canonical, tangent
    )
    return integration(copied_params, state, progress=progress)


class Integration:
    """A prepared integration over one time span, for any initial state and parameters."""

    def __init__(
        self,
        method: Method,
        address: int,
        n: int,
        end: float,
        times: Array,
        quaternions: Quaternions = (0, 0),
        canonical: Canonical = NOT_CANONICAL,
        tangent: Tangent | None = None,
        capacity: int | None = None,
    ) -> None:
        """Prepare the data that all runs share; the arguments are not validated.

        Args:
            method: Integrator.
            address: Address of the kernel of f.
            n: Length of the state.
            end: End time [s].
            times: Report times, (T,) sorted and read-only [s].
            quaternions: As for `integrate`.
            canonical: As for `integrate`.
            tangent: As for `integrate`.
            capacity: Number of step ends after which the first run calls `watch`; None for the
                usual number.
        Raises:
            InputError: The method needs a derivative, and `tangent` is None; or the state contains
                several quaternions, and the method supports only one.
        """
        self.times = times
        self._method, self._n, self._end, self._tangent = method, n, end, tangent
        self._stepper = stepper = stepper_of(method)
        run = begun_by(method, address, n, end, quaternions, canonical, keep=ENDS_KEPT)
        if stepper.needs_tangent:
            give_tangent(tangent, method, run)
        self._registers, self._work = run.tobytes(), stepper.work(n)
        self._capacity = capacity or _FIRST_KNOTS

    def __call__(
        self,
        params: Array,
        y0: Array,
        *,
        stages: bool = False,
        progress: Progress | None = None,
        watch: Callable[[Solution], bool] | None = None,
        keeper: RunKeeper | None = None,
    ) -> Solution:
        """Return the solution from y0 (n,) at time 0.

        Args:
            params: Parameters of the kernel, (p,); must not change afterwards.
            y0: Initial state, (n,).
            stages: Whether to store stage derivatives for the backward pass, as long as they take
                at most MOST_STAGE_BYTES.
            progress: Called repeatedly with the finished fraction of the time.
            watch: Called with the solution so far, repeatedly and before a failure; if it
                returns True, the integration stops there and the solution is not complete.
            keeper: Saves the run at its pauses, and continues a saved run; not with `stages`.
        Returns:
            The solution.
        Raises:
            IntegrationError: The integration failed; see `integrate`.
        """  # noqa: DOC501, the exception is built by a function
        n, times, capacity, stepper = self._n, self.times, self._capacity, self._stepper
        run, work = np.frombuffer(bytearray(self._registers), LAYOUT), self._work.copy()
        work[Y, :n] = y0
        width = (stepper.kept + stepper.stages * stages) * n
        if stages and 8 * capacity * width > MOST_STAGE_BYTES:
            stages, width = False, stepper.kept * n
        if stages:
            run["keep"] = STAGES_KEPT
        reported = np.empty((len(times), n))
        knots, end_states = np.empty(capacity), np.empty((capacity, width))
        advance = stepper.loops.advance
        if keeper is not None and (saved := keeper.saved()) is not None:
            run, work, reported, knots, end_states = self._continued(saved, run)
        while True:
            if keeper is not None:
                keeper.pause(partial(saved_state, run, reported, knots, end_states, work))
            status = advance(run, params, work, times, reported, knots, end_states)
            if status == DONE:
                if progress is not None:
                    progress(run["t"].item() / self._end)
                if keeper is not None:
                    keeper.finish(saved_state(run, reported, knots, end_states))
                return Solution(
                    self._method, times, read_only(reported), True, params, run, knots, end_states
                )
            if watch is not None and run["steps"]:
                count = run["next"].item()
                so_far = Solution(
                    self._method, times[:count], read_only(reported[:count]), False, params, run,
                    knots, end_states,
                )  # fmt: skip
                if watch(so_far):
                    return so_far
            if status == FULL:
                self._capacity = 2 * len(knots)
                if stages and 8 * self._capacity * width > MOST_STAGE_BYTES:
                    return self(params, y0, progress=progress, watch=watch)
                knots, end_states = doubled(knots), doubled(end_states)
            elif status == WANTED:
                give_tangent(self._tangent, self._method, run)
                work = stepper.widened(n, work)
            elif status >= UNDERFLOW:
                raise failure(status, run, work[Y, :n].copy())
            if progress is not None:
                progress(run["t"].item() / self._end)

    def _continued(self, saved: SavedRun, first: Runs) -> tuple[Runs, Array, Array, Array, Array]:
        """Return the registers, rows and arrays of a saved run, from its registers at the start."""
        run = unpacked_registers(saved["run"], first)
        if run["tangent"]:
            give_tangent(self._tangent, self._method, run)
        rows = saved["rows"]
        capacity = max(saved.get("capacity", 0), len(rows))
        knots, end_states = np.empty(capacity), np.empty((capacity, rows.shape[1]))
        knots[: len(rows)], end_states[: len(rows)] = saved["knots"], rows
        return run, saved.get("work", self._work), saved["reported"], knots, end_states


def begun_by(
    method: Method,
    address: int,
    n: int,
    end: float,
    quaternions: Quaternions,
    canonical: Canonical,
    keep: int = NOTHING_KEPT,
) -> Runs:
    """Return the registers of a run before its first step.

    Args:
        method: Method with its options.
        address: Address of the kernel.
        n: Number of entries of the state.
        end: End time [s].
        quaternions: As for `integrate`.
        canonical: As for `integrate`.
        keep: Code of the data stored at step ends.
    Returns:
        The registers.
    Raises:
        InputError: The state contains several quaternions, and the method supports only one.
    """
    first, count = quaternions
    if count > 1 and method.one_quaternion:
        raise InputError(
            f"quaternions: expected at most one quaternion for {method.name}, got {count}. Use "
            "another method, for example Gauss."
        )
    registers = registers_of(method, end)
    if keep != NOTHING_KEPT and "total" in registers:  # the number of steps is known in advance
        refuse_beyond_memory(registers["total"], 1 + stepper_of(method).kept * n)
    return new_run(
        address=address,
        n=n,
        t_end=end,
        quaternions_at=first,
        quaternion_count=count,
        **canonical._asdict(),
        keep=keep,
        **registers,
    )


def memory() -> int:
    """Return the size of the machine's memory [bytes]."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def refuse_beyond_memory(steps: float, width: int) -> None:
    """Reject step ends that the memory cannot hold, before the first step.

    Args:
        steps: Number of steps.
        width: Number of stored values per step.
    Raises:
        InputError: They take more than the memory of the machine.
    """
    needed, available = 8.0 * steps * width, memory()
    if needed > available:
        raise InputError(
            f"step: expected step ends that fit into {available / 1e9:.3g} GB of memory, got "
            f"{steps:.3g} steps with {needed / 1e9:.3g} GB. Choose a longer step."
        )


def failure(status: int, run: Runs, state: Array) -> IntegrationError:
    """Return the error for a status of `advance`.

    Args:
        status: Return value of `advance`.
        run: Registers of the run.
        state: State at the last time reached, (n,).
    Returns:
        The exception to raise.
    """
    end = run[0]
    time, entry = end["t"].item(), end["entry"].item()
    where = f"t = {time:g} s of {end['t_end']:g} s"
    if status == NOT_FINITE:
        return NonFiniteState(f"number {entry} is not finite after {where}", time, state, entry)
    if status == UNDERFLOW:
        return StepSizeUnderflow(
            f"the tolerance (rtol = {end['rtol']:g}) requires steps below {end['h']:.1e} s at "
            f"{where}: the motion is singular there, or the tolerance is too tight",
            time,
            state,
        )
    if status == DIVERGED:
        return NoConvergence(
            f"the implicit step of {end['h']:.3g} s after {where} did not converge; use "
            "shorter steps",
            time,
            state,
        )
    return TooManySteps(
        f"the run reached its limit of {end['max_steps']} steps at {where}; increase max_steps, or "
        f"use a larger tolerance than rtol = {end['rtol']:g}",
        time,
        state,
    )


def check_kernel(address: int) -> None:
    """Raise InputError if an address cannot be the address of a kernel."""
    if isinstance(address, bool) or not isinstance(address, int) or address <= 0:
        raise InputError(f"address must be the address of a kernel, got {address!r}")


def give_tangent(tangent: Tangent | None, method: Method, run: Runs) -> None:
    """Set the tangent kernel of a run; without it, the run uses fixed-point iteration.

    Args:
        tangent: Function that returns the address of the tangent kernel, or None.
        method: Method of the run.
        run: Registers, changed in place.
    Raises:
        InputError: The method needs the derivative, and `tangent` is None.
    """
    if tangent is not None:
        address = tangent()
        check_kernel(address)
        run["tangent"] = address
    elif run["solver"] == AUTO:
        run["solver"] = FIXED_POINT
    else:
        raise InputError(f"{method.name} needs the derivative of the kernel; give tangent=")


def check_state(y0: Array, quaternions: Quaternions, what: str, ndim: int) -> None:
    """Check initial states and the position of their quaternions.

    Args:
        y0: Initial states, (…, n).
        quaternions: Quaternions of the states, see `integrate`.
        what: Name of the argument in messages.
        ndim: Expected number of axes.
    Raises:
        ShapeError: The shape is wrong or a number is not finite.
        InputError: A quaternion is outside of the state or zero.
    """
    if y0.ndim != ndim or y0.shape[-1] == 0:
        shape = "(n,)" if ndim == 1 else "(N, n)"
        raise ShapeError(f"{what} must have shape {shape} with n > 0, got {y0.shape}")
    if not np.isfinite(y0).all():
        raise ShapeError(f"{what} must be finite, got {y0}")
    n = y0.shape[-1]
    if not _are_within(quaternions, n):
        raise InputError(
            "quaternions: expected the index of the first entry and the number of quaternions in "
            f"a state with {n} entries, got {quaternions!r}. Use (0, 0) for none."
        )
    first, count = quaternions
    for k in range(first, first + 4 * count, 4):
        if not y0[..., k : k + 4].any(axis=-1).all():
            raise InputError(
                f"{what}: expected quaternions of nonzero length, got zero for quaternion "
                f"{(k - first) // 4 + 1} of {count}, in entries {k} to {k + 3}."
            )


def _are_within(quaternions: object, n: int) -> bool:
    """Return whether a value is a tuple Quaternions for states with n entries."""
    if not isinstance(quaternions, tuple) or len(quaternions) != 2:
        return False
    first, count = quaternions  # a match statement would take ten times as long
    is_pair = isinstance(first, int) and isinstance(count, int)
    return is_pair and first >= 0 and count >= 0 and first + 4 * count <= n


def doubled(array: Array) -> Array:
    """Return a copy of an array with space for twice as many entries."""
    larger = np.empty((2 * len(array), *array.shape[1:]))
    larger[: len(array)] = array
    return larger


_NO_TIMES = read_only(np.empty(0))
_FIRST_KNOTS_OF_PART = 8  # initial number of step ends per part


@dataclass(frozen=True, eq=False)
class Parts:
    """The solutions of a run over S parts of time.

    Attributes:
        method: Integrator.
        params: Parameters of each part, (S, p).
        first: Index of the first step end of each part, and of the end of the last one, (S + 1,).
        knots: Times of all step ends, counted from the start of their part, (K,) [s].
    """

    method: ErrorControl
    params: Array
    first: NDArray[np.int64]
    knots: Array
    _runs: Runs
    _rows: Array

    @property
    def steps(self) -> int:
        """Number of accepted steps."""
        return int(self._runs["steps"].sum())

    @property
    def evaluations(self) -> int:
        """Number of evaluations of the vector field."""
        return int(self._runs["evaluations"].sum())

    def __len__(self) -> int:
        return len(self._runs)

    def __getitem__(self, k: int) -> Solution:
        """Return the solution over part k, which has no report times."""
        rows = slice(self.first[k], self.first[k + 1])
        n = self._runs["n"][k]
        return Solution(
            self.method, _NO_TIMES, np.empty((0, n)), True, self.params[k],
            self._runs[k : k + 1], self.knots[rows], self._rows[rows],
        )  # fmt: skip


def integrate_parts(
    method: ErrorControl,
    address: int,
    params: Array,
    y0: Array,
    lengths: Array,
    quaternions: Quaternions = (0, 0),
    canonical: Canonical = NOT_CANONICAL,
    tangent: Tangent | None = None,
    progress: Progress | None = None,
    explain: Callable[[IntegrationError, int], IntegrationError] | None = None,
) -> Parts:
    """Integrate from y0 over successive parts of time; arguments are not validated.

    Args:
        method: Method with step control.
        address: Address of the kernel.
        params: Parameters of the S parts, (S, p), read-only.
        y0: Initial state, (n,).
        lengths: Lengths of the parts, (S,), read-only [s].
        quaternions: As for `integrate`. They are normalised between parts.
        canonical: As for `integrate`.
        tangent: As for `integrate`.
        progress: Called repeatedly with the finished fraction of the parts.
        explain: Returns the error to raise instead of a failure in a part, given by its index.
    Returns:
        The solutions.
    Raises:
        IntegrationError: The integration failed; see `integrate`.
    """
    n, count, stepper = len(y0), len(lengths), stepper_of(method)
    first_run = begun_by(method, address, n, float(lengths[0]), quaternions, canonical, ENDS_KEPT)
    if stepper.needs_tangent:
        give_tangent(tangent, method, first_run)
    runs, first = np.zeros(count, LAYOUT), np.zeros(count + 1, np.int64)
    work, place = stepper.work(n), np.zeros(1, np.int64)
    work[Y, :n] = y0
    capacity = _FIRST_KNOTS_OF_PART * count
    knots, rows = np.empty(capacity), np.empty((capacity, stepper.kept * n))
    reports = np.empty((0, n))
    while True:
        status = stepper.loops.through(
            runs, first_run, params, lengths, work, _NO_TIMES, reports, knots, rows, first, place
        )
        k = int(place[0])
        if progress is not None:
            progress(k / count)
        if status == DONE:
            return Parts(method, params, first, knots, runs, rows)
        if status == FULL:
            knots, rows = doubled(knots), doubled(rows)
        elif status == WANTED:
            for registers in (first_run, runs[k : k + 1]):
                give_tangent(tangent, method, registers)
            work = stepper.widened(n, work)
        elif status >= UNDERFLOW:
            stop = failure(status, runs[k : k + 1], work[Y, :n].copy())
            raise stop if explain is None else explain(stop, k) from None
