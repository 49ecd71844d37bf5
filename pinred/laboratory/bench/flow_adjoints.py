"""Gradients of flows, compared with CasADi's CVODES adjoints of the same equations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from ...common.arrays import Array
from ...integrators.run_derivatives import run_back
from ...kernels.reduced_graph import ReducedGraph
from ...simulation.flow_map.flow import Flow
from .timing import alternating, repeated

_MOST = 1_000_000  # largest number of steps of CVODES
_LONGEST = 3.0  # time limit for all runs of each of the two adjoints [s]


@dataclass(frozen=True)
class Adjoints:
    """Gradients of λ · y at the end with respect to the initial reduced state and parameters.

    Attributes:
        cvodes: Gradient computed by CVODES, (n + p,).
        own: Gradient computed by pinred, (n + p,).
        slower: Ratio of CVODES's time to pinred's, forward run included; the fastest of several
            alternating rounds. NaN if not timed.
    """

    cvodes: Array
    own: Array
    slower: float

    @property
    def error(self) -> float:
        """Largest difference relative to the largest entry of the gradient."""
        return float(np.abs(self.cvodes - self.own).max() / np.abs(self.own).max())


def beside_cvodes(made: Flow, tolerance: float, *, timed: bool = True) -> Adjoints:
    """Compute the gradient of a flow with the adjoints of pinred and of CVODES.

    The flow must use an explicit method over a single segment. The component along each
    quaternion's length is excluded: the flow normalises quaternions, CVODES does not.

    Args:
        made: The flow.
        tolerance: Relative tolerance of CVODES.
        timed: Whether to measure the time of both adjoints.
    Returns:
        Both gradients and the time ratio.
    """
    propagator, kernel = made.propagator, made.propagator.kernel
    run = made.run({})
    (solution,) = run.solutions
    y0, parameters, times = solution.states[0].copy(), solution.params, solution.times
    covector = np.random.default_rng(0).normal(size=len(y0))
    none = np.zeros((len(times), len(y0)))
    first, count = kernel.layout.quaternions
    adjoint = _cvodes(made, tolerance)
    by_cvodes = partial(adjoint, y0, parameters, covector)

    def own() -> Any:
        (now,) = propagator.run(run.given, stages=True).solutions
        return run_back(propagator.method, propagator.field, now, times, covector, none)

    theirs = [np.array(each).ravel() for each in by_cvodes()]
    mine = own()
    for k in range(first, first + 4 * count, 4):
        place = slice(k, k + 4)
        q = y0[place] / np.linalg.norm(y0[place])
        for slopes in (theirs[0], mine.by_state):
            slopes[place] -= q * (q @ slopes[place])
    slower = float("nan")
    if timed:
        slow, fast = np.nanmin(
            alternating([repeated(by_cvodes), repeated(own)], budget=_LONGEST), axis=0
        )
        slower = float(slow / fast)
    own_slopes = np.concatenate([mine.by_state, mine.by_parameters])
    return Adjoints(np.concatenate(theirs), own_slopes, slower)


def _cvodes(made: Flow, tolerance: float) -> Any:
    """Return the function (y₀, parameters, λ) → gradient, computed by CasADi's CVODES."""
    kernel = made.propagator.kernel
    rate = ReducedGraph(kernel.system, kernel.structure, kernel.forces).rate()
    y, p = ca.SX.sym("y", rate.numel_in(0)), ca.SX.sym("p", rate.numel_in(1))
    options = {"reltol": tolerance, "abstol": 1e-2 * tolerance, "max_num_steps": _MOST}
    dae = {"x": y, "p": p, "ode": rate(y, p)}
    whole = ca.integrator("cvodes", "cvodes", dae, 0.0, made.scene.end, options)
    return whole.factory("adjoint", ["x0", "p", "adj:xf"], ["adj:x0", "adj:p"])
