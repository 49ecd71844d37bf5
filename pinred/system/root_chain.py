"""Consecutive joints at the root that together are one joint of a group.

Examples are a planar joint and a slide along its normal, two slides and a hinge normal to them,
or three slides and three hinges.  The links between them are massless, so only the motion of the
last link matters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..lie.group import Group
from ..lie.groups import GROUPS, SE3
from .joints import motion_group

_ALONG = 1e-9  # deviation of a unit twist from an axis of the group that counts as round-off
_INDEPENDENT = 1e-6  # least singular value of six twists that move a body in all directions


@dataclass(frozen=True)
class RootChain:
    """Joints at the root that move the bodies behind them in a group.

    Attributes:
        group: Group of the motion.
        last: Index of the last joint; the first is joint 1.
        at: Placement of the group's root joint in the world.
        armature: Armature along the axes of the group, (r,) [kg m² | kg].
    """

    group: Group
    last: int
    at: pin.SE3
    armature: Array


def root_chain(raw: pin.Model) -> RootChain | None:
    """Return the chain at the root of a model, or None if its joints are not one joint."""
    last = _end_of_chain(raw)
    if last < 2 or any(motion_group(raw.joints[i]) is None for i in range(1, last + 1)):
        return None
    chain = pin.Model()
    for i in range(1, last + 1):
        chain.addJoint(i - 1, raw.joints[i], raw.jointPlacements[i], raw.names[i])
    data, nv = chain.createData(), chain.nv
    pin.computeJointJacobians(chain, data, pin.neutral(chain))
    if nv == 6 and np.linalg.matrix_rank(data.J, tol=_INDEPENDENT) == 6:
        return RootChain(SE3, last, data.oMi[last].copy(), raw.armature[:6].copy())
    for joint in range(last, 0, -1):
        at = data.oMi[joint].copy()
        twists = at.toActionMatrixInverse() @ data.J[:, :nv]
        for group in GROUPS.values():
            in_group = np.abs(twists[list(group.axes)])
            if group.dim == nv and _is_permutation(in_group) and _is_permutation(np.abs(twists)):
                return RootChain(group, last, at, np.rint(in_group) @ raw.armature[:nv])
    return None


def places_on_root(raw: pin.Model, chain: RootChain) -> dict[str, pin.SE3]:
    """Return the placements of a chain's bodies on the group's root joint, by joint."""
    places, at = {}, pin.SE3.Identity()
    for i in range(1, chain.last + 1):
        at = at * raw.jointPlacements[i]
        places[str(raw.names[i])] = chain.at.actInv(at)
    return places


def _end_of_chain(raw: pin.Model) -> int:
    """Return the last joint such that each massless link ahead of it carries only one joint."""
    last, parents = 0, list(raw.parents)[1:]
    children: dict[int, list[int]] = {}
    for i, parent in enumerate(parents, start=1):
        children.setdefault(parent, []).append(i)
    while raw.inertias[last].mass == 0.0 and len(children.get(last, ())) == 1:
        (last,) = children[last]
    return last


def _is_permutation(matrix: Array) -> bool:
    """Return whether each column is one axis, and no axis occurs twice."""
    rounded = np.rint(matrix)
    once = (rounded.sum(axis=0) == 1.0).all() and (rounded.sum(axis=1) <= 1.0).all()
    return bool(once and np.abs(matrix - rounded).max() <= _ALONG)
