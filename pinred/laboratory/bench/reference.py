"""Reference solution for the final state of a problem, with an estimate of its error.

With heyoka, Taylor's method solves pinred's reduced equations in quadruple precision. To estimate
the error, it runs at two tolerances, and from an initial state that differs by round-off. Without
heyoka, Hairer's DOP853 solves the equations of the full state. In both cases the result is compared
with Pinocchio's ABA on the full state.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.errors import IntegrationError
from ...judge.distances import FullMotion
from ...judge.reference_solution import FINEST
from .peers.heyoka import has_heyoka, reduced_graph, taylor_expressions
from .problems import Problem

_QUAD = (1e-23, 1e-20)  # tolerances in quadruple precision
_EPS = float(np.finfo(float).eps)
CONFIRMED = 1e-9  # distance from ABA above which it counts as the error of the reference [rad | m]


@checks_arguments
@dataclass(frozen=True)
class Reference:
    """The final state of a problem.

    Attributes:
        end: The final state.
        error: Estimated error [rad | m]; smaller errors of methods cannot be resolved.
        independent: Distance from Pinocchio's ABA under DOP853 in double precision [rad | m].
        about: Description of the computation.
    """

    end: FullMotion
    error: float
    independent: float
    about: str


@checks_arguments
def reference_of(problem: Problem) -> Reference:
    """Compute the final state of a problem.

    Args:
        problem: The problem.
    Returns:
        The reference.
    Raises:
        IntegrationError: The motion cannot be integrated at the tightest tolerance.
    """
    y0, times = problem.full_start(), problem.times
    aba = problem.full.run(y0, times, *FINEST)
    if has_heyoka():
        return _quadruple(problem, aba)
    second = problem.full.run(y0, times, *FINEST, method="dopri5")
    error = problem.apart(aba, second)
    return Reference(
        aba, error, error, f"ABA on the full state, by DOP853 and DOPRI5 at {FINEST[0]:g}"
    )


def _quadruple(problem: Problem, aba: FullMotion) -> Reference:
    hy = import_module("heyoka")
    flow, duration = problem.flow, problem.start.duration
    expressions = taylor_expressions(reduced_graph(problem), flow.parameters.tolist())

    def end(y: Any) -> FullMotion:
        return problem.end(np.array([float(value) for value in y])).motion

    def integrator(tolerance: float) -> Any:
        y0 = [hy.real128(value) for value in flow.y0.tolist()]
        return hy.taylor_adaptive(
            expressions, y0, tol=hy.real128(tolerance), compact_mode=True, fp_type=hy.real128
        )

    def propagate(ta: Any, y0: Array) -> Any:
        ta.time = hy.real128(0.0)
        ta.state[:] = [hy.real128(value) for value in y0.tolist()]
        outcome, *_ = ta.propagate_until(hy.real128(duration))
        if outcome.name != "time_limit":
            raise IntegrationError(f"heyoka stopped with {outcome.name} at t = {float(ta.time):g}")
        return np.array(ta.state)

    if not flow.y0.size:  # a single body in pure translation has no reduced state
        return Reference(aba, _EPS, 0.0, "closed form")
    ends = [propagate(integrator(_QUAD[0]), flow.y0)]
    coarse = integrator(_QUAD[1])
    ends.append(propagate(coarse, flow.y0))
    rng = np.random.default_rng(0)
    perturbed = propagate(coarse, flow.y0 * (1.0 + _EPS * rng.choice([-1.0, 1.0], flow.y0.size)))
    converged = max(float(abs(a - b)) for a, b in zip(*ends, strict=True))
    truth = end(ends[0])
    # Even an exact integration has the round-off of the initial momenta and of the final state.
    rounding = max(problem.apart(truth, end(perturbed)), 4.0 * _EPS)
    independent = problem.apart(truth, aba)
    error = max(converged, rounding)
    about = (
        f"heyoka in quadruple precision (converged to {converged:.0e}; round-off of the initial "
        f"values changes it by {rounding:.0e}); ABA on the full state in double precision is "
        f"{independent:.0e} away"
    )
    return Reference(truth, error if independent < CONFIRMED else independent, independent, about)
