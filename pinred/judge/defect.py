"""Backward error: by how much a trajectory misses Pinocchio's equations of motion.

Over a step from a to b, y(b) − y(a) − ∫ f(t, y(t)) dt, where y is the full state that the
trajectory reports, f is Pinocchio's ABA on it, and the integral is Gauss's of 8 points on each
half.  A trajectory with a small defect is the exact one of a system that is pushed a little:
that is what an integrator can promise where nearby motions part, and it needs no reference.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..common.arrays import Array
from ..simulation.trajectory import Trajectory
from ..system.coordinates import Indices
from ..system.system import System
from .full_state import APART, OFFSET, FullState

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
# The mean over a part of ∫ f from its begin, ½ ∫ (1 − s) f ds.
_MEANS = 0.5 * _WEIGHTS * (1.0 - _NODES)
_MOST_STEPS = 200  # beyond these a random choice is judged
_SLOPE = 1e-6  # of the sizes of numbers, over which a slope is measured
_STANDS_OUT = 10.0  # times the median step: it holds a kink of a force


def defect(
    traj: Trajectory, system: System, *, steps: int = _MOST_STEPS, inside: bool = False
) -> float:
    """Return the largest defect of a step, relative to the size of each kind of number.

    system: whose motion it is meant to be.  steps: how many are judged, at most.  inside: judge
    parts of steps, and so what is reported between their ends, too.  The numbers are the
    root's coordinates, joint coordinates, and the velocities of both.
    """
    full = FullState(replace(traj.scene, system=system))
    found = defects(traj, full, steps=steps, led=False)
    return float(found.inside.max(initial=0.0)) if inside else found.worst


@dataclass(frozen=True)
class Defects:
    """Defects of the steps that are judged, (S,), and of parts of them, (P,), relative.

    Those of parts show what is reported between the ends of steps.  smooth: (S,) where the
    equations are smooth within the step; a kink of a force is more than a method can follow.
    The tolerance holds for rates in parts of what the absolute one is to the relative one; of a
    motion that is slower than that, carried and carried_inside, (S,) and (P,), are the same in
    parts of its own rates, as growth is measured: a small rate goes far in a long time.  Of a
    step, carried counts where what is missed inside it leads to, even if that adds up to nothing.
    blurred: by how much of these ABA itself is off in a second, by round-off [1/s].
    """

    steps: Array
    inside: Array
    smooth: NDArray[np.bool_]
    carried: Array
    carried_inside: Array
    blurred: float

    @property
    def worst(self) -> float:
        """Return the largest of a step that is smooth; NaN if there is one."""
        return float(self.steps[self.smooth].max(initial=0.0))


@dataclass(frozen=True)
class _Course:
    """Parts of steps (P,), and the nodes of their quadrature (8 P,) with states and ABA's rates.

    missed: (P, n) over each part.  mean: (P, n) of what is missed from its begin.
    """

    nodes: Array
    numbers: list[Array]
    y: Array
    rates: Array
    missed: Array
    mean: Array
    lengths: Array


def defects(
    traj: Trajectory, full: FullState, *, steps: int = _MOST_STEPS, led: bool = True
) -> Defects:
    """Return the defects of a trajectory by ABA; see `defect`.

    led: find out where they lead in a step, too; without that, carried tells nothing of it.
    """
    count = len(traj.motion.knots) - 1
    which = np.arange(count)
    if count > steps:
        which = np.sort(np.random.default_rng(0).choice(which, steps, replace=False))
    found = _defects(traj, full, which, led=led)
    forces = traj.scene.force_model
    if forces is None or not forces.has_kinks:
        return found
    # Over a kink of a force a step is far worse than its neighbours, whatever its length.
    usual = _STANDS_OUT * float(np.median(found.steps))
    return replace(found, smooth=~(found.steps > usual))


def _defects(traj: Trajectory, full: FullState, which: Indices, *, led: bool) -> Defects:
    """Return the defects of some steps."""
    a, b, first = _stretches(traj, which)
    middle, half = 0.5 * (a + b), 0.5 * (b - a)
    nodes = (middle[:, None] + half[:, None] * _NODES).ravel()
    y = full_states(traj, full, np.concatenate([a, b, nodes]))
    start, end, between = np.split(y, [len(a), 2 * len(a)])
    numbers = traj.motion.numbers(nodes)
    rates, apart = np.empty_like(between), np.zeros(between.shape[1])
    for k, t in enumerate(nodes.tolist()):
        full.hold(numbers[k])
        rates[k] = full.rate(t, between[k])
        if k % len(_NODES) == 0:  # one of each stretch tells enough of round-off
            other = full.rate(t, between[k], pin.Convention.WORLD)
            apart = np.maximum(apart, np.abs(rates[k] - other))
    parts = (len(a), len(_NODES), -1)
    moved = half[:, None] * np.einsum("k,skn->sn", _WEIGHTS, rates.reshape(parts))
    until = half[:, None] * np.einsum("k,skn->sn", _MEANS, rates.reshape(parts))
    missed = end - start - moved
    mean = 0.5 * np.einsum("k,skn->sn", _WEIGHTS, between.reshape(parts)) - start - until
    course = _Course(nodes, numbers, between, rates, missed, mean, b - a)
    sizes, own = _sizes(traj, full)
    whole = np.add.reduceat(missed, first)  # ends of parts within a step cancel
    ends = _led(full, course, first, sizes) if led else whole
    # What round-off leaves of ABA, where the mass matrix is almost singular, is no defect.
    noise, steps = APART * apart, np.add.reduceat(b - a, first)
    whole, ends, missed = (
        np.maximum(np.abs(part) - np.outer(time, noise), 0.0)
        for part, time in ((whole, steps), (ends, steps), (missed, b - a))
    )
    return Defects(
        steps=(whole / sizes).max(axis=1),
        inside=(missed / sizes).max(axis=1),
        smooth=np.ones(len(which), dtype=bool),
        carried=(np.maximum(whole, ends) / own).max(axis=1),
        carried_inside=(missed / own).max(axis=1),
        blurred=float((apart / own).max()),
    )


def _led(full: FullState, course: _Course, first: Indices, sizes: Array) -> Array:
    """Return by how much the ends of steps are off, (S, n), by what was missed before in each.

    Of linear equations the parts of what is missed may cancel, though the step ends elsewhere:
    interpolants are such that they do.  So what is missed until a time leads on from there, by the
    slope of ABA in the middle of each part: e = D + z, where z' = J (D + z).
    """
    off = np.zeros_like(course.missed)
    begins = np.isin(np.arange(len(off)), first)
    for part in range(len(off)):
        before = np.zeros_like(off[part]) if begins[part] else off[part - 1]
        led = before + course.mean[part]
        led += 0.5 * _slope(full, course, part, led, sizes)
        off[part] = before + course.missed[part] + _slope(full, course, part, led, sizes)
    return np.asarray(off[np.append(first[1:], len(off)) - 1])


def _slope(full: FullState, course: _Course, part: int, off: Array, sizes: Array) -> Array:
    """Return what a state that is off by so much, (n,), leads to over a part."""
    unit = float(np.abs(off / sizes).max()) / _SLOPE
    if not 0.0 < unit < np.inf:
        return np.zeros_like(off)
    k = part * len(_NODES) + len(_NODES) // 2
    full.hold(course.numbers[k])
    rate = full.rate(course.nodes[k], course.y[k] + off / unit)
    return np.asarray(course.lengths[part] * unit * (rate - course.rates[k]))


def _stretches(traj: Trajectory, which: Indices) -> tuple[Array, Array, Indices]:
    """Return starts and ends of parts of steps, (P,), and which are the first of a step.

    Halves of steps, or less where the base turns fast: the quadrature is then exact.
    """
    knots = traj.motion.knots
    linear = traj.system.group.linear
    steps = np.diff(knots)
    turn = np.abs(traj(knots).xi[:, linear:]).max(initial=0.0) * steps[which]
    parts = np.ceil(np.maximum(turn, 2.0)).astype(int)
    share = np.concatenate([np.arange(n) for n in parts]) / np.repeat(parts, parts)
    later = np.concatenate([np.arange(1, n + 1) for n in parts]) / np.repeat(parts, parts)
    start, end = np.repeat(knots[which], parts), np.repeat(knots[which + 1], parts)
    # The ends of the steps themselves, to the last bit: no state is known after the last.
    a, b = start + share * (end - start), np.where(later < 1.0, start + later * (end - start), end)
    return a, b, np.concatenate([[0], np.cumsum(parts)[:-1]])


def full_states(traj: Trajectory, full: FullState, times: Array) -> Array:
    """Return the states that a trajectory reports at times (T,) as FullState has them."""
    state = traj(times)
    rows = zip(state.pose, state.x, state.xi, state.xdot, strict=True)
    return np.array([full.state(*row) for row in rows])


def _sizes(traj: Trajectory, full: FullState) -> tuple[Array, Array]:
    """Return the largest number of each kind at the ends of steps, in every place, (n,) twice.

    Angles and quaternions count as 1 at least, lengths as the radius of gyration.  Of places, the
    distance travelled counts, and that from the origin where its round-off does.  Rates count as
    what the absolute tolerance is to the relative one at least; the second time, as what
    leads through an angle of 1 by the end, each joint by its own.  The base's turns are no
    numbers that grow as it turns: of its spin that of the start counts, as of the kick whose
    growth is measured.
    """
    y = full_states(traj, full, traj.motion.knots)
    group, m, r = traj.system.group, full.joints, traj.system.r
    linear, size = group.linear, group.size
    radius = full.radius(full.q(y[0]))
    out, least = np.empty((2, y.shape[1])), np.zeros((2, y.shape[1]))
    least[:, :linear], least[:, linear : size + m] = radius, 1.0
    slow = np.array([traj.scene.atol / traj.scene.rtol, 1.0 / traj.scene.end])
    least[:, size + m :] = np.minimum(slow, slow[0])[:, None]
    least[:, size + m : size + m + linear] *= radius
    edges = [0, linear, size, size + m, size + m + linear, size + m + r, y.shape[1]]
    for first, last in pairwise(edges):
        if last > first:
            kind = y[:, first:last]
            if first == 0 and linear:
                offset = OFFSET * np.abs(kind).max()
                kind = np.append(np.abs(kind - kind[0]).ravel(), offset)
            out[:, first:last] = np.maximum(np.abs(kind).max(), least[:, first, None])
    joints, turns = slice(size + m + r, None), slice(size + m + linear, size + m + r)
    out[1, joints] = np.maximum(np.abs(y[:, joints]).max(axis=0), least[1, joints])
    began = np.abs(y[0, turns]).max(initial=0.0)
    out[1, turns] = np.minimum(out[1, turns], np.maximum(began, least[1, turns]))
    sizes, own = np.where(out > 0.0, out, 1.0)
    return sizes, own
