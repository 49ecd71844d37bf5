"""The registers of a run, in a record from which an interrupted run continues, and status codes.

Compiled code uses a `Run` and its fields by name. Python stores it in an array (1,) of LAYOUT.
"""

from __future__ import annotations

from struct import Struct
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

# Return values of `advance`. WANTED: it needs the derivative of the kernel.
DONE, PAUSED, FULL, WANTED, UNDERFLOW, NOT_FINITE, TOO_MANY, DIVERGED = range(8)
AGAIN = 8  # return value of an attempted step that was rejected

# Solvers of implicit steps.
AUTO, FIXED_POINT, NEWTON = 1, 2, 3

# Contents of the work rows: the ends of a step, its stages, or also the terms of its dense output.
ENDS, STEP, DENSE = range(3)

# Stored data of steps: nothing, their ends, or also the rates of their stages.
NOTHING_KEPT, ENDS_KEPT, STAGES_KEPT = range(3)

# This many evaluations take at most some milliseconds, so Ctrl-C and progress stay responsive.
EVALUATIONS_BETWEEN_PAUSES = 4096


class Run:
    """The registers of a run."""

    t: float  # time [s]
    h: float  # next step [s]
    t_end: float
    max_step: float
    rtol: float
    atol: float
    before: float  # previous step [s], 0 if there is none to extrapolate from
    error: float  # error of a step, in units of the tolerance
    error_before: float  # error of the previous step
    growth: float  # factor by which the next step may be longer
    quotient: float  # factor by which the next step must be shorter
    factored: float  # length of the step for which Newton's method has factors [s]
    contraction: float  # ratio of successive changes in Newton's method
    convergence: float  # ratio of the remaining error to the last change
    cut: float  # factor by which a failed step is shortened

    address: int  # address of the kernel
    tangent: int  # address of the kernel of the derivative, or 0
    n: int  # entries of the state
    quaternion: int  # index of the first of the quaternion's four entries, or −1
    pairs: int  # number of positions, which as many momenta follow
    spin: int  # number of parameters that are a constant momentum
    stages: int  # stages per evaluation
    lanes: int  # SIMD lanes, including idle ones
    solver: int  # solver of implicit steps
    total: int  # number of steps, if steps are equal
    max_steps: int  # limit on trial steps
    budget: int  # evaluations between pauses
    keep: int  # stored data of steps

    begun: int  # whether the first step was prepared
    pause: int  # number of evaluations at the next pause
    steps: int  # accepted steps
    rejected: int
    evaluations: int
    next: int  # index of the next report time
    known: int  # contents of the work rows
    again: int  # whether the last trial was rejected
    entry: int  # entry that was not finite, or −1
    fresh: int  # whether the Jacobian belongs to the current state
    remaining: int  # steps before fixed-point iteration is tried again
    member: int  # member of a batch, or −1


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
    """Return the registers of a run before its first step, with the given values."""
    first = {**_FIRST, "budget": EVALUATIONS_BETWEEN_PAUSES, **numbers}
    # Twice as fast as an array of a tuple.
    return np.frombuffer(bytearray(_PACKED.pack(*first.values())), LAYOUT)


def copied(runs: Runs) -> Runs:
    """Return an independent copy of registers."""
    return np.frombuffer(bytearray(runs.tobytes()), LAYOUT)
