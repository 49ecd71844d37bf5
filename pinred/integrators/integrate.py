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
    LAYOUT,
    NOT_FINITE,
    NOTHING_KEPT,
    STAGES_KEPT,
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

# Step ends for which there is room at first.
_FIRST_KNOTS = 128
# Largest size of a solution with stored stage derivatives [bytes].
MOST_STAGE_BYTES = 1 << 25


@dataclass(eq=False)
class Solution:
    """Solution of one integration: states at the report times, and at any other time.

    The kernel must stay in memory as long as `at` is called.

    Attributes:
        method: Integrator.
        times: Report times, (T,) sorted [s].
        y: States at these times, (T, n); read-only.
        complete: Whether the integration reached its end, and was not stopped by a watcher.
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

        A quaternion in them has the length that the step has left; `at` gives it length one.
        """
        return read_only(self._rows[: self.steps + 1, : self.y.shape[1]])

    @property
    def stored(self) -> Array:
        """States at the step ends, followed by the stored stage derivatives, (K, n + …)."""
        return read_only(self._rows[: self.steps + 1])

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
            self.params,
            stepper.work(n, tangent=run["tangent"].item() > 0),
            read_only(asked[order]),
            out,
            self.knots,
            self.stored,
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
    integration = Integration(
        method, address, len(state), end, asked, quaternion, canonical, tangent
    )
    return integration(frozen, state, progress=progress)


class Integration:
    """A prepared integration over one time span, for any initial state and parameters."""

    def __init__(
        self,
        method: Method,
        address: int,
        n: int,
        end: float,
        times: Array,
        quaternion: int = -1,
        canonical: Canonical = (0, 0),
        tangent: Tangent | None = None,
    ) -> None:
        """Prepare what all runs share; the arguments are not checked.

        Args:
            method: Integrator.
            address: Address of the kernel of f.
            n: Length of the state.
            end: End time [s].
            times: Report times, (T,) sorted and read-only [s].
            quaternion: As for `integrate`.
            canonical: As for `integrate`.
            tangent: As for `integrate`.

        Raises:
            InputError: The method needs a derivative, and `tangent` is None.
        """
        self.times = times
        self._method, self._n, self._end, self._tangent = method, n, end, tangent
        self._stepper = stepper = method.stepper()
        run = begun_by(method, address, n, end, quaternion, canonical, keep=ENDS_KEPT)
        if stepper.needs_tangent:
            give_tangent(tangent, method, run)
        self._registers, self._work, self._room = run.tobytes(), stepper.work(n), _FIRST_KNOTS

    def __call__(
        self,
        params: Array,
        y0: Array,
        *,
        stages: bool = False,
        progress: Progress | None = None,
        watch: Callable[[Solution], bool] | None = None,
    ) -> Solution:
        """Return the solution from y0 (n,) at time 0.

        Args:
            params: Parameters of the kernel, (p,); nobody changes them afterwards.
            y0: Initial state, (n,).
            stages: Whether to store stage derivatives for the backward pass, as long as they take
                at most MOST_STAGE_BYTES.
            progress: Called now and then with the fraction of the time that is done.
            watch: Called with the solution so far, now and then and before a failure; if it
                returns True, the integration stops there and the solution is not complete.

        Returns:
            The solution.

        Raises:
            IntegrationError: The integration failed; see `integrate`.
        """
        n, times, room, stepper = self._n, self.times, self._room, self._stepper
        run, work = np.frombuffer(bytearray(self._registers), LAYOUT), self._work.copy()
        work[Y, :n] = y0
        width = (stepper.kept + stepper.stages * stages) * n
        if stages and 8 * room * width > MOST_STAGE_BYTES:
            stages, width = False, stepper.kept * n
        if stages:
            run["keep"] = STAGES_KEPT
        out, knots, rows = np.empty((len(times), n)), np.empty(room), np.empty((room, width))
        advance = stepper.loops.advance
        while True:
            status = advance(run, params, work, times, out, knots, rows)
            if status == DONE:
                if progress is not None:
                    progress(run["t"].item() / self._end)
                return Solution(self._method, times, read_only(out), True, params, run, knots, rows)
            if watch is not None and run["steps"]:
                told = run["next"].item()
                part = Solution(
                    self._method, times[:told], read_only(out[:told]), False, params, run, knots,
                    rows,
                )  # fmt: skip
                if watch(part):
                    return part
            if status == FULL:
                self._room = 2 * len(knots)
                if stages and 8 * self._room * width > MOST_STAGE_BYTES:
                    return self(params, y0, progress=progress, watch=watch)
                knots, rows = _doubled(knots), _doubled(rows)
            elif status == WANTED:
                give_tangent(self._tangent, self._method, run)
                work = stepper.widened(n, work)
            elif status >= UNDERFLOW:
                raise failure(status, run, work[Y, :n].copy())
            if progress is not None:
                progress(run["t"].item() / self._end)


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
