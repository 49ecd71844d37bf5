"""The covariant force of a motion in the metric of a connection, and its derivatives.

A motion x(t) of a shape with the Lagrangian ½ ẋᵀMẋ needs the force
f_α = d/dt (M ẋ)_α − ½ ẋᵀ ∂_αM ẋ, which is M times the covariant acceleration.  Where M is the
reduced metric of inertia and nothing else acts, f are the torques of the joints at zero momentum.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from ...common.arrays import Array
from ..evaluate import evaluate
from ..machine.native import NativeCode
from ..validation import require_agreement
from .connection_judge import metric_slopes, shapes_to_judge, who
from .form import ConnectionForm
from .graphs import velocity_graph

_STEP = 1e-3  # of differences of order 6
_DIFFERENCES = 1e-7  # relative


def covariant_graph(form: ConnectionForm) -> ca.Function:
    """Return (x, ẋ, ẍ, λ) → the force f (m,), then the derivative of λᵀf by (x, ẋ, ẍ), (3m,)."""
    m, none = form.m, ca.SX.sym("none")
    motion, along = ca.SX.sym("motion", 3 * m), ca.SX.sym("along", m)
    state, rate = motion[: 2 * m], motion[m:]
    square = velocity_graph(form)(state, none)[-1]
    slope = 0.5 * ca.gradient(square, motion)
    by_rate = slope[m : 2 * m]
    force = ca.jtimes(by_rate, motion, ca.vertcat(rate, ca.SX.zeros(m))) - slope[:m]
    derivative = ca.gradient(ca.dot(along, force), motion)
    out = ca.densify(ca.vertcat(force, derivative))
    return ca.Function("covariant", [ca.vertcat(motion, along), none], [out], {"cse": True})


def judge_covariant(form: ConnectionForm, code: NativeCode) -> None:
    """Compare the force with differences of the reference's metric, its derivatives with its own.

    Raises KernelMismatch.
    """
    m = form.m
    for x, rng in shapes_to_judge(form):
        v, a, along = rng.normal(size=(3, m))
        y = np.concatenate([x, v, a, along])

        def at(y: Array) -> Array:
            return np.asarray(evaluate(code.address, np.zeros(1), y[None], 4 * m)[0])

        M, dM = metric_slopes(form, x)
        found = at(y)
        turning = np.einsum("bcg,g,c->b", dM, v, v) - 0.5 * np.einsum("cda,c,d->a", dM, v, v)
        require_agreement(
            who(form), "the covariant force", found[:m], M @ a + turning, 0.0, _DIFFERENCES
        )
        expected = np.zeros(3 * m)
        for k in range(3 * m):
            for step, weight in ((1, 45.0), (2, -9.0), (3, 1.0)):
                for sign in (1.0, -1.0):
                    moved = y.copy()
                    moved[k] += sign * step * _STEP
                    expected[k] += sign * weight / (60.0 * _STEP) * (along @ at(moved)[:m])
        require_agreement(who(form), "its derivative", found[m:], expected, 0.0, _DIFFERENCES)
