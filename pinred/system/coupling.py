"""Coupled joints: follower joints whose values are affine in independent joints, x = G y + b.

Every follower in a file is an affine function of independent joints y, perhaps through other
followers.  The shape consists of the independent joints y alone.  In these coordinates the mass
matrix is exactly GᵀHG and forces are Gᵀf.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..common.arrays import Array, FrozenArrays
from ..common.errors import InputError, ModelError
from ..common.names import listed, nearest, quoted
from .coordinates import ShapeSpace, shape_space
from .locked_joints import Tie
from .robot_file_contents import Coupling

_SAME = 1e-9  # tolerance between a follower's locked value and the value of its coupling [rad | m]


@dataclass(frozen=True, eq=False)
class Coupled(FrozenArrays):
    """All joints of a tree as functions of the independent joints.  Arrays are read-only.

    M is the number of rates of all joints except the root.  Coordinates and rates differ in number
    only if the tree has balls, which neither follow nor lead.

    Attributes:
        space: Manifold of the independent joints.
        leads: Indices of the independent rates among all rates, (m,).
        leads_x: Indices of the independent coordinates among all coordinates, (nx,).
        G: Matrix of the rates, ẋ = G ẏ, (M, m).  The row of an independent rate is a unit vector.
        G_x: Matrix of the coordinates, x = G_x y + b; equal to G without balls.
        offset: Offset b of each coordinate [rad | m].
    """

    space: ShapeSpace
    leads: NDArray[np.intp]
    leads_x: NDArray[np.intp]
    G: Array
    G_x: Array
    offset: Array

    def terms(self, rate: int) -> list[tuple[int, float]]:
        """Return the nonzero entries of a row of G, [(index of the independent rate, ratio)]."""
        return _terms(self.G[rate])

    def value_terms(self, coordinate: int) -> list[tuple[int, float]]:
        """Return the nonzero entries of a row of G_x, like `terms`."""
        return _terms(self.G_x[coordinate])

    def values(self, y: Array) -> Array:
        """Compute the coordinates of all joints from independent coordinates y, (..., nx)."""
        return np.asarray(y @ self.G_x.T + self.offset)

    def rates(self, v: Array, r: int) -> Array:
        """Compute velocities of root and all joints, (..., r + M), for v = (ξ, ẏ) (..., r + m)."""
        return np.concatenate([v[..., :r], v[..., r:] @ self.G.T], axis=-1)

    def forces(self, f: Array, r: int) -> Array:
        """Project forces f on all joints, (..., r + M), to Gᵀf, (..., r + m)."""
        return np.concatenate([f[..., :r], f[..., r:] @ self.G], axis=-1)

    def sizes(self, f: Array, r: int) -> Array:
        """Return |G|ᵀ|f|, (..., r + m): the size of the terms in Gᵀf, for |f|, (..., r + M)."""
        return np.concatenate([f[..., :r], f[..., r:] @ np.abs(self.G)], axis=-1)

    def matrix(self, H: Array, r: int) -> Array:
        """Project a matrix H over all joints, (..., r + M, r + M), to GᵀHG, (..., r + m, r + m)."""
        HG = self.forces(np.swapaxes(H, -1, -2), r)
        return self.forces(np.swapaxes(HG, -1, -2), r)


def _terms(row: Array) -> list[tuple[int, float]]:
    return [(k, float(row[k])) for k in np.flatnonzero(row).tolist()]


def coupled(tree: ShapeSpace, couplings: Sequence[Coupling], root: str = "") -> Coupled | None:
    """Return all joints as functions of the independent joints, or None without couplings.

    Args:
        tree: Manifold of all joints except the root.
        couplings: Couplings in the file.
        root: Name of the root joint, whose motion is the symmetry.
    Returns:
        All joints as functions of the independent joints.
    Raises:
        ModelError: A leader is unknown, followers form a cycle, or a joint has two couplings.
            The message names the joints and a remedy.
    """
    if not couplings:
        return None
    scalars = {joint.name: joint for joint in tree.joints if not joint.kind.is_ball}
    direct = resolved(couplings, list(scalars), root)
    joints = [joint for joint in tree.joints if joint.name not in direct]
    space = shape_space([joint.name for joint in joints], [joint.kind for joint in joints])
    placed = {joint.name: joint for joint in space.joints}
    G, G_x, offset = np.zeros((tree.m, space.m)), np.zeros((tree.nx, space.nx)), np.zeros(tree.nx)
    for joint in joints:
        lead = placed[joint.name]
        G[joint.v, lead.v], G_x[joint.x, lead.x] = np.eye(joint.kind.m), np.eye(joint.kind.nx)
    for name, coupling in direct.items():
        follower = scalars[name]
        offset[follower.x] = coupling.offset
        for leader, ratio in coupling.ratios.items():
            G[follower.v, placed[leader].v] = G_x[follower.x, placed[leader].x] = ratio
    return Coupled(
        space=space,
        leads=_indices([joint.v for joint in joints]),
        leads_x=_indices([joint.x for joint in joints]),
        G=G,
        G_x=G_x if space.balls else G,
        offset=offset,
    )


def _indices(slices: Sequence[slice]) -> NDArray[np.intp]:
    return np.array([k for s in slices for k in range(s.start, s.stop)], dtype=np.intp)


def resolved(
    couplings: Sequence[Coupling], joints: Sequence[str], root: str = ""
) -> dict[str, Coupling]:
    """Rewrite the coupling of each follower so that its leader is an independent joint.

    Args:
        couplings: Couplings in the file.
        joints: Names of all joints except the root.
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
            leaders = listed([*direct[coupling.follower].leaders, *coupling.leaders])
            raise ModelError(
                f"joint {quoted(coupling.follower)} follows several joints: {leaders}; "
                "remove all of its couplings but one"
            )
        direct[coupling.follower] = coupling
    independent: dict[str, Coupling] = {}
    while direct:
        ready = [name for name, c in direct.items() if direct.keys().isdisjoint(c.ratios)]
        if not ready:
            circle = " follows ".join(f"joint {quoted(name)}" for name in _circle(direct))
            raise ModelError(
                f"{circle} in a cycle; remove one of these couplings, or lock these joints"
            )
        for name in ready:
            independent[name] = _with_independent(direct.pop(name), independent)
    return independent


def _check(coupling: Coupling, joints: Sequence[str], root: str) -> None:
    """Reject a coupling whose joints are unknown or whose numbers are not finite."""
    follower, leaders = quoted(coupling.follower), _names(coupling.leaders)
    unknown = [leader for leader in coupling.leaders if leader not in joints]
    if coupling.follower == root:
        raise ModelError(
            f"the root joint {quoted(root)} follows {leaders}, but its motion is the "
            f"symmetry, so it cannot follow a joint. Lock {leaders}; the root is then locked, too."
        )
    if unknown and unknown[0] in (root, *root.split("+")):
        raise ModelError(
            f"joint {follower} follows {quoted(unknown[0])}, which is not behind the "
            f"root joint {quoted(root)}; the motion of the root is the symmetry, so the root "
            f"cannot lead a joint. Lock {quoted(unknown[0])}; its followers are then locked, too."
        )
    for name in (*unknown, coupling.follower):
        if name not in joints:
            raise ModelError(
                f"joint {follower} follows {leaders}, but joint {quoted(name)} does not move about "
                "or along one axis; make it revolute or prismatic, or remove the coupling"
            )
    if not np.isfinite([*coupling.ratios.values(), coupling.offset]).all():
        raise ModelError(
            f"joint {follower} follows {leaders} with ratios {[*coupling.ratios.values()]} and "
            f"offset {coupling.offset}; state finite numbers"
        )


def _circle(direct: Mapping[str, Coupling]) -> list[str]:
    """Return joints that follow each other in a cycle; each coupling has a leader that follows."""
    path = [next(iter(direct))]
    while path[-1] not in path[:-1]:
        path.append(next(leader for leader in direct[path[-1]].leaders if leader in direct))
    return path[path.index(path[-1]) :]


def _with_independent(coupling: Coupling, independent: Mapping[str, Coupling]) -> Coupling:
    """Replace the leaders of a coupling by the independent joints that they follow."""
    ratios, offset = dict[str, float](), coupling.offset
    for leader, ratio in coupling.ratios.items():
        inner = independent.get(leader, Coupling(leader, {leader: 1.0}, 0.0))
        offset = ratio * inner.offset + offset
        for name, factor in inner.ratios.items():
            ratios[name] = ratios.get(name, 0.0) + ratio * factor
    return Coupling(coupling.follower, ratios, offset)


def _names(joints: Iterable[str]) -> str:
    """Return names in words, each in quotation marks."""
    return " and ".join(map(quoted, joints))


def with_followers(
    lock: Mapping[str, float], couplings: Sequence[Coupling], joints: Sequence[str]
) -> tuple[dict[str, float], tuple[Coupling, ...]]:
    """Return the locked joints with their followers added, and the couplings of all other joints.

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
    active = [c for c in couplings if set(c.leaders) <= set(joints) or c.follower not in lock]
    unknown = [(c.follower, leader) for c in active for leader in c.leaders if leader not in joints]
    if unknown:
        follower, leader = unknown[0]
        raise ModelError(
            f"joint {quoted(follower)} follows {quoted(leader)}, which is "
            f"not a moving joint; {nearest(leader, joints)}name a moving joint, or lock the "
            "follower: "
            f"lock={[name for name, _ in unknown]}"
        )
    if not any(name in lock for c in active for name in (c.follower, *c.leaders)):
        return values, tuple(active)
    remaining: list[Coupling] = []
    direct = resolved(active, joints)
    for coupling in active:
        name, independent = coupling.follower, direct[coupling.follower]
        leaders = _names(independent.leaders)
        if not set(independent.leaders) <= lock.keys():
            if name in lock:
                raise InputError(
                    f"lock: joint '{name}' follows {leaders} ({independent}). Lock "
                    f"{leaders}; the followers are then locked, too."
                )
            in_part = not lock.keys().isdisjoint(independent.ratios)
            remaining.append(with_constants(independent, lock) if in_part else coupling)
            continue
        value = with_constants(independent, lock).offset
        if abs(values.get(name, value) - value) > _SAME:
            raise InputError(
                f"lock: joint '{name}' follows {leaders}, which requires "
                f"the value {value:g}, not {lock[name]:g}. Lock only {leaders}."
            )
        values[name] = value
    return values, tuple(remaining)


def with_constants(coupling: Coupling, values: Mapping[str, float]) -> Coupling:
    """Replace the leaders that are locked by their values."""
    ratios = {name: ratio for name, ratio in coupling.ratios.items() if name not in values}
    constant = {name: ratio for name, ratio in coupling.ratios.items() if name in values}
    offset = sum(ratio * values[name] for name, ratio in constant.items()) + coupling.offset
    return Coupling(coupling.follower, ratios, offset)


def ties_of(
    lock: Mapping[str, float], couplings: Sequence[Coupling], joints: Sequence[str]
) -> tuple[dict[str, Tie], tuple[str, ...]]:
    """Return the dependence of locked followers on locked leaders.

    Args:
        lock: Values of locked joints [rad | m].
        couplings: Couplings in the file.
        joints: Names of all joints.
    Returns:
        Ties of followers to single leaders, {follower: tie}; and the locked joints in couplings
        with several leaders.
    """
    active = [c for c in couplings if {c.follower, *c.leaders} <= set(joints)]
    if not any(leader in lock for c in active for leader in c.leaders):
        return {}, ()
    ties: dict[str, Tie] = {}
    shared: list[str] = []
    for name, coupling in resolved(active, joints).items():
        if len(coupling.ratios) > 1:
            shared += [joint for joint in (name, *coupling.leaders) if joint in lock]
            continue
        ((leader, ratio),) = coupling.ratios.items()
        if {name, leader} <= lock.keys():
            ties[name] = Tie(leader, (coupling.offset, ratio))
    return ties, tuple(dict.fromkeys(shared))


def following(name: str, couplings: Sequence[Coupling]) -> str:
    """Describe the coupling of a follower joint; return "" for an independent joint."""
    for coupling in couplings:
        if coupling.follower == name:
            return f"joint '{name}' follows {_names(coupling.leaders)} ({coupling})"
    return ""
