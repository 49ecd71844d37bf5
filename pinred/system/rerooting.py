"""A model rebuilt joint by joint: with joints frozen, on another root, or in another order.

pin.buildReducedModel and pin.appendModel are not used: the first crashes on models without
joint frames and fails where a link and a joint share a name; the second drops gravity,
armature and limits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from .root_chain import RootChain, places_on_root


@dataclass(frozen=True)
class _Carrier:
    """The joint of the new model that moves an old one's body, and where that body sits on it."""

    joint: int
    placement: pin.SE3


def rebuild(
    raw: pin.Model,
    frozen: Mapping[int, Array],
    root: pin.JointModel | None = None,
    chain: RootChain | None = None,
    order: Sequence[int] = (),
) -> pin.Model:
    """Return a copy of a model without its frozen joints, floating on `root` if one is given.

    frozen: from joint to its fixed configuration (nq of the joint,).  The bodies of
    frozen joints become part of the bodies that carry them.  chain: the joints in whose
    place `root` is.  order: of all joints, parents before children; if empty, the model's own.
    """
    q = pin.neutral(raw)
    model = pin.Model()
    model.name, model.gravity = raw.name, raw.gravity
    base = 0
    if root is not None:
        at = pin.SE3.Identity() if chain is None else chain.at
        base = model.addJoint(0, root, at, _free_name(raw, chain))
        model.addJointFrame(base)
    carriers = {0: _Carrier(base if chain is None else 0, pin.SE3.Identity())}
    model.inertias[base] += raw.inertias[0]
    armature, lower, upper = _free_limits(root)
    if chain is not None:
        armature = [chain.armature]
    on_root = {} if chain is None else places_on_root(raw, chain)
    for i in order or range(1, raw.njoints):
        under, joint = carriers[raw.parents[i]], raw.joints[i]
        at = under.placement * raw.jointPlacements[i]
        if chain is not None and i <= chain.last:
            carrier = _Carrier(base, on_root[str(raw.names[i])])
        elif i in frozen:
            q[joint.idx_q : joint.idx_q + joint.nq] = frozen[i]
            moved = joint.createData()
            joint.calc(moved, q)
            carrier = _Carrier(under.joint, at * moved.M)
        else:
            k = model.addJoint(under.joint, joint, at, raw.names[i])
            carrier = _Carrier(k, pin.SE3.Identity())
            qs, vs = (
                slice(a, a + n) for a, n in ((joint.idx_q, joint.nq), (joint.idx_v, joint.nv))
            )
            armature.append(raw.armature[vs])
            lower.append(raw.lowerPositionLimit[qs])
            upper.append(raw.upperPositionLimit[qs])
        model.appendBodyToJoint(carrier.joint, raw.inertias[i], carrier.placement)
        carriers[i] = carrier
    for j in range(1, raw.nframes):
        frame = raw.frames[j]
        on = carriers[frame.parentJoint]
        model.addFrame(
            pin.Frame(frame.name, on.joint, 0, on.placement * frame.placement, frame.type), False
        )
    model.armature = np.concatenate([np.empty(0), *armature])
    model.lowerPositionLimit = np.concatenate([np.empty(0), *lower])
    model.upperPositionLimit = np.concatenate([np.empty(0), *upper])
    return model


def _free_limits(root: pin.JointModel | None) -> tuple[list[Array], list[Array], list[Array]]:
    """Return the lists of armature and limits, beginning with those of the new root."""
    if root is None:
        return [], [], []
    alone = pin.Model()
    alone.addJoint(0, root, pin.SE3.Identity(), "root")
    nq, nv = alone.nq, alone.nv
    return [np.zeros(nv)], [np.full(nq, -np.inf)], [np.full(nq, np.inf)]


def _free_name(raw: pin.Model, chain: RootChain | None) -> str:
    name = "root_joint" if chain is None else "+".join(list(raw.names)[1 : chain.last + 1])
    while raw.existJointName(name) or raw.existFrame(name):
        name = f"{name}_"
    return name


def depth_first(parents: Sequence[int]) -> list[int]:
    """Return joints 1, 2, … so that each is followed by all that hang on it.

    Pinocchio's algorithms need that order: its crba is silently wrong in any other.
    parents: of all joints, that of the world at index 0 not read.
    """
    children: list[list[int]] = [[] for _ in parents]
    for i in range(len(parents) - 1, 0, -1):
        children[parents[i]].append(i)
    order, ahead = [], children[0]
    while ahead:
        i = ahead.pop()
        order.append(i)
        ahead += children[i]
    return order
