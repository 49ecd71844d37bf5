"""Pinocchio's ABA called from Python, integrated by hand-written methods and by SciPy's.

The methods with fixed steps integrate Pinocchio's (q, v) with pin.integrate. SciPy's methods
integrate the state (root, x, v) of judge/reference_solution.py. The judge's vector field takes ten
times as long as `pin.aba` and would make SciPy's methods look slow. The field here allocates no
array except its result and computes the kinematics of the root with Python floats.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from math import cos, sin

import numpy as np
import pinocchio as pin

from ....common.arrays import Array
from ....judge.full_system import root_motion
from ....lie.group import Group
from ....system.system import System
from ..problems import End, PreparedRun, Problem, Solver, halvings, steps_of
from .full_models import Field, scipy_methods

Floats = Sequence[float]


def full_vector_field(system: System) -> Callable[[float, Array], Array]:
    """Return the vector field (t, y) → dy/dt of a system under gravity alone."""
    model, data = system.model, system.model.createData()
    size, r, first_v = system.group.size, system.r, system.group.size + system.m
    tau = np.zeros(system.n)
    # The judge's rate of a planar root calls numpy, which is slow for single numbers.
    root_rate = _planar_rate if system.group.plane else root_motion(model).rate
    circles = _circles(system)
    has_circles = any(circles)
    aba, empty = pin.aba, np.empty
    buffer = np.empty(model.nq)

    def rate(t: float, y: Array) -> Array:  # noqa: ARG001
        ydot = empty(y.shape)
        v = y[first_v:]
        if has_circles:
            q = buffer
            values: list[float] = []
            for value, circle in zip(y[:first_v].tolist(), circles, strict=True):
                values += (cos(value), sin(value)) if circle else (value,)
            q[:] = values
        else:
            q = y[:first_v]
        ydot[:size] = root_rate(y[:size].tolist(), v[:r].tolist())
        ydot[size:first_v] = v[r:]
        ydot[first_v:] = aba(model, data, q, v, tau)
        return ydot

    return rate


def _circles(system: System) -> list[bool]:
    """Return whether Pinocchio stores each coordinate of (root, x) as cosine and sine."""
    joints = system.model.joints
    root = [False] * system.group.size
    root[-1] = joints[1].nq > system.group.size
    return root + [joints[i].nq == 2 for i in range(2, system.model.njoints)]


def _planar_rate(root: Floats, v: Floats) -> Floats:
    c, s = cos(root[-1]), sin(root[-1])
    *across, x, y, w = v
    return *across, c * x - s * y, s * x + c * y, w


Tangent = Callable[[Array, Array], Array]
Step = Callable[
    [Array, Array], tuple[Array, Array]
]  # functions (q, v) → increment of q in its tangent space, and new v
State = tuple[Array, Array, Array]  # q, x, v
Preparing = Callable[[Problem, float], PreparedRun]


def aba_field(problem: Problem) -> Field:
    """Return the vector field of a problem, evaluated by pin.aba."""
    size, m = problem.system.group.size, problem.system.m

    def end(y: Array, evaluations: float) -> End:
        return End(y[size : size + m], problem.full.q(y), y[size + m :], evaluations)

    return Field(full_vector_field(problem.system), problem.full_start(), end)


def _stepped(scheme: Callable[[Problem, float], Step], stages: int) -> Preparing:
    """Return the `prepare` function of a method with fixed steps."""

    def prepare(problem: Problem, fraction: float) -> PreparedRun:
        count, model, r = steps_of(fraction), problem.system.model, problem.system.r
        step = scheme(problem, problem.start.duration / count)
        start = (problem.q0, problem.start.x, problem.v0)

        def run() -> State:
            q, x, v = start
            with np.errstate(all="ignore"):  # overflow is detected in the final state
                for _ in range(count):
                    u, v = step(q, v)
                    q, x = pin.integrate(model, q, u), x + u[r:]
            return q, x, v

        def end(state: State) -> End:
            q, x, v = state
            return End(x, q, v, float(stages * count))

        return PreparedRun(run, end)

    return prepare


def _euler(problem: Problem, h: float) -> Step:
    """Return the step of semi-implicit Euler, which updates q with the new velocity."""
    model, data, tau = _workspace(problem)

    def step(q: Array, v: Array) -> tuple[Array, Array]:
        v = v + h * pin.aba(model, data, q, v, tau)
        return h * v, v

    return step


def _rk4(problem: Problem, h: float, *, corrected: bool) -> Step:
    """Return the step of the classical Runge–Kutta method on (q, v).

    corrected: apply dexp⁻¹ (Munthe-Kaas). Without it, body velocities of different stages are
    added although they refer to different frames, and the order drops to 2 if the base rotates.
    """
    model, data, tau = _workspace(problem)
    correct = _correction(problem.system.group) if corrected else None
    aba, integrate = pin.aba, pin.integrate

    def step(q: Array, v: Array) -> tuple[Array, Array]:
        a1 = aba(model, data, q, v, tau).copy()
        k1 = v
        u = 0.5 * h * k1
        v2 = v + 0.5 * h * a1
        a2 = aba(model, data, integrate(model, q, u), v2, tau).copy()
        k2 = correct(u, v2) if correct else v2
        u = 0.5 * h * k2
        v3 = v + 0.5 * h * a2
        a3 = aba(model, data, integrate(model, q, u), v3, tau).copy()
        k3 = correct(u, v3) if correct else v3
        u = h * k3
        v4 = v + h * a3
        a4 = aba(model, data, integrate(model, q, u), v4, tau)
        k4 = correct(u, v4) if correct else v4
        h6 = h / 6.0
        return h6 * (k1 + 2.0 * (k2 + k3) + k4), v + h6 * (a1 + 2.0 * (a2 + a3) + a4)

    return step


def _workspace(problem: Problem) -> tuple[pin.Model, pin.Data, Array]:
    model = problem.system.model
    return model, model.createData(), np.zeros(model.nv)


def _planar_bracket(a: Array, b: Array) -> Array:
    bracket = np.zeros(len(a))
    bracket[-3], bracket[-2] = b[-1] * a[-2] - a[-1] * b[-2], a[-1] * b[-3] - b[-1] * a[-3]
    return bracket


def _free_bracket(a: Array, b: Array) -> Array:
    return np.asarray(pin.Motion(a).cross(pin.Motion(b)).vector)


def _dexp_inverse(bracket: Callable[[Array, Array], Array], r: int) -> Tangent:
    """Return (u, v) → du/dt, to fourth order in u, where q = q0 ⊕ u has velocity v.

    Joint motions commute, so only the root (the first r entries) is corrected.
    """

    def correct(u: Array, v: Array) -> Array:
        a, udot = u[:r], v.copy()
        first = bracket(a, v[:r])
        udot[:r] += 0.5 * first + bracket(a, first) / 12.0
        return udot

    return correct


def _correction(group: Group) -> Tangent | None:
    """Return dexp⁻¹ of a group, or None if its motions commute."""
    if group.turns == 3:
        return _dexp_inverse(_free_bracket if group.linear else np.cross, group.dim)
    return _dexp_inverse(_planar_bracket, group.dim) if group.plane else None


_STEPS = halvings(50, 14)

ABA = (
    *(
        Solver(
            f"aba-{name}", f"pin.aba and {text} in Python, equal steps", _STEPS,
            _stepped(scheme, stages), fixed=True,
        )
        for name, text, scheme, stages in (
            ("euler", "semi-implicit Euler", _euler, 1),
            ("rk4", "classical RK4 with pin.integrate", partial(_rk4, corrected=False), 4),
            ("rkmk4", "RK4 of Munthe-Kaas", partial(_rk4, corrected=True), 4),
        )
    ),
    *scipy_methods("aba", "pin.aba", aba_field),
)  # fmt: skip
