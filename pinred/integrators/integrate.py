"""integrate(): one run of a method, and its Solution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

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
from .methods.method import Method
from .stepping.run_record import (
    AUTO,
    DIVERGED,
    DONE,
    ENDS_KEPT,
    FIXED_POINT,
    FULL,
    NOT_FINITE,
    NOTHING_KEPT,
    UNDERFLOW,
    WANTED,
    Runs,
    copied,
    new_run,
)
from .stepping.state_rows import Y

Progress = Callable[[float], None]
Tangent = Callable[[], int]
Canonical = tuple[int, int]

_FIRST_KNOTS = 128


@dataclass(frozen=True)
class Solution:
    """A run: the states at the report times, and the steps for dense output.

    The kernel must stay loaded as long as `at` is called.

    Attributes:
        method: Method of the run.
        times: Report times, (T,) [s].
        y: States at the report times, (T, n).
        steps: Number of accepted steps.
        rejected: Number of rejected steps.
        evaluations: Number of evaluations of the kernel.
        knots: Times of all step ends, (K,) [s].
        states: States at the step ends before normalisation of the quaternion, (K, n). The states
            returned by `at` are normalised.
        complete: Whether the run reached its end; if not, its watcher has stopped it.
    """

    method: Method
    times: Array
    y: Array
    steps: int
    rejected: int
    evaluations: int
    knots: Array
    states: Array
    complete: bool
    _stored: Array = field(repr=False)
    _params: Array = field(repr=False)
    _run: Runs = field(repr=False)

    @property
    def stored(self) -> Array:
        """States at the step ends, followed by the stored stages of each step, (K, n + …)."""
        return self._stored

    def at(self, times: ArrayLike) -> Array:
        """Return the states at given times, equal to those reported by the run.

        Only the steps that contain these times are recomputed.

        Args:
            times: Times in any order, (T,) [s].
        Returns:
            States, (T, n).
        Raises:
            InputError: A time is outside of the run.
            NoConvergence: An implicit step to one of the times was not solved.
        """
        asked = checked_times(times, float(self.knots[-1]), ordered=False)
        order = np.argsort(asked, kind="stable")
        n = self.states.shape[1]
        sorted_states = np.empty((len(asked), n))
        stepper, run = self.method.stepper(), copied(self._run)
        stepper.loops.recall(
            run,
            self._params,
            stepper.work(n, tangent=run["tangent"].item() > 0),
            read_only(asked[order]),
            sorted_states,
            self.knots,
            self._stored,
        )
        lost = np.flatnonzero(np.isnan(sorted_states).any(axis=1))
        if lost.size:
            time = float(asked[order][lost[0]])
            last_state = self.states[np.searchsorted(self.knots, time) - 1]
            raise NoConvergence(
                f"the state at t = {time:g} s, within a step, has no solution that could be "
                "found: take shorter steps",
                time,
                last_state,
            )
        y = np.empty_like(sorted_states)
        y[order] = sorted_states
        return y


def integrate(
    method: Method,
    address: int,
    params: ArrayLike,
    y0: ArrayLike,
    t_end: float,
    times: ArrayLike,
    quaternion: int = -1,
    progress: Progress | None = None,
    tangent: Tangent | None = None,
    canonical: Canonical = (0, 0),
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
        quaternion: Index of the first of a quaternion's four entries (x, y, z, w) in y, −1 for
            none. Its rate is ½ q ω with the body angular velocity ω.
        progress: Called repeatedly with the finished fraction of the time, 0 to 1.
        tangent: Function that returns the address of the kernel of ∂f/∂y (see call_tangent). It is
            called at most once, when the method needs it.
        canonical: Number of positions in y, which as many momenta follow, and number of parameters
            that are the constant momentum J with q̄ J q in the equations; for Variational.
    Returns:
        The run.
    Raises:
        InputError: An argument is invalid.
        StepSizeUnderflow: The tolerance requires steps below round-off.
        NonFiniteState: A rate or a state is not finite.
        NoConvergence: An implicit step was not solved.
        TooManySteps: The run exceeds the limit on trial steps.
    """
    end = positive(t_end, "t_end")
    check_kernel(address)
    state = as_floats(y0, "y0")
    check_state(state, quaternion, "y0", 1)
    checked = checked_times(times, end, ordered=True)
    copied_params = read_only(np.array(as_floats(params, "params")))
    return integrate_checked(
        method,
        address,
        copied_params,
        state,
        end,
        checked,
        quaternion,
        progress,
        tangent,
        canonical,
    )


def integrate_checked(
    method: Method,
    address: int,
    params: Array,
    y0: Array,
    end: float,
    times: Array,
    quaternion: int,
    progress: Progress | None,
    tangent: Tangent | None = None,
    canonical: Canonical = (0, 0),
    watch: Callable[[Solution], bool] | None = None,
) -> Solution:
    """Integrate as `integrate` does, with valid arguments; params and times must not change later.

    Args:
        method: Method with its options.
        address: Address of the kernel.
        params: Parameters, (p,), read-only.
        y0: Initial state, (n,).
        end: End time [s].
        times: Sorted report times, (T,) [s], read-only.
        quaternion: Index of the first of the quaternion's four entries, −1 for none.
        progress: Called with the finished fraction of the time.
        tangent: Function that returns the address of the kernel of ∂f/∂y.
        canonical: See `integrate`.
        watch: Called repeatedly, and before an error is raised, with the run so far. If it returns
            true, the run stops there and its Solution is not complete.
    Returns:
        The run.
    """
    n = y0.shape[0]
    stepper = method.stepper()
    run = begun_by(method, address, n, end, quaternion, canonical, keep=ENDS_KEPT)
    if stepper.needs_tangent:
        give_tangent(tangent, method, run)
    work = stepper.work(n)
    work[Y, :n] = y0
    reported_states = np.empty((len(times), n))
    knots, states = np.empty(_FIRST_KNOTS), np.empty((_FIRST_KNOTS, stepper.kept * n))

    def so_far(*, complete: bool) -> Solution:
        steps = run["steps"].item()
        stored = read_only(states[: steps + 1])
        reported = len(times) if complete else run["next"].item()
        return Solution(
            method=method,
            times=times[:reported],
            y=read_only(reported_states[:reported]),
            steps=steps,
            rejected=run["rejected"].item(),
            evaluations=run["evaluations"].item(),
            knots=read_only(knots[: steps + 1]),
            states=stored[:, :n],
            complete=complete,
            _stored=stored,
            _params=params,
            _run=run,
        )

    status = -1
    while status != DONE:
        status = stepper.loops.advance(run, params, work, times, reported_states, knots, states)
        if status != DONE and watch is not None and run["steps"] and watch(so_far(complete=False)):
            return so_far(complete=False)
        if status == FULL:
            knots, states = _doubled(knots), _doubled(states)
        elif status == WANTED:
            give_tangent(tangent, method, run)
            work = stepper.widened(n, work)
        elif status >= UNDERFLOW:
            raise failure(status, run, work[Y, :n].copy())
        if progress is not None:
            progress(run["t"].item() / end)
    return so_far(complete=True)


def begun_by(
    method: Method,
    address: int,
    n: int,
    end: float,
    quaternion: int,
    canonical: Canonical,
    keep: int = NOTHING_KEPT,
) -> Runs:
    """Return the registers of a run to `end` [s] before its first step; keep: stored data."""
    pairs, spin = canonical
    return new_run(
        address=address,
        n=n,
        t_end=end,
        quaternion=quaternion,
        pairs=pairs,
        spin=spin,
        keep=keep,
        **method.registers(end),
    )


def failure(status: int, run: Runs, state: Array) -> IntegrationError:
    """Return the error for a status of `advance`.

    Args:
        status: The status.
        run: Registers of the run.
        state: State at the last time reached, (n,).
    Returns:
        The error.
    """
    end = run[0]
    time, entry = end["t"].item(), end["entry"].item()
    where = f"t = {time:g} s of {end['t_end']:g} s"
    if status == NOT_FINITE:
        return NonFiniteState(f"number {entry} is not finite after {where}", time, state, entry)
    if status == UNDERFLOW:
        return StepSizeUnderflow(
            f"the tolerance (rtol = {end['rtol']:g}) asks for steps below {end['h']:.1e} s at "
            f"{where}: the motion is singular there, or the tolerance too tight",
            time,
            state,
        )
    if status == DIVERGED:
        return NoConvergence(
            f"the implicit step of {end['h']:.3g} s has no solution that could be found after "
            f"{where}: take shorter steps",
            time,
            state,
        )
    return TooManySteps(
        f"{end['max_steps']} steps have led to {where}; allow more (max_steps), or a larger "
        f"tolerance than rtol = {end['rtol']:g}",
        time,
        state,
    )


def check_kernel(address: int) -> None:
    """Raise InputError if an address cannot be that of a kernel."""
    if isinstance(address, bool) or not isinstance(address, int) or address <= 0:
        raise InputError(f"address must be the address of a kernel, got {address!r}")


def give_tangent(tangent: Tangent | None, method: Method, run: Runs) -> None:
    """Set the derivative kernel of a run; without one, the run uses fixed-point iteration.

    Args:
        tangent: Function that returns its address, or None.
        method: Method of the run.
        run: Registers, changed in place.
    Raises:
        InputError: The method needs the derivative and there is none.
    """
    if tangent is not None:
        address = tangent()
        check_kernel(address)
        run["tangent"] = address
    elif run["solver"] == AUTO:
        run["solver"] = FIXED_POINT
    else:
        raise InputError(f"{method.name} needs the derivative of the kernel; give tangent=")


def check_state(y0: Array, quaternion: int, what: str, ndim: int) -> None:
    """Check initial states and the position of the quaternion.

    Args:
        y0: Initial states, (…, n).
        quaternion: Index of the first of the quaternion's four entries, −1 for none.
        what: Name of the argument in messages.
        ndim: Expected number of axes.
    Raises:
        ShapeError: The shape is wrong or a number is not finite.
        InputError: The quaternion is outside of the state or zero.
    """
    if y0.ndim != ndim or y0.shape[-1] == 0:
        shape = "(n,)" if ndim == 1 else "(N, n)"
        raise ShapeError(f"{what} must have shape {shape} with n > 0, got {y0.shape}")
    if not np.isfinite(y0).all():
        raise ShapeError(f"{what} must be finite, got {y0}")
    n = y0.shape[-1]
    if quaternion != -1 and not 0 <= quaternion <= n - 4:
        raise InputError(
            f"quaternion must be −1 or the index of four of the {n} numbers, got {quaternion}"
        )
    if quaternion >= 0 and not y0[..., quaternion : quaternion + 4].any(axis=-1).all():
        raise InputError(f"the quaternion in {what} is zero")


def checked_times(times: ArrayLike, t_end: float, *, ordered: bool) -> Array:
    """Return times as a read-only array (T,) within [0, t_end].

    Args:
        times: Times [s].
        t_end: End time [s].
        ordered: Whether they must be sorted.
    Returns:
        The times.
    Raises:
        ShapeError: There is not exactly one axis.
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


def _doubled(array: Array) -> Array:
    larger = np.empty((2 * len(array), *array.shape[1:]))
    larger[: len(array)] = array
    return larger
