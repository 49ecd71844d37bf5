"""Dense output of Hairer's dop853: in each step a polynomial of order 7.

SciPy's compiled loop has none. It is formed from the recorded stages of a step and three further
evaluations, with the coefficients of SciPy's `DOP853`.
Source: E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed.,
section II.6.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..common.arrays import Array
from .scipy_files import A_EXTRA, C_EXTRA, D

_STAGES = 13  # the 12 stages of a step, and the rate at its end
_POWERS = 7  # number of coefficients of the polynomial, besides the initial value


@dataclass(frozen=True)
class Step:
    """An accepted step of dop853.

    Attributes:
        t: Start [s].
        end: End [s].
        y: State at the start, (n,).
        y_end: State at the end, (n,).
        rates: Rates at the 12 stages and at the end, (n,) each.
    """

    t: float
    end: float
    y: Array
    y_end: Array
    rates: Sequence[Array]


@dataclass(frozen=True)
class DenseOutput:
    """States within S steps, which need not be adjacent.

    Attributes:
        starts: Starts of the steps, (S,) [s].
        ends: Ends of the steps, (S,) [s].
        y: States at the starts, (S, n).
        coefficients: Coefficients of the polynomials, (7, S, n).
    """

    starts: Array
    ends: Array
    y: Array
    coefficients: Array

    @staticmethod
    def joined(spans: Sequence[DenseOutput]) -> DenseOutput:
        """Return the dense output of several consecutive spans."""
        return DenseOutput(
            starts=np.concatenate([span.starts for span in spans]),
            ends=np.concatenate([span.ends for span in spans]),
            y=np.concatenate([span.y for span in spans]),
            coefficients=np.concatenate([span.coefficients for span in spans], axis=1),
        )

    def __call__(self, t: Array) -> Array:
        """Return the states (T, n) at times (T,), each of which lies within a step."""
        k = np.minimum(np.searchsorted(self.ends, t), len(self.ends) - 1)
        s = ((t - self.starts[k]) / (self.ends[k] - self.starts[k]))[:, None]
        y = np.zeros((len(t), self.y.shape[1]))
        for power in range(_POWERS - 1, -1, -1):
            y = (y + self.coefficients[power, k]) * (1.0 - s if power % 2 else s)
        return np.asarray(self.y[k] + y)


def dense_output(steps: Sequence[Step], rate: Callable[[float, Array], Array]) -> DenseOutput:
    """Form the dense output of steps.

    Args:
        steps: Accepted steps, S of them.
        rate: Vector field (t, y) → dy/dt, (n,), which is evaluated three times in each step.
    Returns:
        The dense output.
    """
    starts, ends = np.array([step.t for step in steps]), np.array([step.end for step in steps])
    y, y_end = np.array([step.y for step in steps]), np.array([step.y_end for step in steps])
    h, further = (ends - starts)[:, None], len(C_EXTRA)
    K = np.empty((_STAGES + further, *y.shape))
    K[:_STAGES] = np.array([step.rates for step in steps]).transpose(1, 0, 2)
    for stage, (a, c) in enumerate(zip(A_EXTRA, C_EXTRA, strict=True), _STAGES):
        states = y + h * np.tensordot(a[:stage], K[:stage], 1)
        times = starts + c * h[:, 0]
        K[stage] = [rate(t, state) for t, state in zip(times.tolist(), states, strict=True)]
    change, first = y_end - y, h * K[0]
    coefficients = np.empty((_POWERS, *y.shape))
    coefficients[0] = change
    coefficients[1] = first - change
    coefficients[2] = 2.0 * change - first - h * K[_STAGES - 1]
    coefficients[3:] = h * np.tensordot(D, K, 1)
    return DenseOutput(starts, ends, y, coefficients)
