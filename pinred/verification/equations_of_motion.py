"""The equations of motion, judged where the trajectory is: a route's accelerations against ABA.

Both sides are taken at the same states, so that neither how motions part nor the tolerance plays
a part.  What counts is the force that a difference of accelerations stands for, H Δa, row by row
and in parts of what that row's equation is a sum of.  So a light joint counts by its own size, and
a bad condition of H stretches nothing.  Pinocchio's CRBA beside its ABA tells what round-off
leaves of the judge itself.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..reduction.inertia_split import symmetric
from ..simulation.accelerations import accelerations
from ..simulation.trajectory import Trajectory
from ..system.system import System
from .full_state import FullState

_CANCELS = 1e-3  # of the mass times the robot's size squared
_APART = 10.0  # times what two ways to one side leave
_LEAST = 1e-290  # forces that round-off of the smallest numbers would be a part of


def equation_errors(traj: Trajectory, full: FullState, times: Array) -> Array:
    """Return the relative errors (T, n) of the equations of motion at times (T,).

    full: the scene of the system whose motion it is meant to be.
    """
    size = full.radius(traj.system.sorted_q(traj.q[0]))
    found, numbers = accelerations(traj, times, size), traj.motion.numbers(times)
    states, r, leads = found.states, full.system.r, full.ties.leads
    turns = np.ones(full.system.n, dtype=bool)
    turns[: full.system.group.linear] = False
    turns[r:] = [unit == "rad" for unit in full.system.units]
    per_size = np.where(turns, 1.0, 1.0 / size)
    out = np.zeros_like(found.v)
    for k, t in enumerate(times.tolist()):
        full.hold(numbers[k])
        y = full.state(states.pose[k], states.x[k], states.xi[k], states.xdot[k])
        a, other = (
            full.rate(t, y, dense=dense)[len(y) - full.system.model.nv :] for dense in (False, True)
        )
        a, other = (np.append(each[:r], each[r:][leads]) for each in (a, other))
        H, weight, carried = _weights(full.system, full.q(y))
        changes = np.abs(a) + found.pace[k] * np.abs(found.v[k])
        terms = np.abs(H) @ changes + weight
        # The small moment of a body far out is a difference, in both routes.
        terms[turns] += _CANCELS * size**2 * carried[turns] * float(changes @ per_size)
        # Where ABA and CRBA are apart themselves, or two derivatives of the route's velocity,
        # nothing finer can be told.
        known = np.abs(H @ (other - a)) + np.abs(H) @ found.spread[k]
        off = np.abs(H @ (found.a[k] - a)) - _APART * known
        out[k] = np.maximum(off, 0.0) / np.maximum(terms, _LEAST)
    return out


def _weights(system: System, q: Array) -> tuple[Array, Array, Array]:
    """Return the mass matrix (n, n), the size of what gravity does (n,), and the masses (n,).

    Masses are those that each velocity carries with it [kg]; all by Pinocchio.
    """
    model, data, r = system.model, system.data, system.r
    H = system.coupled_matrix(symmetric(pin.crba(model, data, q)))
    behind = [data.Ycrb[i].mass for i in range(2, model.njoints)]
    masses = np.append(np.full(r, data.Ycrb[1].mass), behind)
    weight = np.abs(pin.computeGeneralizedGravity(model, data, q))
    return H, system.sizes_on_shape(weight), system.sizes_on_shape(masses)
