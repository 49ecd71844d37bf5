"""Places of coordinates: of a shape in Pinocchio's q, and of joints that stand in another order."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..lie.group import Group
from .rerooting import rebuild


def in_order(model: pin.Model, order: list[int]) -> dict[str, Any]:
    """Return the model with its joints in an order, and where the entries of q and v go."""
    sorted_model = rebuild(model, {}, order=order)
    place = {i: k for k, i in enumerate(order, start=1)}
    q: list[int] = []
    v: list[int] = []
    for i in range(1, model.njoints):
        joint = sorted_model.joints[place[i]]
        q += range(joint.idx_q, joint.idx_q + joint.nq)
        v += range(joint.idx_v, joint.idx_v + joint.nv)
    return {"model": sorted_model, "_given_q": np.array(q), "_given_v": np.array(v)}


def coordinate_maps(model: pin.Model, group: Group) -> dict[str, NDArray[np.intp]]:
    """Return where (pose, x) stand in q; a joint whose nq exceeds its nv keeps cos and sin."""
    plain = [(k, k) for k in range(group.size)]  # (position in (pose, x), position in q)
    angle: list[tuple[int, int]] = []
    if model.joints[1].nq > group.size:
        angle.append(plain.pop())
    for i in range(2, model.njoints):
        joint = model.joints[i]
        (angle if joint.nq == 2 else plain).append((group.size + i - 2, joint.idx_q))

    def column(pairs: list[tuple[int, int]], k: int) -> NDArray[np.intp]:
        return np.array([pair[k] for pair in pairs], dtype=np.intp)

    return {
        "_plain": column(plain, 0), "_plain_q": column(plain, 1),
        "_angle": column(angle, 0), "_angle_q": column(angle, 1),
    }  # fmt: skip
