"""Coupled joints, which follow others in proportion: x = G y + b.

Every follower joint in a file, directly or through other followers, is ratio · y + offset with
one independent joint y.  The shape consists of the independent joints y alone.  In them the mass
matrix is GᵀHG and forces are Gᵀf, exactly.  Each row of G has one nonzero entry, so G is stored
as the lists `of` and `ratio`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..common.arrays import Array, freeze
from ..common.errors import InputError, ModelError
from ..common.names import listed, quoted
from .robot_file_contents import Coupling

_SAME = 1e-9  # tolerance on the locked value of a follower against its leader's [rad | m]


@dataclass(frozen=True, eq=False)
class Coupled:
    """All M joints of a tree as functions of the m independent ones.  Arrays are read-only.

    Attributes:
        leads: Numbers of the independent joints among all joints, (m,).
        of: Independent joint that each joint follows, (M,), as an index in `leads`.  An
            independent joint follows itself.
        ratio: Ratios, (M,), in x = ratio · y[of] + offset.
        offset: Offsets, (M,) [rad | m].
    """

    leads: NDArray[np.intp]
    of: NDArray[np.intp]
    ratio: Array
    offset: Array

    def __post_init__(self) -> None:
        freeze(self)

    def values(self, y: Array) -> Array:
        """Return the values (..., M) of all joints for those of the independent ones (..., m)."""
        return np.asarray(y[..., self.of] * self.ratio + self.offset)

    def rates(self, v: Array, r: int) -> Array:
        """Return the velocity (..., r + M) of all joints for v (..., r + m)."""
        return np.concatenate([v[..., :r], v[..., r:][..., self.of] * self.ratio], axis=-1)

    def forces(self, f: Array, r: int) -> Array:
        """Return Gᵀf, (..., r + m), for forces (..., r + M)."""
        return self._summed(f, r, self.ratio)

    def sizes(self, f: Array, r: int) -> Array:
        """Return |G|ᵀ|f|, (..., r + m), the magnitude of the terms of Gᵀf, for |f| (..., r + M)."""
        return self._summed(f, r, np.abs(self.ratio))

    def matrix(self, H: Array, r: int) -> Array:
        """Return GᵀHG, (..., r + m, r + m), for a matrix (..., r + M, r + M)."""
        HG = self.forces(np.swapaxes(H, -1, -2), r)
        return self.forces(np.swapaxes(HG, -1, -2), r)

    def _summed(self, f: Array, r: int, ratio: Array) -> Array:
        G = np.zeros((len(self.of), len(self.leads)))
        G[np.arange(len(self.of)), self.of] = ratio
        return np.concatenate([f[..., :r], f[..., r:] @ G], axis=-1)


def coupled(joints: Sequence[str], couplings: Sequence[Coupling], root: str = "") -> Coupled | None:
    """Return all joints as functions of the independent ones, or None without couplings.

    Args:
        joints: Names of all joints behind the root, (M,).
        couplings: Couplings in the file.
        root: Name of the root joint, whose motion is the symmetry.
    Returns:
        The joints.
    Raises:
        ModelError: A leader is unknown, followers form a circle, or a joint follows two others.
            The message names the joints and the way out.
    """
    if not couplings:
        return None
    direct = resolved(couplings, joints, root)
    leads = [j for j, name in enumerate(joints) if name not in direct]
    index = {joints[j]: k for k, j in enumerate(leads)}
    complete = [direct.get(name) or Coupling(name, name, 1.0, 0.0) for name in joints]
    return Coupled(
        leads=np.array(leads, dtype=np.intp),
        of=np.array([index[coupling.leader] for coupling in complete], dtype=np.intp),
        ratio=np.array([coupling.ratio for coupling in complete]),
        offset=np.array([coupling.offset for coupling in complete]),
    )


def resolved(
    couplings: Sequence[Coupling], joints: Sequence[str], root: str = ""
) -> dict[str, Coupling]:
    """Return the coupling of each follower with an independent joint.

    Args:
        couplings: Couplings in the file.
        joints: Names of all joints behind the root.
        root: Name of the root joint.
    Returns:
        {follower: coupling}.
    Raises:
        ModelError: As of `coupled`.
    """
    direct: dict[str, Coupling] = {}
    for coupling in couplings:
        _check(coupling, joints, root)
        if coupling.follower in direct:
            leaders = listed([direct[coupling.follower].leader, coupling.leader])
            raise ModelError(
                f"joint {quoted(coupling.follower)} follows several joints: {leaders}; "
                "leave all of its couplings out but one"
            )
        direct[coupling.follower] = coupling
    return {name: _with_independent(coupling, direct) for name, coupling in direct.items()}


def _check(coupling: Coupling, joints: Sequence[str], root: str) -> None:
    """Refuse a coupling of unknown joints, or with numbers that are not finite."""
    follower, leader = quoted(coupling.follower), quoted(coupling.leader)
    if coupling.follower == root:
        raise ModelError(
            f"the root joint {quoted(root)} follows {leader}, but its motion is the "
            f"symmetry and follows none; lock {leader}, and it is locked with it"
        )
    if coupling.leader not in joints:
        raise ModelError(
            f"joint {follower} follows {leader}, which is not behind the "
            f"root joint {quoted(root)}, whose motion is the symmetry and leads none; "
            f"lock {leader}, and what follows it is locked with it"
        )
    if coupling.follower not in joints:
        raise ModelError(
            f"a coupling makes {follower} follow {leader}, but there is "
            "no such joint that moves about or along one axis"
        )
    if not np.isfinite([coupling.ratio, coupling.offset]).all():
        raise ModelError(
            f"joint {follower} follows {leader} by {coupling.ratio} and "
            f"{coupling.offset}, which are not finite"
        )


def _with_independent(coupling: Coupling, direct: Mapping[str, Coupling]) -> Coupling:
    """Return the coupling of a follower with an independent joint."""
    ratio, offset, leader = coupling.ratio, coupling.offset, coupling.leader
    path = [coupling.follower]
    while leader in direct:
        if leader in path:
            raise ModelError(
                f"joints follow each other in a circle: {listed([*path, leader], len(path) + 1)}; "
                "leave one of the couplings out"
            )
        path.append(leader)
        inner = direct[leader]
        ratio, offset, leader = ratio * inner.ratio, ratio * inner.offset + offset, inner.leader
    return Coupling(coupling.follower, leader, ratio, offset)


def with_followers(
    lock: Mapping[str, float], couplings: Sequence[Coupling], joints: Sequence[str]
) -> tuple[dict[str, float], tuple[Coupling, ...]]:
    """Return locks that include all followers of locked joints, and the remaining couplings.

    A follower whose leader is unknown may be locked.

    Args:
        lock: Values of locked joints [rad | m].
        couplings: Couplings in the file.
        joints: Names of all joints.
    Returns:
        Values of all locked joints, and couplings of joints that move.
    Raises:
        InputError: A follower is locked without its leader, or at another value than it follows.
        ModelError: A leader is unknown, or followers form a circle.
    """
    values = dict(lock)
    active = [c for c in couplings if c.leader in joints or c.follower not in lock]
    unknown = [c for c in active if c.leader not in joints]
    if unknown:
        raise ModelError(
            f"joint {quoted(unknown[0].follower)} follows {quoted(unknown[0].leader)}, which is no "
            "joint that can move; name one that is, or lock the joint: "
            f"lock={[coupling.follower for coupling in unknown]}"
        )
    if not any(name in lock for c in active for name in (c.follower, c.leader)):
        return values, tuple(active)
    remaining: list[Coupling] = []
    direct = resolved(active, joints)
    for coupling in active:
        name, independent = coupling.follower, direct[coupling.follower]
        if independent.leader not in lock:
            if name in lock:
                raise InputError(
                    f"lock: joint '{name}' follows '{independent.leader}' ({independent}); lock "
                    f"'{independent.leader}', and it is locked with it"
                )
            remaining.append(coupling)
            continue
        value = independent.ratio * lock[independent.leader] + independent.offset
        if abs(values.get(name, value) - value) > _SAME:
            raise InputError(
                f"lock: joint '{name}' follows '{independent.leader}', which puts it at "
                f"{value:g}, not {lock[name]:g}; lock '{independent.leader}' alone"
            )
        values[name] = value
    return values, tuple(remaining)


def locked_by(
    lock: Mapping[str, float], couplings: Sequence[Coupling], joints: Sequence[str]
) -> dict[str, Coupling]:
    """Return the couplings of locked joints that follow a locked joint, by follower.

    Args:
        lock: Values of locked joints [rad | m].
        couplings: Couplings in the file.
        joints: Names of all joints.
    """
    active = [c for c in couplings if c.leader in joints and c.follower in joints]
    if not any(c.leader in lock for c in active):
        return {}
    direct = resolved(active, joints)
    return {name: c for name, c in direct.items() if {name, c.leader} <= lock.keys()}


def following(name: str, couplings: Sequence[Coupling]) -> str:
    """Return words on the joint that a joint follows; "" if it follows none."""
    for coupling in couplings:
        if coupling.follower == name:
            return f"joint '{name}' follows '{coupling.leader}' ({coupling})"
    return ""
