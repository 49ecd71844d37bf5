"""Gradients of flows beside CVODES's adjoints, by CasADi, of the same equations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from ...common.arrays import Array
from ...integrators.derivatives import run_back
from ...kernels.reduced_graph import ReducedGraph
from ...simulation.flow_map.flow import Flow
from .timing import alternating, repeated

_MOST = 1_000_000  # steps
_LONGEST = 3.0  # s for one of both in all


@dataclass(frozen=True)
class Adjoints:
    """The slopes of λ · y at the end by the reduced state at the begin, and by the parameters.

    cvodes, own: (n + p,), the run included.  slower: how many times as long CVODES takes, the least
    of some rounds in which both take turns; NaN if nothing was timed.
    """

    cvodes: Array
    own: Array
    slower: float

    @property
    def error(self) -> float:
        """The largest difference, in parts of the largest slope."""
        return float(np.abs(self.cvodes - self.own).max() / np.abs(self.own).max())


def beside_cvodes(made: Flow, tolerance: float, *, timed: bool = True) -> Adjoints:
    """Return a flow's adjoint and that of CVODES at a relative tolerance.

    The flow is one of an explicit method over a single stretch.  Along the length of a quaternion,
    which is no motion, both differ: the flow brings it to one, CVODES does not; that is left out.
    """
    propagator, kernel = made.propagator, made.propagator.kernel
    run = made.run({})
    (solution,) = run.solutions
    y0, parameters, times = solution.states[0].copy(), solution.params, solution.times
    covector = np.random.default_rng(0).normal(size=len(y0))
    none = np.zeros((len(times), len(y0)))
    quaternion = kernel.layout.quaternion
    adjoint = _cvodes(made, tolerance)
    by_cvodes = partial(adjoint, y0, parameters, covector)

    def own() -> Any:
        (now,) = propagator.run(run.given, stages=True).solutions
        return run_back(
            propagator.method, propagator.address, propagator.slopes, now.params, now, times,
            quaternion, covector, none,
        )  # fmt: skip

    theirs = [np.array(each).ravel() for each in by_cvodes()]
    mine = own()
    if quaternion >= 0:
        place = slice(quaternion, quaternion + 4)
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
    """Return (y₀, parameters, λ) → slopes by both, by CasADi's integrator."""
    kernel = made.propagator.kernel
    rate = ReducedGraph(kernel.system, kernel.structure, kernel.forces).rate()
    y, p = ca.SX.sym("y", rate.numel_in(0)), ca.SX.sym("p", rate.numel_in(1))
    options = {"reltol": tolerance, "abstol": 1e-2 * tolerance, "max_num_steps": _MOST}
    dae = {"x": y, "p": p, "ode": rate(y, p)}
    whole = ca.integrator("cvodes", "cvodes", dae, 0.0, made.scene.end, options)
    return whole.factory("adjoint", ["x0", "p", "adj:xf"], ["adj:x0", "adj:p"])
