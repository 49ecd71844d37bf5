"""Torques of prescribed joints, by inverse dynamics of the reduced system.

Let F be all terms of the Lagrange–Poincaré equations except the torques τ.  The shape equation

    M ẍ + (∂M ẋ) ẋ = F + τ

gives ẍ of the free joints first, because ẍ of the prescribed joints and τ of the free ones are
known.  It then gives τ of the prescribed joints.
"""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array, read_only
from ..forces.acting import ForceInputs
from ..reduction.at_a_shape import PointwiseReduction
from ..reduction.canonical_form import CanonicalForm
from ..reduction.potential import shape_gravity
from ..reduction.textbook_equations import lagrange_poincare
from ..system.system import System
from .plan import Plan
from .sample import Sample


def driving_torques(plan: Plan, t: Array, samples: list[tuple[Sample, Array]]) -> Array:
    """Compute the torques of the prescribed joints.

    Args:
        plan: The plan of the scene.
        t: Times, (T,) [s].
        samples: States that forces depend on, and parameters of the forces, at these times.
    Returns:
        (T, k) [N·m | N], in the order of the prescribed joints.
    """
    system, forces = plan.system, plan.forces
    if forces is None or not plan.acting.driven:
        return read_only(np.zeros((len(t), 0)))
    red = system.workspace(
        (PointwiseReduction, "weightless"), lambda: PointwiseReduction(_weightless(system))
    )
    form = system.workspace(CanonicalForm, lambda: CanonicalForm(system, shape_gravity(system)))
    gravity = shape_gravity(system)
    driven, free = np.array(plan.acting.driven), np.array(plan.acting.free, dtype=np.intp)
    torques = np.empty((len(t), len(driven)))
    for k, (time, (s, numbers)) in enumerate(zip(t, samples, strict=True)):
        acting = forces.acting(ForceInputs(float(time), s.x, s.xdot, s.xi, s.mu, numbers, s.base))
        at = red.at(s.x)
        torque = acting.torque - gravity.gradient(s.x)
        wrench = acting.wrench.copy()
        if s.weight.any():
            torque = torque + s.weight @ form.com_slope(s.x)
            wrench += np.cross(at.com, s.weight)
        omega = s.xi + at.local_connection @ s.xdot
        lp = lagrange_poincare(red, s.x, s.xdot, omega, torque=torque, wrench=wrench)
        force = lp.shape.total - at.dM @ s.xdot @ s.xdot
        M, xddot = at.reduced_metric, np.empty(system.m)
        xddot[driven] = forces.prescribed(float(time), numbers).xddot
        coupling = M[np.ix_(free, driven)] @ xddot[driven]
        xddot[free] = np.linalg.solve(M[np.ix_(free, free)], force[free] - coupling)
        torques[k] = M[driven] @ xddot - force[driven]
    return read_only(torques)


def _weightless(system: System) -> System:
    """Return the system without gravity, which is added as a torque and a wrench instead."""
    model = system.model.copy()
    model.gravity.linear = np.zeros(3)
    return System(model, system.name, contents=system.contents)
