"""The registers of a run, held in a record so that it can stop and go on, and what stops it.

Compiled code sees a `Run` and its fields by name; Python holds it in an array of one (1,).
"""

from __future__ import annotations

from struct import Struct
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

# What `advance` returns.  WANTED: the derivative of the kernel.
DONE, PAUSED, FULL, WANTED, UNDERFLOW, NOT_FINITE, TOO_MANY, DIVERGED = range(8)
AGAIN = 8  # of an attempt: it is to be made anew

# How implicit steps are solved, by methods that have the choice.
AUTO, FIXED_POINT, NEWTON = 1, 2, 3

# What of a step is in the rows: its ends, all that makes it, or what its dense output takes.
ENDS, STEP, DENSE = range(3)

# What is kept of steps: nothing, their ends, or the rates of their stages too.
NOTHING_KEPT, ENDS_KEPT, STAGES_KEPT = range(3)

# At most some milliseconds: Ctrl-C and progress come through.
EVALUATIONS_BETWEEN_PAUSES = 4096


class Run:
    """The registers of a run."""

    t: float  # time [s]
    h: float  # next step
    t_end: float
    max_step: float
    rtol: float
    atol: float
    before: float  # the step before, 0 if there is none of use
    error: float  # of a step, in units of the tolerance
    error_before: float  # of the step before
    growth: float  # by what the next step may be longer
    quotient: float  # or is to be shorter
    factored: float  # the step that Newton's method has factors for
    contraction: float  # by what Newton's method converges
    convergence: float  # what it then leaves of a change
    cut: float  # by what a step is cut where it fails

    address: int  # of the kernel
    tangent: int  # address of the kernel of the derivative, or 0
    n: int  # numbers in the state
    quaternion: int  # first of the quaternion's four, or −1
    pairs: int  # positions, with as many momenta behind them
    spin: int  # how many parameters are a constant momentum
    stages: int  # that one evaluation takes at once
    lanes: int  # with idle ones
    solver: int  # how implicit steps are solved
    total: int  # number of steps, if it is known beforehand
    max_steps: int  # limit on trials
    budget: int  # evaluations before a pause
    keep: int  # what is kept of steps

    begun: int  # whether the run has begun
    pause: int  # evaluations at which it pauses
    steps: int  # accepted
    rejected: int
    evaluations: int
    next: int  # time to report
    known: int  # what of the step is in the rows
    again: int  # whether the last trial was rejected
    entry: int  # which number was not finite, or −1
    fresh: int  # whether the Jacobian is that of the state
    remaining: int  # steps that Newton's method is still to make
    member: int  # of a batch, or −1


Runs: TypeAlias = NDArray[np.void]  # (1,) of LAYOUT

_KINDS = {"float": "d", "int": "q"}
_PACKED = Struct("".join(_KINDS[kind] for kind in Run.__annotations__.values()))
LAYOUT = np.dtype([(name, _KINDS[kind]) for name, kind in Run.__annotations__.items()], align=True)
_FIRST: dict[str, Any] = {
    **dict.fromkeys(Run.__annotations__, 0),
    "quaternion": -1,
    "entry": -1,
    "member": -1,
}


def new_run(**numbers: float) -> Runs:
    """Return the registers of a run that has not begun, with some of them given."""
    first = {**_FIRST, "budget": EVALUATIONS_BETWEEN_PAUSES, **numbers}
    # Twice as fast as an array of a tuple.
    return np.frombuffer(bytearray(_PACKED.pack(*first.values())), LAYOUT)


def copied(runs: Runs) -> Runs:
    """Return registers that change apart from these."""
    return np.frombuffer(bytearray(runs.tobytes()), LAYOUT)
