"""Coupled joints: those that follow others in proportion, x = G y + b.

Every joint of a file that follows another, directly or through others, moves as ratio · y + offset
with one independent joint y.  The shape of a system are the independent joints alone: in them the
mass matrix is GᵀHG and forces are Gᵀf, exactly, and nothing is added to what is integrated.
Each row of G has one entry, so that it is kept as two lists and never as a matrix.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from ..common.arrays import Array, freeze
from ..common.errors import InputError, ModelError
from ..common.plain_names import listed, quoted
from .contents import Coupling

_SAME = 1e-9  # rad | m; by how much a lock of a follower may miss where its leader puts it


@dataclass(frozen=True, eq=False)
class Coupled:
    """The joints of a tree as functions of the independent ones; arrays are read-only.

    leads: (m,) where the independent joints stand among all M.  of: (M,) the number of the
    independent joint that each follows; an independent one follows itself.  ratio, offset: (M,)
    x = ratio · y[of] + offset.
    """

    leads: NDArray[np.intp]
    of: NDArray[np.intp]
    ratio: Array
    offset: Array

    def __post_init__(self) -> None:
        freeze(self)

    def values(self, y: Array) -> Array:
        """Return the values of all joints (..., M) at those of the independent ones (..., m)."""
        return np.asarray(y[..., self.of] * self.ratio + self.offset)

    def rates(self, v: Array, r: int) -> Array:
        """Return the velocity (..., r + M) of all joints for v (..., r + m)."""
        return np.concatenate([v[..., :r], v[..., r:][..., self.of] * self.ratio], axis=-1)

    def forces(self, f: Array, r: int) -> Array:
        """Return Gᵀf, (..., r + m), of forces (..., r + M)."""
        return self._summed(f, r, self.ratio)

    def sizes(self, f: Array, r: int) -> Array:
        """Return the magnitude, (..., r + m), of what Gᵀf is a sum of, for |f| (..., r + M)."""
        return self._summed(f, r, np.abs(self.ratio))

    def matrix(self, H: Array, r: int) -> Array:
        """Return GᵀHG, (..., r + m, r + m), of a matrix (..., r + M, r + M)."""
        rows = self.forces(np.swapaxes(H, -1, -2), r)
        return self.forces(np.swapaxes(rows, -1, -2), r)

    def _summed(self, f: Array, r: int, ratio: Array) -> Array:
        onto = np.zeros((len(self.of), len(self.leads)))
        onto[np.arange(len(self.of)), self.of] = ratio
        return np.concatenate([f[..., :r], f[..., r:] @ onto], axis=-1)


def coupled(joints: Sequence[str], couplings: Sequence[Coupling], root: str = "") -> Coupled | None:
    """Return what couplings make of joints, or None if there are no couplings.

    root: the root joint, whose motion is the symmetry.  Raises ModelError, naming the joints and
    the way out, for leaders that are not among the joints, circles, and joints that follow two
    others.
    """
    if not couplings:
        return None
    found = resolved(couplings, joints, root)
    leads = [j for j, name in enumerate(joints) if name not in found]
    number = {joints[j]: k for k, j in enumerate(leads)}
    rows = [found.get(name) or Coupling(name, name, 1.0, 0.0) for name in joints]
    return Coupled(
        leads=np.array(leads, dtype=np.intp),
        of=np.array([number[row.leader] for row in rows], dtype=np.intp),
        ratio=np.array([row.ratio for row in rows]),
        offset=np.array([row.offset for row in rows]),
    )


def resolved(
    couplings: Sequence[Coupling], joints: Sequence[str], root: str = ""
) -> dict[str, Coupling]:
    """Return for each follower how it follows an independent joint, through others or directly.

    Raises ModelError as `coupled`.
    """
    direct: dict[str, Coupling] = {}
    for each in couplings:
        _check(each, joints, root)
        if each.follower in direct:
            others = listed([direct[each.follower].leader, each.leader])
            raise ModelError(
                f"joint {quoted(each.follower)} follows several joints: {others}; "
                "leave all of its couplings out but one"
            )
        direct[each.follower] = each
    return {name: _followed(each, direct) for name, each in direct.items()}


def _check(each: Coupling, joints: Sequence[str], root: str) -> None:
    """Refuse a coupling of joints that are not there, or with numbers that are not finite."""
    if each.follower == root:
        raise ModelError(
            f"the root joint {quoted(root)} follows {quoted(each.leader)}, but its motion is the "
            f"symmetry and follows none; lock {quoted(each.leader)}, and it is locked with it"
        )
    if each.leader not in joints:
        raise ModelError(
            f"joint {quoted(each.follower)} follows {quoted(each.leader)}, which is not behind the "
            f"root joint {quoted(root)}, whose motion is the symmetry and leads none; "
            f"lock {quoted(each.leader)}, and what follows it is locked with it"
        )
    if each.follower not in joints:
        raise ModelError(
            f"a coupling makes {quoted(each.follower)} follow {quoted(each.leader)}, but there is "
            "no such joint that moves about or along one axis"
        )
    if not np.isfinite([each.ratio, each.offset]).all():
        raise ModelError(
            f"joint {quoted(each.follower)} follows {quoted(each.leader)} by {each.ratio} and "
            f"{each.offset}, which are not finite"
        )


def _followed(each: Coupling, direct: Mapping[str, Coupling]) -> Coupling:
    """Return how a joint follows an independent one."""
    ratio, offset, leader = each.ratio, each.offset, each.leader
    seen = [each.follower]
    while leader in direct:
        if leader in seen:
            raise ModelError(
                f"joints follow each other in a circle: {listed([*seen, leader], len(seen) + 1)}; "
                "leave one of the couplings out"
            )
        seen.append(leader)
        before = direct[leader]
        ratio, offset, leader = (
            ratio * before.ratio, ratio * before.offset + offset, before.leader,
        )  # fmt: skip
    return Coupling(each.follower, leader, ratio, offset)


def with_followers(
    lock: Mapping[str, float], couplings: Sequence[Coupling], joints: Sequence[str]
) -> tuple[dict[str, float], tuple[Coupling, ...]]:
    """Return locks with those of all followers of locked joints, and the couplings that are left.

    A follower whose leader is not there is free to be locked.  Raises InputError for another
    follower that is locked without its leader, or elsewhere than where that puts it, and
    ModelError for leaders that are not there, and for circles.
    """
    out = dict(lock)
    known = [each for each in couplings if each.leader in joints or each.follower not in lock]
    lost = [each for each in known if each.leader not in joints]
    if lost:
        raise ModelError(
            f"joint {quoted(lost[0].follower)} follows {quoted(lost[0].leader)}, which is no joint "
            "that can move; name one that is, or lock the joint: "
            f"lock={[each.follower for each in lost]}"
        )
    if not any(name in lock for each in known for name in (each.follower, each.leader)):
        return out, tuple(known)
    left: list[Coupling] = []
    whole = resolved(known, joints)
    for each in known:
        direct = whole[each.follower]
        if direct.leader not in lock:
            if each.follower in lock:
                _refuse_lock(direct)
            left.append(each)
            continue
        value = direct.ratio * lock[direct.leader] + direct.offset
        if abs(out.get(each.follower, value) - value) > _SAME:
            raise InputError(
                f"lock: joint '{each.follower}' follows '{direct.leader}', which puts it at "
                f"{value:g}, not {lock[each.follower]:g}; lock '{direct.leader}' alone"
            )
        out[each.follower] = value
    return out, tuple(left)


def locked_by(
    lock: Mapping[str, float], couplings: Sequence[Coupling], joints: Sequence[str]
) -> dict[str, Coupling]:
    """Return how those of the locked joints that follow a locked one do so, by their names."""
    known = [each for each in couplings if each.leader in joints and each.follower in joints]
    if not any(each.leader in lock for each in known):
        return {}
    whole = resolved(known, joints)
    return {name: each for name, each in whole.items() if {name, each.leader} <= lock.keys()}


def _refuse_lock(each: Coupling) -> NoReturn:
    raise InputError(
        f"lock: joint '{each.follower}' follows '{each.leader}' ({each}); lock '{each.leader}', "
        "and it is locked with it"
    )


def following(name: str, couplings: Sequence[Coupling]) -> str:
    """Return words on whom a joint follows; none if it follows no other."""
    for each in couplings:
        if each.follower == name:
            return f"joint '{name}' follows '{each.leader}' ({each})"
    return ""
