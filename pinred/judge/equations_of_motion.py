"""The equations of motion, judged where the trajectory is: a route's accelerations against ABA.

Both sides are taken at the same states, so that neither how motions part nor the tolerance plays
a part.  What counts is the force that a difference of accelerations stands for, H Δa, row by row
and in parts of what that row's equation is a sum of.  So a light joint counts by its own size, and
a bad condition of H stretches nothing.  Of a body that is small about its joint, the moment is what
is left of its weight of inertia, mass times acceleration times the size of the robot: round-off of
that is no error either.  A second derivative of the route's velocity tells what round-off leaves
of the first, and ABA in the world's axes what it leaves of ABA in those of the bodies: much, where
the mass matrix is almost singular.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.ndimage import maximum_filter1d

from ..common.arrays import Array
from ..reduction.inertia_split import symmetric
from ..simulation.accelerations import accelerations
from ..simulation.trajectory import Trajectory
from ..system.scale import moved_masses
from ..system.system import System
from .full_state import APART, FullState
from .weights import weights

WORLD, BODIES = pin.Convention.WORLD, pin.Convention.LOCAL  # in which ABA may be computed
_LEFT = 1e-5  # of that, beside what the row is a sum of: 1e-12 of it is a part of round-off
_AT_REST = 1e-2  # of the greatest forces of the motion; smaller ones are judged as parts of that
_BESIDE = 5  # times, over which round-off of a plan is measured
_LEAST = 1e-290  # forces that round-off of the smallest numbers would be a part of


def equation_errors(traj: Trajectory, full: FullState, times: Array) -> Array:
    """Return the relative errors (T, n) of the equations of motion at times (T,).

    full: the scene of the system whose motion it is meant to be.
    """
    size = full.radius(traj.system.sorted_q(traj.q[0]))
    found, numbers = accelerations(traj, times, size), traj.motion.numbers(times)
    states, r = found.states, full.system.r
    driven = [r + k for k in traj.plan.acting.driven]
    # By chance two derivatives of a plan may come to the same at one time, but not at all of five.
    spread = maximum_filter1d(found.spread, _BESIDE, axis=0, mode="nearest")
    out, whole, apart = (np.zeros_like(found.v) for _ in range(3))
    for k, t in enumerate(times.tolist()):
        full.hold(numbers[k])
        y = full.state(states.pose[k], states.x[k], states.xi[k], states.xdot[k])
        a, other = (_acceleration(full, t, y, axes) for axes in (BODIES, WORLD))
        H, weight = _weights(full.system, full.q(y))
        changes = np.abs(a) + found.pace[k] * np.abs(found.v[k])
        terms = np.abs(H) @ changes + weight
        terms += _LEFT * _carried(full.system, full.q(y), changes, size)
        # Where two derivatives of the route's velocity are apart themselves, nothing finer can
        # be told.
        off = np.abs(H @ (found.a[k] - a)) - APART * np.abs(H) @ found.spread[k]
        # A drive gives whatever force its plan takes: what counts is whether it follows that.
        own = np.diag(H) * (np.abs(found.a[k] - a) - APART * spread[k])
        off[driven] = own[driven]
        out[k], whole[k], apart[k] = off, terms, np.abs(H @ (a - other))
    # At rest nothing is left of forces but their round-off, which is part of what they are else.
    least = np.maximum(_AT_REST * whole.max(axis=0, initial=0.0), _LEAST)
    whole = np.maximum(whole, least)
    # Two ways may come to the same by chance here, but not all along.
    return np.asarray(
        np.maximum(out / whole - APART * (apart / whole).max(axis=0, initial=0.0), 0.0)
    )


def _acceleration(full: FullState, t: float, y: Array, axes: pin.Convention) -> Array:
    """Return ABA's acceleration (n,) of base and shape, computed in these axes."""
    r, nv = full.system.r, full.system.model.nv
    a = full.rate(t, y, axes)[len(y) - nv :]
    return np.append(a[:r], a[r:][full.ties.leads])


def _weights(system: System, q: Array) -> tuple[Array, Array]:
    """Return the mass matrix (n, n) and the sizes of weights (n,), by Pinocchio."""
    model, data = system.model, system.data
    H = system.coupled_matrix(symmetric(pin.crba(model, data, q)))
    return H, system.sizes_on_shape(weights(model, data, q))


def _carried(system: System, q: Array, changes: Array, size: float) -> Array:
    """Return the largest that forces on the bodies that each joint moves may be, (n,).

    changes: (n,) accelerations.  size: of the robot [m]; forces are times it where joints turn.
    """
    angular, mass = moved_masses(system.model, system.data, q)
    turns = (
        angular
        if system.coupled is None
        else np.append(angular[: system.r], angular[system.r :][system.coupled.leads])
    )
    fastest = size * float(changes[turns].sum()) + float(changes[~turns].sum())
    return system.sizes_on_shape(mass * np.where(angular, size, 1.0)) * fastest
