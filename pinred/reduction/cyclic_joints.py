"""Cyclic joints: hinges and slides on whose value neither the inertia nor the potential depends.

The momentum of a cyclic joint is constant, and its angle follows by quadrature (Routh).  Examples
are reaction wheels and rotors.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import SymmetryError
from ..system.joints import axes_of
from ..system.loops.loop_assembly import loop_rates
from ..system.system import System, radius_of_gyration
from .pointwise_reduction import PointwiseReduction
from .potential import pivot_weight

_SAMPLES = 3  # number of random shapes at which the dependence is checked
_NO_DEPENDENCE = 1e-12  # largest work that counts as zero, relative to the joint's typical energy
_ROUND_OFF = 2e-14  # largest round-off of work, relative to the subtree's inertia about the root


def cyclic_joints(
    red: PointwiseReduction, touched: Collection[int] = (), *, pushed: bool = False
) -> tuple[int, ...]:
    """Find the joints whose angle changes neither the mass matrix nor the potential.

    If gravity rotates a pivoted base, the centre of mass must not move with the joint.  If gravity
    breaks the symmetry otherwise, there is no potential on shape space, and no joint is cyclic.

    Args:
        red: Reduction of the system.
        touched: Joints on which forces act, or whose position enters another quantity.
        pushed: Whether a force acts on the base.  Momenta are then measured in the frame of the
            centre of mass. The momentum of a joint changes if the joint moves this frame along
            the group.
    Returns:
        Indices of the cyclic joints.
    """
    system = red.system
    r, m, k = system.r, system.m, system.group.linear
    rng = np.random.default_rng(0)
    depends = np.zeros(m, dtype=bool)
    depends[[*touched, *system.space.ball_v.tolist()]] = True
    data = system.sorted_data
    heavy = pivot_weight(system).any()
    for _ in range(_SAMPLES if m else 0):
        at = red.at(system.space.random(rng, 3.0))
        q = system.sorted_q(system.group.identity(), at.x)
        com_derivative = system.on_shape(pin.jacobianCenterOfMass(system.sorted_model, data, q))[
            :, r:
        ]
        unit, limit = _usual_rates(system, data, at.mass_matrix)
        b, s = unit[:r, None], unit[r:, None]
        dIA = np.einsum("ij,jbc->ibc", at.locked_inertia, at.dA)
        for derivative, rates in ((at.dI, b * b.T), (dIA, b * s.T), (at.dM, s * s.T)):
            forces = np.abs(derivative) * rates[:, :, None] * unit[r:]
            depends |= (forces > limit).reshape(-1, m).any(axis=0)
        if pushed:
            work = np.abs(at.mass_matrix[:k, r:]) * unit[:k, None] * unit[r:]
            depends |= (work > limit).any(axis=0)
        gravity = float(np.linalg.norm(system.gravity))
        if heavy:
            moment = system.mass * np.abs(com_derivative).max(axis=0)
            depends |= gravity * moment * unit[r:] > limit + gravity * limit
            continue
        try:
            work = np.abs(red.potential_gradient(at.x)) * unit[r:]
            depends |= work > limit + gravity * limit
        except SymmetryError:
            depends[:] = True
    return tuple(np.flatnonzero(~depends).tolist())


def _usual_rates(system: System, data: pin.Data, H: Array) -> tuple[Array, Array]:
    """Return typical rates, (n,), and the largest work per shape joint that counts as zero, (m,).

    A typical rate is 1 rad/s, or a speed that covers the robot's length in a second.  The limit is
    a fraction of the kinetic energy of the joint, not of the robot, so that it suits light and
    heavy joints.  Round-off scales with the subtree's inertia about the root, so that the limit is
    lower for small and light subtrees near the root.  `data` must contain the joint placements.
    """
    model, r = system.sorted_model, system.r
    root = data.oMi[1].translation
    ends = np.zeros(model.njoints)  # greatest distance from the root in each subtree [m]
    for i in range(model.njoints - 1, 0, -1):
        place = data.oMi[i].act(model.inertias[i].lever)
        distance = float(np.linalg.norm(place - root)) + radius_of_gyration(model.inertias[i])
        ends[i] = max(ends[i], distance, float(np.linalg.norm(data.oMi[i].translation - root)))
        ends[model.parents[i]] = max(ends[model.parents[i]], ends[i])
    reach = float(ends[1]) or 1.0
    unit = np.ones(model.nv)
    for i in range(1, model.njoints):
        joint = model.joints[i]
        slides = ~axes_of(joint)[3:].any(axis=0)
        unit[joint.idx_v : joint.idx_v + joint.nv][slides] = reach
    bodies = [i for i in range(2, model.njoints) for _ in range(model.joints[i].nv)]
    terms = np.array([data.mass[i] * ends[i] ** 2 for i in bodies])
    if system.coupled is not None:
        terms = system.sizes_on_shape(np.append(np.zeros(r), terms))[r:]
        unit = np.append(unit[:r], unit[r:][system.coupled.leads])
    energies = (np.diag(H) * unit**2)[r:]
    return unit, np.maximum(_NO_DEPENDENCE * energies, _ROUND_OFF * terms)


def cyclic_of(system: System, touched: frozenset[int], *, pushed: bool) -> tuple[int, ...]:
    """Return the cyclic joints of a system; the result is cached (see `cyclic_joints`).

    The joints of closed loops are not cyclic.
    """
    return system.workspace(
        (cyclic_of, touched, pushed),
        lambda: cyclic_joints(
            PointwiseReduction(system.open_tree()), touched | loop_rates(system), pushed=pushed
        ),
    )
