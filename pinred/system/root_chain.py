"""Joints at the root with nothing between them: together they are one joint of a group.

A planar joint and a slide along its normal, two slides and a hinge across them, or three slides
and three hinges, each link between without mass.  What such a chain does to the last link is all
that moves the system.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..lie.group import Group
from ..lie.groups import GROUPS, SE3
from .joints import motion_group

_ALONG = 1e-9  # by how much an axis may miss one of the group's
_INDEPENDENT = 1e-6  # singular value of six twists, below which they do not move in all directions


@dataclass(frozen=True)
class RootChain:
    """Joints 1 to `last`, which move what follows in a group.

    at: where the group's root joint is, in the world.  armature: (r,) of the chain, by the
    group's axes.
    """

    group: Group
    last: int
    at: pin.SE3
    armature: Array


def root_chain(raw: pin.Model) -> RootChain | None:
    """Return the chain at the root of a model, or None if there is none, or of no group."""
    last = _end_of_chain(raw)
    if last < 2 or any(motion_group(raw.joints[i]) is None for i in range(1, last + 1)):
        return None
    chain = _alone(raw, last)
    data, rows = chain.createData(), chain.nv
    pin.computeJointJacobians(chain, data, pin.neutral(chain))
    if rows == 6 and np.linalg.matrix_rank(data.J, tol=_INDEPENDENT) == 6:
        return RootChain(SE3, last, data.oMi[last].copy(), raw.armature[:6].copy())
    for frame in range(last, 0, -1):
        at = data.oMi[frame].copy()
        moved = at.toActionMatrixInverse() @ data.J[:, :rows]
        for group in GROUPS.values():
            onto = np.abs(moved[list(group.axes)])
            if group.dim == rows and _is_permutation(onto) and _is_permutation(np.abs(moved)):
                return RootChain(group, last, at, np.rint(onto) @ raw.armature[:rows])
    return None


def places_on_root(raw: pin.Model, chain: RootChain) -> dict[str, pin.SE3]:
    """Return where the bodies of a chain's joints sit on the group's root joint, by the joints."""
    out, along = {}, pin.SE3.Identity()
    for i in range(1, chain.last + 1):
        along = along * raw.jointPlacements[i]
        out[str(raw.names[i])] = chain.at.actInv(along)
    return out


def _alone(raw: pin.Model, last: int) -> pin.Model:
    """Return the first joints of a model without all that hangs on them."""
    chain = pin.Model()
    for i in range(1, last + 1):
        chain.addJoint(i - 1, raw.joints[i], raw.jointPlacements[i], raw.names[i])
    return chain


def _end_of_chain(raw: pin.Model) -> int:
    """Return the last joint of those that hang on an anchor, each alone on a link without mass."""
    last, parents = 0, list(raw.parents)[1:]
    carried: dict[int, list[int]] = {}
    for i, parent in enumerate(parents, start=1):
        carried.setdefault(parent, []).append(i)
    while raw.inertias[last].mass == 0.0 and len(carried.get(last, ())) == 1:
        (last,) = carried[last]
    return last


def _is_permutation(matrix: Array) -> bool:
    """Return whether each column is one axis, and each axis one column at most."""
    whole = np.rint(matrix)
    once = (whole.sum(axis=0) == 1.0).all() and (whole.sum(axis=1) <= 1.0).all()
    return bool(once and np.abs(matrix - whole).max() <= _ALONG)
