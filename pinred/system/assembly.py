"""Robots as links and joints that can be joined, cut and rooted elsewhere.

An Assembly has the links of a System and the joints between them, in no fixed direction: each joint
states its placement on both links.  A tree of bodies follows for any choice of the root link.  A
joint that the new root reverses keeps its value and its name; its axis changes its sign.  A ball
that is reversed has the inverse attitude.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import InputError, UnsupportedOperationError
from ..common.names import listed, nearest, quoted
from ..lie.rotations import apply, conjugate, rotation
from .body_parameters import link_inertias, moments_of
from .copy_model import RATE_LIMITS, ModelBuilder
from .force_interface import Force
from .joints import axes_of, is_ball, root_joint
from .loops.kinematics import find_frame
from .loops.loop import Constraint, Loop
from .robot_file_contents import Actuator, Contents, Coupling, Derivation, LeftOut, Origin
from .system import System

_FIXED_FRAMES = (pin.FrameType.FIXED_JOINT, pin.FrameType.JOINT)
_SAME_INERTIA = 1e-9  # largest relative difference of a body from the sum of its links
_IN_GROUP = 1e-9  # largest part of a unit twist outside the group that counts as round-off


def link_frame(system: System, name: str, what: str) -> int:
    """Return the index of a link's frame, or of another frame, in the model.

    Args:
        system: The robot.
        name: Name of the link or frame; links take precedence.
        what: Name of the caller in messages.
    Returns:
        The index in `sorted_model`.
    Raises:
        InputError: No link, or more than one, has this name.
    """
    model = system.sorted_model
    moving = [k for k, f in enumerate(model.frames) if f.parentJoint > 0]
    bodies = [k for k in moving if model.frames[k].type == pin.FrameType.BODY]
    for candidates in (bodies, moving):
        matches = [k for k in candidates if model.frames[k].name == name]
        if len(matches) == 1:
            return int(matches[0])
        if matches:
            raise InputError(f"{what}: '{system.name}' has {len(matches)} links {quoted(name)}")
    names = [str(model.frames[k].name) for k in bodies or moving]
    raise InputError(
        f"{what}: '{system.name}' has no link {quoted(str(name))}; {nearest(str(name), names)}"
        f"the links are {listed(names, 60) or 'none'}"
    )


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid link.

    Attributes:
        inertia: Inertia in the frame of the link.
        frames: Further frames on the link: name, type, and placement on the link.
    """

    inertia: pin.Inertia
    frames: tuple[tuple[str, pin.FrameType, pin.SE3], ...] = ()


@dataclass(frozen=True, eq=False)
class Edge:
    """A joint between two links: below = above · at · motion · to.

    Attributes:
        name: Name of the joint.
        above: Link on one side.
        below: Link on the other side.
        at: Placement of the joint on the link above.
        to: Placement of the link below on the moving side of the joint.
        joint: Joint model; None for a fixed joint.
        armature: Armature, (nv,) [kg m² | kg].
        limits: Lower and upper position limits, (2, nq).
        rates: Lower and upper limits of rates and efforts, (4, nv).
        frame: Type of the frame at the joint.
    """

    name: str
    above: str
    below: str
    at: pin.SE3
    to: pin.SE3
    joint: pin.JointModel | None = None
    armature: Array = field(default_factory=lambda: np.empty(0))
    limits: Array = field(default_factory=lambda: np.empty((2, 0)))
    rates: Array = field(default_factory=lambda: np.empty((4, 0)))
    frame: pin.FrameType = pin.FrameType.FIXED_JOINT

    def reversed(self) -> Edge:
        """Return the same joint, described from the link below.

        A hinge or slide turns or slides about the opposite axis: about its own, in a joint frame
        that is turned by half a turn.
        """
        flip = pin.SE3.Identity()
        if self.joint is not None and not is_ball(self.joint):
            flip.rotation = _half_turn(axes_of(self.joint)[:, 0])
        return replace(
            self, above=self.below, below=self.above,
            at=self.to.inverse() * flip, to=flip * self.at.inverse(),
        )  # fmt: skip


def _half_turn(twist: Array) -> Array:
    """Return a half turn that reverses the axis of a hinge or slide, (3, 3); its own inverse."""
    axis = twist[:3] + twist[3:]  # one of them is zero
    normal = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    normal /= np.linalg.norm(normal)
    return np.asarray(2.0 * np.outer(normal, normal) - np.eye(3))


@dataclass(frozen=True, eq=False)
class Root:
    """The joint between the world and the root link.

    Attributes:
        name: Name of the joint.
        joint: Joint model, which moves in the symmetry group.
        link: Name of the root link.
        at: Placement of the joint in the world.
        to: Placement of the root link on the moving side of the joint.
        armature: Armature, (r,) [kg m² | kg].
    """

    name: str
    joint: pin.JointModel
    link: str
    at: pin.SE3
    to: pin.SE3
    armature: Array


@dataclass(frozen=True, eq=False)
class Assembly:
    """Links, and the joints between them, which form a tree.

    Attributes:
        links: Links by name.
        edges: Joints, in the order in which the model has them.
        root: Joint between the world and the root link.
        gravity: Gravity in the world frame, (3,) [m/s²].
        owners: Link of each frame of the model that was taken apart, by the frame's index.
        places: Joint of that model that moves each link, and the placement of the link on it.
    """

    links: Mapping[str, Link]
    edges: tuple[Edge, ...]
    root: Root
    gravity: Array
    owners: Mapping[int, str] = field(default_factory=dict)
    places: Mapping[str, tuple[int, pin.SE3]] = field(default_factory=dict)

    def directed(self) -> tuple[Edge, ...]:
        """Return the joints, each after the link above it, directed away from the root link."""
        placed, unplaced, edges = {self.root.link}, list(self.edges), list[Edge]()
        while unplaced:
            later = list[Edge]()
            for edge in unplaced:
                if edge.above in placed or edge.below in placed:
                    away = edge if edge.above in placed else edge.reversed()
                    placed.add(away.below)
                    edges.append(away)
                else:
                    later.append(edge)
            unplaced = later
        return tuple(edges)

    def path(self, link: str) -> tuple[Edge, ...]:
        """Return the joints from the root link to a link."""
        above = {edge.below: edge for edge in self.directed()}
        path = list[Edge]()
        while link != self.root.link:
            path.append(above[link])
            link = above[link].above
        return tuple(path[::-1])

    def model(self, name: str) -> pin.Model:
        """Return the tree of bodies as a Pinocchio model."""
        builder, root = ModelBuilder(), self.root
        model = builder.model
        model.name, model.gravity.linear = name, self.gravity
        base = builder.add_joint(0, root.joint, root.at, root.name, armature=root.armature)
        frame = model.addJointFrame(base)
        rates = list[tuple[int, Array]]()
        places = {
            root.link: (base, root.to, _add_link(model, self, root.link, base, root.to, frame))
        }
        for edge in self.directed():
            joint, placement, above = places[edge.above]
            at = placement * edge.at
            if edge.joint is not None:
                joint = builder.add_joint(
                    joint, edge.joint, at, edge.name, armature=edge.armature, limits=edge.limits
                )
                rates.append((joint, edge.rates))
                at = pin.SE3.Identity()
            frame = model.addFrame(pin.Frame(edge.name, joint, above, at, edge.frame), False)
            frame_of_joint = at * edge.to
            places[edge.below] = (
                joint,
                frame_of_joint,
                _add_link(model, self, edge.below, joint, frame_of_joint, frame),
            )
        model = builder.finish()
        for joint, limits in rates:
            entries = slice(model.joints[joint].idx_v, model.joints[joint].idx_v + len(limits[0]))
            for limit, values in zip(RATE_LIMITS, limits, strict=True):
                getattr(model, limit)[entries] = values
        return model


def _add_link(
    model: pin.Model, assembly: Assembly, name: str, joint: int, at: pin.SE3, above: int
) -> int:
    """Add a link to a joint of a model; return the index of its frame."""
    link = assembly.links[name]
    if link.inertia.mass != 0.0 or np.any(link.inertia.inertia):
        model.appendBodyToJoint(joint, link.inertia, at)
    number = model.addFrame(pin.Frame(name, joint, above, at, pin.FrameType.BODY), False)
    for frame, frame_type, placement in link.frames:
        model.addFrame(pin.Frame(frame, joint, number, at * placement, frame_type), False)
    return int(number)


def take_apart(system: System) -> Assembly:
    """Return the links and joints of a system.

    Links that are fixed to each other are separate where the model states the inertia of each.
    """
    return system.workspace(Assembly, lambda: _take_apart(system))


def _take_apart(system: System) -> Assembly:
    model = system.sorted_model
    stated = system.contents.links or link_inertias(model)
    joint_frames = {
        int(f.parentJoint): k
        for k, f in enumerate(model.frames)
        if f.type == pin.FrameType.JOINT and f.name == model.names[f.parentJoint]
    }
    bodies = [_Body(model, j, stated, joint_frames) for j in range(1, model.njoints)]
    owners = {k: name for body in bodies for k, name in body.owners.items()}
    links = {name: link for body in bodies for name, link in body.links.items()}
    if len(links) < sum(len(body.links) for body in bodies):
        names = [name for body in bodies for name in body.links]
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"'{system.name}' has several links {quoted(twice)}; rename them")
    first, root_body = model.joints[1], bodies[0]
    root = Root(
        system.root_name, first, root_body.main, model.jointPlacements[1].copy(),
        root_body.places[root_body.main], model.armature[: first.nv].copy(),
    )  # fmt: skip
    edges = list(root_body.fixed)
    for j in range(2, model.njoints):
        joint, body, under = model.joints[j], bodies[j - 1], bodies[model.parents[j] - 1]
        q = slice(joint.idx_q, joint.idx_q + joint.nq)
        v = slice(joint.idx_v, joint.idx_v + joint.nv)
        above = under.carrier(j)
        edges.append(Edge(
            str(model.names[j]), above, body.main,
            under.places[above].actInv(model.jointPlacements[j]), body.places[body.main], joint,
            model.armature[v].copy(),
            np.array([model.lowerPositionLimit[q], model.upperPositionLimit[q]]),
            np.array([getattr(model, limit)[v] for limit in RATE_LIMITS]), pin.FrameType.JOINT,
        ))  # fmt: skip
        edges += body.fixed
    places = {n: (j, at) for j, body in enumerate(bodies, 1) for n, at in body.places.items()}
    return Assembly(links, tuple(edges), root, system.gravity, owners, places)


class _Body:
    """The links of one body of a model: all that move with one joint.

    Attributes:
        main: Name of the link on the joint.
        places: Placement of each link on the joint.
        links: The links by name.
        fixed: Fixed joints between the links.
        owners: Name of the link of each frame, by the frame's index.
    """

    def __init__(
        self,
        model: pin.Model,
        joint: int,
        stated: Mapping[str, pin.Inertia],
        joint_frames: Mapping[int, int],
    ) -> None:
        self._model, self._joint, self._joint_frames = model, joint, joint_frames
        frames = [k for k, f in enumerate(model.frames) if f.parentJoint == joint]
        own_frame = joint_frames.get(joint)
        names = {k: str(model.frames[k].name) for k in frames}
        bodies = [k for k in frames if model.frames[k].type == pin.FrameType.BODY]
        roots = [k for k in bodies if self._fixed_joint(k, bodies) is None]
        divisible = (
            len(roots) == 1
            and len({names[k] for k in bodies}) == len(bodies)
            and all(self._carrying(c) in bodies for c in self._children())
            and self._is_sum(bodies, stated)
        )
        if not divisible:
            bodies = roots[:1]
        main = roots[0] if bodies else None
        self.main = str(model.names[joint]) if main is None else names[main]
        self.owners: dict[int, str] = {}
        for k in frames:
            link = k
            while link and link not in bodies and model.frames[link].parentJoint == joint:
                link = int(model.frames[link].parentFrame)
            self.owners[k] = names[link] if link in bodies else self.main
        self.places = {names[k]: model.frames[k].placement.copy() for k in bodies}
        self.places.setdefault(self.main, pin.SE3.Identity())
        edges = {k: self._fixed_joint(k, bodies) for k in bodies if k != main}
        self.fixed = tuple(self._edge(k, names, edge) for k, edge in edges.items() if edge)
        inner = {own_frame, *bodies, *edges.values()}
        more: dict[str, list[tuple[str, pin.FrameType, pin.SE3]]] = {n: [] for n in self.places}
        for k in frames:
            if k not in inner:
                frame, owner = model.frames[k], self.owners[k]
                placement = self.places[owner].actInv(frame.placement)
                more[owner].append((names[k], frame.type, placement))
        total, main_place = model.inertias[joint], self.places[self.main]
        inertias = {n: stated.get(n, pin.Inertia.Zero()) for n in self.places}
        if len(self.places) == 1:
            inertias[self.main] = main_place.actInv(total)
        self.links = {n: Link(inertias[n], tuple(more[n])) for n in self.places}

    def carrier(self, child: int) -> str:
        """Return the name of the link that carries a child joint."""
        return self.owners.get(self._carrying(child), self.main)

    def _children(self) -> list[int]:
        return [j for j in range(2, self._model.njoints) if self._model.parents[j] == self._joint]

    def _carrying(self, child: int) -> int:
        """Return the frame of the link that carries a child joint; −1 if it is not stated."""
        frame = self._joint_frames.get(child)
        return -1 if frame is None else int(self._model.frames[frame].parentFrame)

    def _fixed_joint(self, body: int, bodies: Collection[int]) -> int | None:
        """Return the frame of the fixed joint between a link and another of the same body."""
        above = int(self._model.frames[body].parentFrame)
        frame = self._model.frames[above]
        is_fixed = frame.type in _FIXED_FRAMES and frame.parentJoint == self._joint
        return above if is_fixed and int(frame.parentFrame) in bodies else None

    def _edge(self, body: int, names: Mapping[int, str], fixed: int) -> Edge:
        frame, link = self._model.frames[fixed], self._model.frames[body]
        above = names[int(frame.parentFrame)]
        at = self.places[above].actInv(frame.placement)
        return Edge(names[fixed], above, names[body], at, frame.placement.actInv(link.placement))

    def _is_sum(self, bodies: Collection[int], stated: Mapping[str, pin.Inertia]) -> bool:
        """Return whether the inertia of the body is the sum of those stated for its links."""
        frames = [self._model.frames[k] for k in bodies]
        placed = [f.placement.act(stated[f.name]) for f in frames if f.name in stated]
        moments = np.array([moments_of(inertia) for inertia in placed]).reshape(-1, 10)
        total = moments_of(self._model.inertias[self._joint])
        scale = np.abs(moments).sum(axis=0) + np.abs(total)
        return bool((np.abs(moments.sum(axis=0) - total) <= _SAME_INERTIA * scale.max()).all())


def to_system(assembly: Assembly, name: str, contents: Contents, derivation: Derivation) -> System:
    """Return the system of an assembly.

    Args:
        assembly: Links and joints.
        name: Name of the system.
        contents: Contents of the files, with the names that the assembly has.
        derivation: How the system was made, from which files of motions make it again.
    """
    inertias = {n: link.inertia for n, link in assembly.links.items() if link.inertia.mass > 0.0}
    return System(
        assembly.model(name), name, None, Origin("", {}, derivation=derivation),
        replace(contents, links=inertias),
    )  # fmt: skip


# Entries of the contents of a file that name joints or frames, and their fields that do.
_ENTRIES = ("passive", "actuators", "couplings", "loops", "coupled_loops")
_ENDS = ("joint", "to", "follower", "leader", "frame_a", "frame_b")
_Entry: TypeAlias = Force | Actuator | Coupling | Constraint


def _ends(entry: _Entry) -> dict[str, str]:
    """Return the joints or frames that an entry names, by field."""
    values = {name: getattr(entry, name, None) for name in _ENDS}
    return {name: value for name, value in values.items() if value is not None}


def contents_of(
    system: System, joints: Collection[str] | None = None, links: Collection[str] = ()
) -> Contents:
    """Return the contents of a file that a changed tree keeps.

    Args:
        system: The robot.
        joints: Names of the joints that the tree keeps; None for the whole tree.
        links: Names of the links that it keeps, if not the whole tree.
    Raises:
        InputError: A coupling, spring, damper or loop connects a joint or link with one that is
            not kept.
    """
    contents = system.contents

    def stays(entry: _Entry) -> bool:
        if joints is None:
            return True
        ends = [*_ends(entry).values(), *getattr(entry, "ratios", ())]
        if isinstance(entry, Loop):
            model, owners = system.sorted_model, take_apart(system).owners
            kept = [owners[find_frame(model, end)] in links for end in ends]
        else:
            kept = [_joint_in(end, joints) for end in ends]
        if any(kept) and not all(kept):
            name = f" {quoted(entry.name)}" if hasattr(entry, "name") else ""
            raise InputError(
                f"{type(entry).__name__}{name} of '{system.name}' connects parts that the cut "
                f"separates: {listed(ends, 6)}. Load the robot without it, or cut elsewhere"
            )
        return all(kept)

    entries: dict[str, Any] = {
        kind: tuple(filter(stays, getattr(contents, kind))) for kind in _ENTRIES
    }
    entries["actuators"] = tuple(a for a in entries["actuators"] if not a.on_base)
    left_out = contents.left_out if joints is None else ()
    return Contents(left_out=left_out, warnings=contents.warnings, **entries)


def _joint_in(label: str, joints: Collection[str]) -> bool:
    """Return whether a label of a rate, such as "elbow" or "neck.x", belongs to given joints."""
    return label in joints or label.rpartition(".")[0] in joints


def renamed(assembly: Assembly, prefix: str) -> Assembly:
    """Return an assembly whose links, joints and frames have a prefix; the root joint keeps its."""
    if not prefix:
        return assembly
    links = {
        prefix + name: replace(
            link, frames=tuple((prefix + frame, *further) for frame, *further in link.frames)
        )
        for name, link in assembly.links.items()
    }
    edges = tuple(
        replace(e, name=prefix + e.name, above=prefix + e.above, below=prefix + e.below)
        for e in assembly.edges
    )
    root = replace(assembly.root, link=prefix + assembly.root.link)
    return Assembly(links, edges, root, assembly.gravity)


def renamed_contents(contents: Contents, prefix: str) -> Contents:
    """Return contents of a file for joints, links and frames whose names have a prefix."""

    def renamed_entry(entry: _Entry) -> _Entry:
        names: dict[str, Any] = {end: prefix + name for end, name in _ends(entry).items()}
        if hasattr(entry, "name"):
            names["name"] = prefix + entry.name
        if isinstance(entry, Coupling):
            names["ratios"] = {prefix + name: ratio for name, ratio in entry.ratios.items()}
        return replace(entry, **names)  # type: ignore[type-var]

    left_out = tuple(
        replace(contents_entry, names=tuple(prefix + name for name in contents_entry.names))
        for contents_entry in contents.left_out
    )
    entries: dict[str, Any] = {
        kind: tuple(map(renamed_entry, getattr(contents, kind))) for kind in _ENTRIES
    }
    return replace(contents, left_out=left_out, **entries)


def both_contents(a: Contents, b: Contents) -> Contents:
    """Return the contents of two files together."""
    names: dict[tuple[str, bool], tuple[str, ...]] = {}
    for entry in (*a.left_out, *b.left_out):
        key = entry.what, entry.demanded
        names[key] = (*names.get(key, ()), *entry.names)
    entries: dict[str, Any] = {kind: (*getattr(a, kind), *getattr(b, kind)) for kind in _ENTRIES}
    return Contents(
        left_out=tuple(LeftOut(what, n, demanded) for (what, demanded), n in names.items()),
        warnings=tuple(dict.fromkeys((*a.warnings, *b.warnings))),
        **entries,
    )


def names_in(assembly: Assembly) -> set[str]:
    """Return the names of all links, joints and frames."""
    frames = {frame for link in assembly.links.values() for frame, *_ in link.frames}
    return {*assembly.links, *(e.name for e in assembly.edges), assembly.root.name, *frames}


def twists_of(system: System) -> Array:
    """Return the unit twists of the group in the world, (6, r), about the world's origin."""
    model = system.sorted_model
    return np.asarray(model.jointPlacements[1].toActionMatrix() @ axes_of(model.joints[1]))


def leaves_group(assembly: Assembly, twists: Array, path: Sequence[Edge]) -> str | None:
    """Return the first joint on a path whose motion is not one of the group, or None.

    The motion of a link relative to the root stays in the group for all values of the joints if the
    twists of all joints, where all are at zero, are twists of the group.

    Args:
        assembly: Links and joints.
        twists: Unit twists of the group in the world, (6, r).
        path: Joints from the root link on.
    """
    basis, at = np.linalg.qr(twists)[0], assembly.root.at * assembly.root.to
    for edge in path:
        at = at * edge.at
        if edge.joint is not None:
            S = at.toActionMatrix() @ axes_of(edge.joint)
            size = np.abs(S).max(initial=1.0)
            if np.abs(S - basis @ (basis.T @ S)).max(initial=0.0) > _IN_GROUP * size:
                return edge.name
        at = at * edge.to
    return None


def reversed_balls(old: Assembly, new: Assembly) -> set[str]:
    """Return the balls of an assembly that another one has in the other direction."""
    return {e.name for e in _reversed_joints(old, new) if is_ball(e.joint)}


def _reversed_joints(old: Assembly, new: Assembly) -> list[Edge]:
    above = {edge.name: edge.above for edge in old.directed() if edge.joint is not None}
    return [e for e in new.directed() if e.name in above and above[e.name] != e.above]


def refuse_reversed(contents: Contents, old: Assembly, new: Assembly, what: str) -> None:
    """Reject joints whose direction changes, where it matters: forced balls, and ends of loops.

    Args:
        contents: Contents of the files.
        old: Assembly before the change.
        new: Assembly after it.
        what: Name of the caller in messages.
    Raises:
        UnsupportedOperationError: A force acts at a reversed ball, or a loop ends at the frame of
            a reversed joint, which would move with another link.
    """
    links = {name for name in names_in(old) if name not in {e.name for e in old.edges}}
    reversed_joints = {edge.name for edge in _reversed_joints(old, new)} - links
    for loop in contents.loops:
        if isinstance(loop, Loop) and (at := reversed_joints & {loop.frame_a, loop.frame_b}):
            raise UnsupportedOperationError(
                f"{what}: loop {quoted(loop.name)} ends at joint {quoted(min(at))}, which "
                "changes its direction. State a link or frame as the end of the loop"
            )
    forces: tuple[_Entry, ...] = (*contents.passive, *contents.actuators)
    labels = [label for force in forces for label in _ends(force).values()]
    for name in reversed_balls(old, new):
        if any(_joint_in(label, {name}) for label in labels):
            raise UnsupportedOperationError(
                f"{what}: ball {quoted(name)} changes its direction, and a spring, damper or "
                "actuator acts at it in axes of its child. Remove the force, or replace the ball "
                "by three hinges"
            )


def reversed_ball(x: Array, sigma: Array) -> tuple[Array, Array]:
    """Return attitude and rate of a ball as seen from its child: x⁻¹ and −R(x) σ."""
    return conjugate(x), -apply(rotation(x), sigma)


def new_root(system: System, link: str, frame: pin.SE3) -> tuple[pin.JointModel, pin.SE3]:
    """Return a root joint of the system's group, and the placement of a link on its moving side.

    The moving side is the frame as far as the group can place it: where the group lacks
    translations or rotations, it has those of the system's root where all joints are at zero.

    Args:
        system: The robot.
        link: Name of the link.
        frame: Placement of a frame on the link.
    Raises:
        InputError: The link can leave the motions of the group.
    """
    assembly, group = take_apart(system), system.group
    path = assembly.path(link)
    outside = leaves_group(assembly, twists_of(system), path)
    if outside is not None:
        raise InputError(
            f"link {quoted(link)} of '{system.name}' cannot float on its own: joint "
            f"{quoted(outside)} moves it out of the group {group.name}"
        )
    frame_of_root = assembly.root.to  # the frame on the moving side of the root, all joints at zero
    for edge in path:
        frame_of_root = frame_of_root * edge.at * edge.to
    frame_of_root = frame_of_root * frame
    if group.name == "SE3":
        return root_joint(group), frame.inverse()
    S, k = axes_of(assembly.root.joint), group.linear
    origin = pin.SE3(frame_of_root.rotation, S[:3, :k] @ (S[:3, :k].T @ frame_of_root.translation))
    if group.turns < 3:
        # The part of the rotation about the axis of the group: the twist of swing and twist.
        turn, axis = pin.Quaternion(frame_of_root.rotation).coeffs(), S[3:, k:].sum(axis=1)
        angle = 2.0 * np.arctan2(axis @ turn[:3], turn[3])
        origin.rotation = pin.exp3(angle * axis)
    return assembly.root.joint, origin.inverse() * frame_of_root * frame.inverse()
