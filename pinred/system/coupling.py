"""Coupled joints: follower joints whose values are affine in independent joints, x = G y + b.

Every follower in a file equals ratio · y + offset for one independent joint y, perhaps through
other followers.  The shape consists of the independent joints y alone.  In these coordinates the
mass matrix is exactly GᵀHG and forces are Gᵀf.  Each row of G has one nonzero entry, so G is
stored as the arrays `of` (column) and `ratio` (entry).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..common.arrays import Array, FrozenArrays
from ..common.errors import InputError, ModelError
from ..common.names import listed, quoted
from .robot_file_contents import Coupling

_SAME = 1e-9  # tolerance between a follower's locked value and the value of its coupling [rad | m]


@dataclass(frozen=True, eq=False)
class Coupled(FrozenArrays):
    """All M joints of a tree as functions of the m independent joints.  Arrays are read-only.

    Attributes:
        leads: Indices of the independent joints among all joints, (m,).
        of: For each joint, the index in `leads` of the independent joint that it follows, (M,).
            An independent joint follows itself.
        ratio: Ratio of each joint, (M,), in x = ratio · y[of] + offset.
        offset: Offset of each joint, (M,) [rad | m].
    """

    leads: NDArray[np.intp]
    of: NDArray[np.intp]
    ratio: Array
    offset: Array

    def values(self, y: Array) -> Array:
        """Compute the values of all joints, (..., M), from independent joint values y, (..., m)."""
        return np.asarray(y[..., self.of] * self.ratio + self.offset)

    def rates(self, v: Array, r: int) -> Array:
        """Compute velocities of root and all joints, (..., r + M), for v = (ξ, ẏ) (..., r + m)."""
        return np.concatenate([v[..., :r], v[..., r:][..., self.of] * self.ratio], axis=-1)

    def forces(self, f: Array, r: int) -> Array:
        """Project forces f on all joints, (..., r + M), to Gᵀf, (..., r + m)."""
        return self._summed(f, r, self.ratio)

    def sizes(self, f: Array, r: int) -> Array:
        """Return |G|ᵀ|f|, (..., r + m): the size of the terms in Gᵀf, for |f|, (..., r + M)."""
        return self._summed(f, r, np.abs(self.ratio))

    def matrix(self, H: Array, r: int) -> Array:
        """Project a matrix H over all joints, (..., r + M, r + M), to GᵀHG, (..., r + m, r + m)."""
        HG = self.forces(np.swapaxes(H, -1, -2), r)
        return self.forces(np.swapaxes(HG, -1, -2), r)

    def _summed(self, f: Array, r: int, ratio: Array) -> Array:
        G = np.zeros((len(self.of), len(self.leads)))
        G[np.arange(len(self.of)), self.of] = ratio
        return np.concatenate([f[..., :r], f[..., r:] @ G], axis=-1)


def coupled(joints: Sequence[str], couplings: Sequence[Coupling], root: str = "") -> Coupled | None:
    """Return all joints as functions of the independent joints, or None without couplings.

    Args:
        joints: Names of all joints behind the root, (M,).
        couplings: Couplings in the file.
        root: Name of the root joint, whose motion is the symmetry.
    Returns:
        All joints as functions of the independent joints.
    Raises:
        ModelError: A leader is unknown, followers form a cycle, or a joint follows two others.
            The message names the joints and a remedy.
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
    """Rewrite the coupling of each follower so that its leader is an independent joint.

    Args:
        couplings: Couplings in the file.
        joints: Names of all joints behind the root.
        root: Name of the root joint.
    Returns:
        Couplings whose leaders are independent joints, {follower: coupling}.
    Raises:
        ModelError: The couplings are not valid (see `coupled`).
    """
    direct: dict[str, Coupling] = {}
    for coupling in couplings:
        _check(coupling, joints, root)
        if coupling.follower in direct:
            leaders = listed([direct[coupling.follower].leader, coupling.leader])
            raise ModelError(
                f"joint {quoted(coupling.follower)} follows several joints: {leaders}; "
                "remove all of its couplings but one"
            )
        direct[coupling.follower] = coupling
    return {name: _with_independent(coupling, direct) for name, coupling in direct.items()}


def _check(coupling: Coupling, joints: Sequence[str], root: str) -> None:
    """Refuse a coupling whose joints are unknown or whose numbers are not finite."""
    follower, leader = quoted(coupling.follower), quoted(coupling.leader)
    if coupling.follower == root:
        raise ModelError(
            f"the root joint {quoted(root)} follows {leader}, but its motion is the "
            f"symmetry, so it cannot follow a joint. Lock {leader}; the root is then locked, too."
        )
    if coupling.leader not in joints:
        raise ModelError(
            f"joint {follower} follows {leader}, which is not behind the "
            f"root joint {quoted(root)}; the motion of the root is the symmetry, so the root "
            f"cannot lead a joint. Lock {leader}; its followers are then locked, too."
        )
    if coupling.follower not in joints:
        raise ModelError(
            f"a coupling makes {follower} follow {leader}, but no joint {follower} moves about or "
            "along one axis"
        )
    if not np.isfinite([coupling.ratio, coupling.offset]).all():
        raise ModelError(
            f"joint {follower} follows {leader} with ratio {coupling.ratio} and offset "
            f"{coupling.offset}, which must be finite"
        )


def _with_independent(coupling: Coupling, direct: Mapping[str, Coupling]) -> Coupling:
    """Replace the leader of a coupling by the independent joint that the leader follows."""
    ratio, offset, leader = coupling.ratio, coupling.offset, coupling.leader
    path = [coupling.follower]
    while leader in direct:
        if leader in path:
            raise ModelError(
                f"joints follow each other in a circle: {listed([*path, leader], len(path) + 1)}; "
                "remove one of the couplings"
            )
        path.append(leader)
        inner = direct[leader]
        ratio, offset, leader = ratio * inner.ratio, ratio * inner.offset + offset, inner.leader
    return Coupling(coupling.follower, leader, ratio, offset)


def with_followers(
    lock: Mapping[str, float], couplings: Sequence[Coupling], joints: Sequence[str]
) -> tuple[dict[str, float], tuple[Coupling, ...]]:
    """Add the followers of locked joints to the locks; return them and the remaining couplings.

    A follower whose leader is not a joint of the tree may be locked on its own.

    Args:
        lock: Values of locked joints [rad | m].
        couplings: Couplings in the file.
        joints: Names of all joints.
    Returns:
        Values of all locked joints, {joint: value}, and the couplings of joints that move.
    Raises:
        InputError: A follower is locked without its leader, or at a value that violates its
            coupling.
        ModelError: A leader is unknown, or followers form a cycle.
    """
    values = dict(lock)
    active = [c for c in couplings if c.leader in joints or c.follower not in lock]
    unknown = [c for c in active if c.leader not in joints]
    if unknown:
        raise ModelError(
            f"joint {quoted(unknown[0].follower)} follows {quoted(unknown[0].leader)}, which is "
            "not a moving joint; name a moving joint, or lock the follower: "
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
                    f"lock: joint '{name}' follows '{independent.leader}' ({independent}). Lock "
                    f"'{independent.leader}'; its followers are then locked, too."
                )
            remaining.append(coupling)
            continue
        value = independent.ratio * lock[independent.leader] + independent.offset
        if abs(values.get(name, value) - value) > _SAME:
            raise InputError(
                f"lock: joint '{name}' follows '{independent.leader}', which requires "
                f"the value {value:g}, not {lock[name]:g}. Lock only '{independent.leader}'."
            )
        values[name] = value
    return values, tuple(remaining)


def locked_by(
    lock: Mapping[str, float], couplings: Sequence[Coupling], joints: Sequence[str]
) -> dict[str, Coupling]:
    """Return the couplings between locked joints, {follower: coupling}.

    Args:
        lock: Values of locked joints [rad | m].
        couplings: Couplings in the file.
        joints: Names of all joints.
    Returns:
        Couplings whose follower and leader are both locked, by follower.
    """
    active = [c for c in couplings if c.leader in joints and c.follower in joints]
    if not any(c.leader in lock for c in active):
        return {}
    direct = resolved(active, joints)
    return {name: c for name, c in direct.items() if {name, c.leader} <= lock.keys()}


def following(name: str, couplings: Sequence[Coupling]) -> str:
    """Describe the coupling of a follower joint; return "" for an independent joint."""
    for coupling in couplings:
        if coupling.follower == name:
            return f"joint '{name}' follows '{coupling.leader}' ({coupling})"
    return ""
