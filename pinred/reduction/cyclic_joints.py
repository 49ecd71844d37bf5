"""Cyclic joints: those on whose angle neither the inertia nor the potential depends.

Their momentum is constant and their angle a quadrature (Routh): reaction wheels, rotors.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import SymmetryError
from ..system.joints import axes_of
from ..system.scale import radius_of_gyration
from ..system.system import System
from .at_a_shape import PointwiseReduction
from .potential import pivot_weight

_SAMPLES = 3  # random shapes at which a dependence would show
_NO_DEPENDENCE = 1e-12  # of a joint's own kinetic energy at usual rates
_ROUND_OFF = 2e-14  # of what its subtree would have at the end of the robot


def cyclic_joints(
    red: PointwiseReduction, touched: Collection[int] = (), *, pushed: bool = False
) -> tuple[int, ...]:
    """Return the indices of the joints that leave mass matrix and potential unchanged.

    touched: joints that something else acts on, or whose position something depends on.  Where
    gravity turns a pivoted base, its centre of mass must not move with the joint; where gravity
    breaks the symmetry otherwise, there is no potential on the shape, and no joint is cyclic.
    pushed: whether a force acts on the base: momenta are those in the frame of the centre of
    mass, in which it changes that of what moves this along the group.
    """
    system = red.system
    r, m, k = system.r, system.m, system.group.linear
    rng = np.random.default_rng(0)
    depends = np.zeros(m, dtype=bool)
    depends[list(touched)] = True
    data = system.data
    heavy = pivot_weight(system).any()
    for _ in range(_SAMPLES if m else 0):
        at = red.at(rng.uniform(-3.0, 3.0, m))
        q = system.model_q(system.group.identity(), at.x)
        slope = system.on_shape(pin.jacobianCenterOfMass(system.model, data, q))[:, r:]
        unit, none = _nothing(system, data, at.mass_matrix)
        b, s = unit[:r, None], unit[r:, None]
        dIA = np.einsum("ij,jbc->ibc", at.locked_inertia, at.dA)
        for derivative, rates in ((at.dI, b * b.T), (dIA, b * s.T), (at.dM, s * s.T)):
            forces = np.abs(derivative) * rates[:, :, None] * unit[r:]
            depends |= (forces > none).reshape(-1, m).any(axis=0)
        if pushed:
            carried = np.abs(at.mass_matrix[:k, r:]) * unit[:k, None] * unit[r:]
            depends |= (carried > none).any(axis=0)
        weight = float(np.linalg.norm(system.gravity))
        if heavy:
            moved = system.mass * np.abs(slope).max(axis=0)
            depends |= weight * moved * unit[r:] > none + weight * none
            continue
        try:
            pull = np.abs(red.potential_gradient(at.x)) * unit[r:]
            depends |= pull > none + weight * none
        except SymmetryError:
            depends[:] = True
    return tuple(np.flatnonzero(~depends).tolist())


def _nothing(system: System, data: pin.Data, H: Array) -> tuple[Array, Array]:
    """Return usual rates (n,), and the work on each shape joint, (m,), below which it is none.

    Usual rates are 1 rad/s, and what covers the robot in a second.  Work is none below a part
    of the joint's own kinetic energy, not of the robot's: a light joint feels little as much
    as a heavy one feels more.  Round-off is that of the subtree's inertia about the root: near
    it, what is small and light counts too.  data: with the places of the joints.
    """
    model, r = system.model, system.r
    root = data.oMi[1].translation
    ends = np.zeros(model.njoints)  # how far from the root the mass of a subtree is
    for i in range(model.njoints - 1, 0, -1):
        place = data.oMi[i].act(model.inertias[i].lever)
        far = float(np.linalg.norm(place - root)) + radius_of_gyration(model.inertias[i])
        ends[i] = max(ends[i], far, float(np.linalg.norm(data.oMi[i].translation - root)))
        ends[model.parents[i]] = max(ends[model.parents[i]], ends[i])
    reach = float(ends[1]) or 1.0
    unit = np.ones(model.nv)
    for i in range(1, model.njoints):
        joint = model.joints[i]
        slides = ~axes_of(joint)[3:].any(axis=0)
        unit[joint.idx_v : joint.idx_v + joint.nv][slides] = reach
    terms = np.array([data.mass[i] * ends[i] ** 2 for i in range(2, model.njoints)])
    if system.coupled is not None:
        terms = system.sizes_on_shape(np.append(np.zeros(r), terms))[r:]
        unit = np.append(unit[:r], unit[r:][system.coupled.leads])
    own = (np.diag(H) * unit**2)[r:]
    return unit, np.maximum(_NO_DEPENDENCE * own, _ROUND_OFF * terms)


def cyclic_of(system: System, touched: frozenset[int], *, pushed: bool) -> tuple[int, ...]:
    """Return the cyclic joints of a system that are not touched; found once."""
    return system.workspace(
        (cyclic_of, touched, pushed),
        lambda: cyclic_joints(PointwiseReduction(system), touched, pushed=pushed),
    )
