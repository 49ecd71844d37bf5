"""integrate(): one run of a stepper, and its Solution."""

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
    """A run: the states at the times asked for, and what gives those at any other time.

    times: (T,) [s].  y: (T, n).  steps, rejected, evaluations: what it cost.
    knots: (K,) times of the ends of all steps [s].  states: (K, n) there; a quaternion in
    them has the length that the step has left, `at` gives it length one.  complete: whether the
    run came to its end, and was not stopped before by who watched it.
    The kernel has to stay in memory as long as `at` is called.
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
        """The states at the knots with what is kept of the stages that led there, (K, n + …)."""
        return self._stored

    def at(self, times: ArrayLike) -> Array:
        """Return the states (T, n) at times (T,) in any order, as if they had been asked for.

        Only the steps around these times are computed again.  Raises InputError, and NoConvergence
        if an implicit step to one of them has no solution that could be found.
        """
        asked = checked_times(times, float(self.knots[-1]), ordered=False)
        order = np.argsort(asked, kind="stable")
        n = self.states.shape[1]
        out = np.empty((len(asked), n))
        stepper, run = self.method.stepper(), copied(self._run)
        stepper.loops.recall(
            run,
            self._params,
            stepper.work(n, tangent=run["tangent"].item() > 0),
            read_only(asked[order]),
            out,
            self.knots,
            self._stored,
        )
        lost = np.flatnonzero(np.isnan(out).any(axis=1))
        if lost.size:
            time = float(asked[order][lost[0]])
            before = self.states[np.searchsorted(self.knots, time) - 1]
            raise NoConvergence(
                f"the state at t = {time:g} s, within a step, has no solution that could be "
                "found: take shorter steps",
                time,
                before,
            )
        y = np.empty_like(out)
        y[order] = out
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
    """Integrate ẏ = f(y, params) from y0 (n,) at time 0 to t_end [s].

    address: of the kernel of f.  params: (p,), all that f needs.
    times: (T,) sorted, within [0, t_end]: when the state is wanted.
    quaternion: index of the first of the four numbers in y that are a quaternion
        (x, y, z, w), −1 for none; its rate is ½ q ω with the body's angular velocity ω.
    progress: called now and then with the part of the time that is done, 0 to 1.
    tangent: gives the address of the kernel of ∂f/∂y (see call_tangent); called at most once,
        when the method wants it.
    canonical: how many of y are positions, with as many momenta behind them, and how many
        parameters are the constant momentum J with q̄ J q in the equations: for Variational.

    Raises InputError, and StepSizeUnderflow, NonFiniteState, NoConvergence or TooManySteps with
    the time and the state at which the run stopped.
    """
    end = positive(t_end, "t_end")
    check_kernel(address)
    state = as_floats(y0, "y0")
    check_state(state, quaternion, "y0", 1)
    asked = checked_times(times, end, ordered=True)
    frozen = read_only(np.array(as_floats(params, "params")))
    return integrate_checked(
        method, address, frozen, state, end, asked, quaternion, progress, tangent, canonical
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
    """Integrate as `integrate` does, with arguments that are known to be right.

    params and times are not changed by anybody afterwards.  watch: is given what there is now and
    then, and before a failure, and says whether to stop there; then the Solution is not complete.
    """
    n = y0.shape[0]
    stepper = method.stepper()
    run = begun_by(method, address, n, end, quaternion, canonical, keep=ENDS_KEPT)
    if stepper.needs_tangent:
        give_tangent(tangent, method, run)
    work = stepper.work(n)
    work[Y, :n] = y0
    out = np.empty((len(times), n))
    knots, states = np.empty(_FIRST_KNOTS), np.empty((_FIRST_KNOTS, stepper.kept * n))

    def so_far(*, complete: bool) -> Solution:
        steps = run["steps"].item()
        stored = read_only(states[: steps + 1])
        told = len(times) if complete else run["next"].item()
        return Solution(
            method=method,
            times=times[:told],
            y=read_only(out[:told]),
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
        status = stepper.loops.advance(run, params, work, times, out, knots, states)
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
    """Return the registers of a run to `end` [s] before its first step."""
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
    """Return the error for a status of `advance`; state: (n,) at the last time reached."""
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
    """Check what can be checked of a kernel's address.  Raises InputError."""
    if isinstance(address, bool) or not isinstance(address, int) or address <= 0:
        raise InputError(f"address must be the address of a kernel, got {address!r}")


def give_tangent(tangent: Tangent | None, method: Method, run: Runs) -> None:
    """Give a run the kernel of the derivative; without one it has to do by fixed points.

    Raises InputError if it cannot.
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
    """Check initial states (…, n) with n > 0, and where the quaternion is.  Raises InputError."""
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
    """Return times as a read-only array (T,) within [0, t_end].  Raises InputError."""
    asked = np.array(as_floats(times, "times"))
    if asked.ndim != 1:
        raise ShapeError(f"times must have shape (T,), got {asked.shape}")
    if asked.size:
        if not (asked.min() >= 0.0 and asked.max() <= t_end):  # NaN is outside too
            raise InputError(f"times must lie between 0 and {t_end:g} s, got {asked}")
        if ordered and (asked[1:] < asked[:-1]).any():
            raise InputError(f"times must be sorted, got {asked}")
    return read_only(asked)


def _doubled(array: Array) -> Array:
    larger = np.empty((2 * len(array), *array.shape[1:]))
    larger[: len(array)] = array
    return larger
