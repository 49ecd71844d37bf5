"""Systems made from others: joined at a frame, cut at a joint, paired, or rooted elsewhere.

Each function records in `Origin.derivation` how it was called, so that files of motions can make
the system again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..common.arrays import Array, vector
from ..common.errors import InputError
from ..common.names import listed, nearest, quoted
from ..lie.groups import SO2, SO3
from ..lie.rotations import conjugate
from .assembly import (
    Assembly,
    Edge,
    Link,
    Root,
    both_contents,
    contents_of,
    leaves_group,
    link_frame,
    names_in,
    new_root,
    refuse_reversed,
    renamed,
    renamed_contents,
    reversed_ball,
    reversed_balls,
    take_apart,
    to_system,
    twists_of,
)
from .coordinates import PlacedJoint
from .copy_model import PRISMATIC, REVOLUTE, joint_along
from .joints import axes_of, is_ball, is_prismatic, root_joint
from .robot_file_contents import Derivation
from .system import System

_SAME_MOTIONS = 1e-9  # largest part of a unit twist of one root outside the motions of the other
Pivot: TypeAlias = Literal["all", "vertical", "normal"]


@dataclass(frozen=True, eq=False)
class Place:
    """A frame of a system.

    Attributes:
        link: Name of the link that carries it.
        on_link: Placement on the link.
        joint: Index of the joint of `sorted_model` that moves the link.
        on_joint: Placement on the moving side of this joint.
    """

    link: str
    on_link: pin.SE3
    joint: int
    on_joint: pin.SE3


def place_of(system: System, name: str, what: str) -> Place:
    """Return the place of a link or frame by name.  Raises InputError for an unknown name."""
    index, model = link_frame(system, name, what), system.sorted_model
    frame, assembly = model.frames[index], take_apart(system)
    link = assembly.owners[index]
    joint, at = assembly.places[link]
    return Place(link, at.actInv(frame.placement), joint, frame.placement.copy())


def placements(system: System, pose: Array, x: Array) -> pin.Data:
    """Return a new work space with the placements of all joints of `sorted_model`."""
    data = system.sorted_model.createData()
    pin.forwardKinematics(system.sorted_model, data, system.sorted_q(pose, x))
    return data


def pose_of(system: System, M: pin.SE3) -> Array:
    """Return the pose of the base for a placement of the root's moving side on its fixed side.

    The part of the placement that the group cannot reach is ignored.
    """
    group, axes = system.group, axes_of(system.sorted_model.joints[1])
    position = axes[:3, : group.linear].T @ M.translation
    if group.turns == 3:
        return np.concatenate([position, pin.Quaternion(M.rotation).normalized().coeffs()])
    return np.concatenate([position, axes[3:, group.linear :].T @ pin.log3(M.rotation)])


def same_motions(a: System, b: System) -> str:
    """Return why the roots of two systems do not move in the same group; "" if they do."""
    if a.group.name != b.group.name:
        return (
            f"'{a.name}' moves in {a.group.name} and '{b.name}' in {b.group.name}. Load both with "
            "the same group="
        )
    basis, other = np.linalg.qr(twists_of(a))[0], twists_of(b)
    if np.abs(other - basis @ (basis.T @ other)).max() > _SAME_MOTIONS * np.abs(other).max():
        return (
            f"the roots of '{a.name}' and '{b.name}' move in {a.group.name} about different axes. "
            "Place the root joints so that their axes agree"
        )
    if not np.array_equal(a.gravity, b.gravity):
        return (
            f"gravity of '{a.name}' is {a.gravity.tolist()} m/s² and of '{b.name}' "
            f"{b.gravity.tolist()} m/s². Load both with the same gravity="
        )
    return ""


def free_prefix(a: System, b: System) -> str:
    """Return a prefix that makes the names in b differ from those in a; "" if they differ."""
    prefix, number = "", 1
    while _shared_names(a, b, prefix):
        prefix = f"{b.name}_" if number == 1 else f"{b.name}{number}_"
        number += 1
    return prefix


def _shared_names(a: System, b: System, prefix: str) -> set[str]:
    """Return the names of links, joints, frames and loops that are in a, and with a prefix in b."""
    taken, names = (
        names_in(take_apart(s)) | {loop.name for loop in (*s.loops, *s.contents.coupled_loops)}
        for s in (a, b)
    )
    return taken & {prefix + name for name in names - {b.root_name}}


def _check_names(a: System, b: System, prefix: str) -> None:
    """Raise InputError if a name would occur twice."""
    if shared := _shared_names(a, b, prefix):
        raise InputError(
            f"prefix: with {quoted(prefix)}, '{a.name}' and '{b.name}' both have "
            f"{listed(sorted(shared), 6)}. Choose another prefix, or leave it out"
        )


def both_doubts(a: System, b: System) -> tuple[str, ...]:
    """Return the warnings about the inertias of two systems.

    The kinetic energy of both together, or of both as one, is positive where those of both are.
    """
    return tuple(dict.fromkeys((*a.doubts, *b.doubts)))


def join(
    a: System, b: System, *, at: str, onto: str, offset: ArrayLike, prefix: str, name: str = ""
) -> System:
    """Return the system in which two frames of two systems are fixed to each other.

    It has the root of the first.  Joints of the second between its root and the frame keep their
    values and change their directions.

    Args:
        a: First system.
        b: Second system.
        at: Link or frame of the first.
        onto: Link or frame of the second.
        offset: Placement of `onto` in `at`, position [m] and quaternion, (7,).
        prefix: Text before the names of links, joints and frames of the second.
        name: Name of the result; those of both by default.
    Raises:
        InputError: A frame is unknown, the groups or gravity differ, a name would occur twice, or a
            joint moves the other robot out of the group.
    """
    placement = vector(offset, 7, "offset")
    first, second = place_of(a, at, "at"), place_of(b, onto, "onto")
    if reason := same_motions(a, b):
        raise InputError(f"join: {reason}")
    _check_names(a, b, prefix)
    A, B = take_apart(a), renamed(take_apart(b), prefix)
    for system, assembly, link in ((a, A, first.link), (b, B, prefix + second.link)):
        if outside := leaves_group(assembly, twists_of(system), assembly.path(link)):
            raise InputError(
                f"join: joint {quoted(outside)} of '{system.name}' moves the frame out of the "
                f"group {a.group.name}. Join at a link before it, or lock it"
            )
    edge = Edge(
        f"{at}+{prefix}{onto}", first.link, prefix + second.link, first.on_link,
        pin.XYZQUATToSE3(placement) * second.on_link.inverse(),
    )  # fmt: skip
    root = replace(A.root, armature=A.root.armature + B.root.armature)
    joined = Assembly({**A.links, **B.links}, (*A.edges, edge, *B.edges), root, a.gravity)
    second_contents = renamed_contents(contents_of(b), prefix)
    refuse_reversed(second_contents, B, joined, "join")
    arguments = {
        "at": at, "onto": onto, "offset": placement.tolist(), "prefix": prefix, "name": name,
    }  # fmt: skip
    return to_system(
        joined, name or f"{a.name}+{b.name}", both_contents(contents_of(a), second_contents),
        Derivation(
            "join", (a, b), arguments, both_doubts(a, b),
            _closed(a, A, A) | _closed(b, B, joined, prefix),
        ),
    )  # fmt: skip


def pair(a: System, b: System, *, prefix: str, name: str = "") -> System:
    """Return the system of two robots that move freely of each other.

    Joints without mass carry the root of the second from the root of the first.  They have the
    names PREFIX + "relative_x" and so on, or "relative" for a rotation.

    Args:
        a: First system, whose root it has.
        b: Second system.
        prefix: Text before the names of the second.
        name: Name of the result.
    Raises:
        InputError: The groups or gravity differ, or a name would occur twice.
    """
    if reason := same_motions(a, b):
        raise InputError(f"pair: {reason}")
    _check_names(a, b, prefix)
    A, B, group = take_apart(a), renamed(take_apart(b), prefix), a.group
    axes, links, edges = axes_of(A.root.joint), dict[str, Link](), list[Edge]()
    turns = [""] * (group.turns > 0)
    above, at = A.root.link, A.root.to.inverse()
    names = [f"{prefix}relative_{'xyz'[k]}" for k in range(group.linear)]
    names += [f"{prefix}relative" for _ in turns]
    for k, joint_name in enumerate(names):
        joint: pin.JointModel
        if k < group.linear:
            joint = joint_along(PRISMATIC, axes[:3, k])
        else:
            hinge = group.turns == 1
            joint = joint_along(REVOLUTE, axes[3:, k]) if hinge else pin.JointModelSpherical()
        is_last = k == len(names) - 1
        below = B.root.link if is_last else f"{joint_name}_link"
        to = A.root.at.actInv(B.root.at) * B.root.to if is_last else pin.SE3.Identity()
        edges.append(_free_edge(joint_name, above, below, at, to, joint))
        if not is_last:
            links[below] = Link(pin.Inertia.Zero())
        above, at = below, pin.SE3.Identity()
    both = Assembly(
        {**A.links, **links, **B.links}, (*A.edges, *edges, *B.edges), A.root, a.gravity
    )
    contents = both_contents(contents_of(a), renamed_contents(contents_of(b), prefix))
    return to_system(
        both, name or f"{a.name} and {b.name}", contents,
        Derivation(
            "pair", (a, b), {"prefix": prefix, "name": name}, both_doubts(a, b),
            _closed(a, A, A) | _closed(b, B, B, prefix),
        ),
    )  # fmt: skip


def _free_edge(
    name: str, above: str, below: str, at: pin.SE3, to: pin.SE3, joint: pin.JointModel
) -> Edge:
    """Return a joint without armature and limits between two links."""
    free, unbounded = np.outer([-np.inf, np.inf], np.ones(joint.nq)), [-np.inf, np.inf] * 2
    rates = np.outer(unbounded, np.ones(joint.nv))
    frame = pin.FrameType.JOINT
    return Edge(name, above, below, at, to, joint, np.zeros(joint.nv), free, rates, frame)


def _closed(system: System, old: Assembly, new: Assembly, prefix: str = "") -> dict[str, Array]:
    """Return the values of joints at a closed shape, by their names in another assembly."""
    if system.closure is None:
        return {}
    x, reversed_names = system.closure.x, reversed_balls(old, new)
    values = {prefix + joint.name: x[joint.x] for joint in system.space.joints}
    return {n: conjugate(value) if n in reversed_names else value for n, value in values.items()}


def reroot(system: System, *, link: str, name: str = "") -> System:
    """Return the same robot with another root link, in the same group.

    The pose of the base is then that of the link's frame.

    Args:
        system: The robot.
        link: Link or frame that the pose describes.
        name: Name of the result; that of the robot by default.
    Raises:
        InputError: The link is unknown, or a joint moves it out of the group.
    """
    place, assembly = place_of(system, link, "root"), take_apart(system)
    joint, to = new_root(system, place.link, place.on_link)
    root = replace(assembly.root, joint=joint, link=place.link, to=to)
    rerooted, contents = replace(assembly, root=root), contents_of(system)
    refuse_reversed(contents, assembly, rerooted, "root")
    arguments, closed = {"link": link, "name": name}, _closed(system, assembly, rerooted)
    derivation = Derivation("reroot", (system,), arguments, system.doubts, closed)
    return to_system(rerooted, name or system.name, contents, derivation)


def cut(system: System, *, link: str, part: int, root: str = "", name: str = "") -> System:
    """Return one of the two systems into which a cut at a joint divides a robot.

    Args:
        system: The robot.
        link: Link behind the joint, or the joint itself; it may be fixed or move.
        part: 0 for the part with the root, 1 for the other.
        root: Root link of the other part; the link behind the joint by default.
        name: Name of the part.
    Raises:
        InputError: The link is unknown, is the root, cannot be separated from the link that carries
            it, or is connected by couplings or springs; or the other part cannot float on its own.
    """
    assembly = take_apart(system)
    edge = cut_edge(system, assembly, link)
    below, edges = {edge.below}, assembly.directed()
    for other in edges:
        if other.above in below:
            below.add(other.below)
    inside = tuple(e for e in edges if e.above in below)
    idle = _without_mass([e for e in edges if e.below not in below], assembly.links)
    outside = tuple(e for e in edges if e.below not in below | idle)
    arguments = {"link": link, "part": part, "root": root, "name": name}
    joints = {e.name for e in (inside if part else outside) if e.joint is not None}
    kept_links = below if part else assembly.links.keys() - below - idle
    contents = contents_of(system, joints, kept_links)
    links = {n: entry for n, entry in assembly.links.items() if n in kept_links}
    if not part:
        carrier = Assembly(links, outside, assembly.root, assembly.gravity)
        derivation = Derivation(
            "cut", (system,), arguments, None, _closed(system, carrier, carrier)
        )
        return to_system(carrier, name or system.name, contents, derivation)
    joint, to = new_root(system, edge.below, pin.SE3.Identity())
    base = Root(
        _root_name(links, inside), joint, edge.below, assembly.root.at, to, np.zeros(joint.nv)
    )
    released = Assembly(links, inside, base, assembly.gravity)
    derivation = Derivation("cut", (system,), arguments, None, _closed(system, released, released))
    if root and root != edge.below:
        if root not in links:
            raise InputError(
                f"root: the released part has no link {quoted(root)}; {nearest(root, [*links])}"
                f"its links are {listed(links, 60)}"
            )
        uncut = to_system(released, name, contents, derivation)
        joint, to = new_root(uncut, root, pin.SE3.Identity())
        rerooted = replace(released, root=replace(base, joint=joint, link=root, to=to))
        refuse_reversed(contents, released, rerooted, "root")
        closed = _closed(system, released, rerooted)
        derivation, released = replace(derivation, closed=closed), rerooted
    return to_system(released, name or edge.below, contents, derivation)


def _without_mass(edges: Sequence[Edge], links: Mapping[str, Link]) -> set[str]:
    """Return the links behind joints that move no mass any more after a cut."""
    light, idle = set[str](), set[str]()
    for edge in edges[::-1]:  # the outer links first
        outer = [other.below for other in edges if other.above == edge.below]
        if links[edge.below].inertia.mass == 0.0 and light.issuperset(outer):
            light.add(edge.below)
    for edge in edges:
        if edge.below in light and (edge.joint is not None or edge.above in idle):
            idle.add(edge.below)
    return idle


def _root_name(links: Mapping[str, Link], edges: tuple[Edge, ...]) -> str:
    name = "root_joint"
    while name in links or any(edge.name == name for edge in edges):
        name = f"{name}_"
    return name


def cut_edge(system: System, assembly: Assembly, name: str) -> Edge:
    """Return the joint behind which a cut separates a robot.  Raises InputError."""
    edges = assembly.directed()
    by_link, by_joint = ({e.below: e for e in edges}, {e.name: e for e in edges})
    if name in by_link:
        return by_link[name]
    if name in by_joint:
        return by_joint[name]
    if name in (assembly.root.link, assembly.root.name):
        raise InputError(
            f"release: {quoted(name)} is the root of '{system.name}'; nothing carries it. Name a "
            f"link behind a joint: {listed(by_link, 60) or 'there is none'}"
        )
    place = link_frame(system, name, "release")  # or an unknown name
    raise InputError(
        f"release: {quoted(name)} is a frame on link {quoted(assembly.owners[place])} of "
        f"'{system.name}', from which it cannot be separated, because the file states no inertia "
        f"of its own. Name one of {listed(by_link, 60) or 'no link'}"
    )


def stand(
    system: System, *, frame: str, at: list[float], pivot: Pivot, up: list[float], name: str = ""
) -> System:
    """Return a robot that turns about a fixed point: the same tree with its root at a frame.

    Args:
        system: The robot, which floats.
        frame: Link or frame whose origin is fixed.
        at: Placement of the frame in the world at contact, position [m] and quaternion, (7,).
        pivot: "all": it turns freely (SO3).  "vertical": it turns about the vertical (SO2), with
            two tilt angles "tilt_x" and "tilt_y" as further joints.  "normal": it turns about the
            axis about which its base turns (SO2).
        up: Unit vector of the axis of SO2 in the world, (3,).
        name: Name of the result.
    """
    place, assembly = place_of(system, frame, "frame"), take_apart(system)
    contact = pin.XYZQUATToSE3(np.array(at))
    links, edges = dict(assembly.links), list(assembly.edges)
    link, to = place.link, place.on_link.inverse()
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), np.array(up)).matrix()
    base = pin.SE3(turn, contact.translation)
    joint = root_joint(SO3 if pivot == "all" else SO2)
    root_link = link
    taken, doubts = names_in(assembly), list[str]()
    if pivot == "all":
        base = pin.SE3(np.eye(3), contact.translation)
    elif pivot == "normal":
        to = base.actInv(contact) * to
    else:
        names = [_unused(f"tilt_{axis}", taken) for axis in "xy"]
        inner = [_unused(f"{names[0]}_link", taken), _unused("stance", taken)]
        doubts.append(
            f"joint {quoted(names[0])} describes no tilt of 1.5708 rad, where a simulation ends"
        )
        links |= {entry: Link(pin.Inertia.Zero()) for entry in inner}
        root_link = inner[1]
        here, on_link = pin.SE3.Identity(), base.actInv(contact) * to
        edges += [
            _free_edge(names[0], inner[1], inner[0], here, here, pin.JointModelRX()),
            _free_edge(names[1], inner[0], link, here, on_link, pin.JointModelRY()),
        ]
        to = pin.SE3.Identity()
    root = Root(_unused("contact", taken), joint, root_link, base, to, np.zeros(joint.nv))
    standing = Assembly(links, tuple(edges), root, assembly.gravity)
    contents = contents_of(system)
    refuse_reversed(contents, assembly, standing, "land")
    arguments = {"frame": frame, "at": at, "pivot": pivot, "up": up, "name": name}
    return to_system(
        standing, name or f"{system.name} on {frame}", contents,
        Derivation(
            "stand", (system,), arguments, (*system.doubts, *doubts),
            _closed(system, assembly, standing),
        ),
    )  # fmt: skip


def _unused(name: str, taken: set[str]) -> str:
    while name in taken:
        name = f"{name}_"
    return name


FUNCTIONS: Mapping[str, Callable[..., System]] = {
    "join": join, "pair": pair, "reroot": reroot, "cut": cut, "stand": stand,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Instant:
    """The state of a system at one time.

    Attributes:
        pose: Pose of the base, (size,).
        x: Shape, (nx,) [rad | m | 1].
        xdot: Shape rate, (m,) [rad/s | m/s].
        xi: Body twist of the base, (r,) [m/s; rad/s].
    """

    pose: Array
    x: Array
    xdot: Array
    xi: Array


@dataclass(frozen=True, eq=False)
class Moving:
    """A system with its state, as a part of another system.

    Attributes:
        system: The system.
        state: Its state.
        prefix: Text before its names in the other system.
    """

    system: System
    state: Instant
    prefix: str = ""


class Transfer:
    """The map from states of some systems to the state of one whose links move as theirs.

    Joints of the same name have the same values.  Joints that only the new system has follow from
    the motion of the links that they connect: slides, then a hinge or a ball.  If they carry the
    first common link from the root, they are at zero.
    """

    def __init__(self, systems: Sequence[System], prefixes: Sequence[str], new: System) -> None:
        """Prepare the map.

        Args:
            systems: The systems.
            prefixes: Text before the names of each in the new system.
            new: System with some or all of their links, and the same joints between them.
        """
        self._new, self._assembly = new, take_apart(new)
        edges = {edge.below: edge for edge in self._assembly.directed()}
        self._slots = {joint.name: joint for joint in new.space.joints}
        self._base: int | None = None  # number of the system that has the same root
        # For each system: its joint, that of the new system, and whether it is a reversed ball.
        self._same: list[list[tuple[PlacedJoint, PlacedJoint, bool]]] = []
        links, previous_edges = set[str](), set[str]()
        for k, (system, prefix) in enumerate(zip(systems, prefixes, strict=True)):
            before = renamed(take_apart(system), prefix)
            reversed_names = reversed_balls(before, self._assembly)
            self._same.append([
                (joint, self._slots[prefix + joint.name], prefix + joint.name in reversed_names)
                for joint in system.space.joints if prefix + joint.name in self._slots
            ])  # fmt: skip
            links |= {*before.links}
            previous_edges |= {edge.name for edge in before.edges}
            if self._base is None and _same_root(before.root, self._assembly.root):
                self._base = k
        self._runs: list[list[Edge]] = []
        for name in [name for name in edges if name in links]:
            run = [edges[name]]
            while (
                run[0].name not in previous_edges
                and run[0].above in edges
                and run[0].above not in links
            ):
                run.insert(0, edges[run[0].above])
            if run[0].name not in previous_edges and run[0].above in links:
                self._runs.append(run)

    def __call__(self, parts: Sequence[Moving]) -> Instant:
        """Return the state of the new system.

        Args:
            parts: The systems in the same order, with their states.
        """
        space = self._new.space
        x, xdot = space.neutral.copy(), np.zeros(space.m)
        links = dict[str, tuple[pin.SE3, pin.Motion]]()
        for part, same in zip(parts, self._same, strict=True):
            for joint, slot, is_reversed in same:
                joint_state = part.state.x[joint.x], part.state.xdot[joint.v]
                x[slot.x], xdot[slot.v] = (
                    reversed_ball(*joint_state) if is_reversed else joint_state
                )
            if self._runs or self._base is None:
                links |= link_motions(part)
        for run in self._runs:
            above, below = links[run[0].above], links[run[-1].below]
            _solve_run(run, above, below, self._slots, x, xdot)
        if self._base is not None:
            state = parts[self._base].state
            return Instant(state.pose.copy(), x, xdot, state.xi.copy())
        pose, xi = _solve_root(self._assembly, self._new, links, self._slots, xdot)
        return Instant(pose, x, xdot, xi)


def carry_state(parts: Sequence[Moving], new: System) -> Instant:
    """Return the state of a system at which its links move as those of others; see Transfer."""
    systems, prefixes = [part.system for part in parts], [part.prefix for part in parts]
    return Transfer(systems, prefixes, new)(parts)


def link_motions(part: Moving) -> dict[str, tuple[pin.SE3, pin.Motion]]:
    """Return the placement of each link in the world, and its twist in its own frame, by name."""
    system, state, model = part.system, part.state, part.system.sorted_model
    data = system.sorted_data
    q, v = system.sorted_q(state.pose, state.x), system.sorted_v(state.xi, state.xdot)
    pin.forwardKinematics(model, data, q, v)
    return {
        part.prefix + name: (data.oMi[joint] * at, at.actInv(data.v[joint]))
        for name, (joint, at) in take_apart(system).places.items()
    }


def _same_root(a: Root, b: Root) -> bool:
    same_kind = a.joint.shortname() == b.joint.shortname()
    return a.link == b.link and same_kind and a.at == b.at and a.to == b.to


def _solve_run(
    run: Sequence[Edge],
    above: tuple[pin.SE3, pin.Motion],
    below: tuple[pin.SE3, pin.Motion],
    slots: Mapping[str, PlacedJoint],
    x: Array,
    xdot: Array,
) -> None:
    """Fill in the values and rates of slides, then a hinge or a ball, between two moving links."""
    relative = above[0].actInv(below[0])
    motion = run[0].at.actInv(relative) * run[-1].to.inverse()
    twist = below[1] - relative.actInv(above[1])
    # Slides come first, so the translation is that along their axes.
    v, w = motion.rotation @ run[-1].to.act(twist).linear, run[-1].to.act(twist).angular
    for edge in run:
        if edge.joint is None:
            continue
        S, slot = axes_of(edge.joint), slots[edge.name]
        if is_ball(edge.joint):
            x[slot.x], xdot[slot.v] = pin.Quaternion(motion.rotation).normalized().coeffs(), w
        elif is_prismatic(edge.joint):
            x[slot.x], xdot[slot.v] = S[:3].T @ motion.translation, S[:3].T @ v
        else:
            x[slot.x], xdot[slot.v] = S[3:].T @ pin.log3(motion.rotation), S[3:].T @ w


def _solve_root(
    assembly: Assembly,
    new: System,
    links: Mapping[str, tuple[pin.SE3, pin.Motion]],
    slots: Mapping[str, PlacedJoint],
    xdot: Array,
) -> tuple[Array, Array]:
    """Return pose and twist of a base that moves as the links do; joints before them are at zero.

    The rates of these joints are filled in.
    """
    root, edges = assembly.root, assembly.directed()
    first = next(name for name in (root.link, *(e.below for e in edges)) if name in links)
    columns, moving, to = list[Array](), list[Edge](), pin.SE3.Identity()
    for edge in assembly.path(first)[::-1]:
        to = edge.to * to
        if edge.joint is not None:
            columns.append(to.toActionMatrixInverse() @ axes_of(edge.joint))
            moving.append(edge)
        to = edge.at * to
    placement, twist = links[first]
    to = root.to * to
    columns.append(to.toActionMatrixInverse() @ axes_of(root.joint))
    rates = np.linalg.lstsq(np.hstack(columns), twist.vector, rcond=None)[0]
    for edge in moving:
        slot = slots[edge.name].v
        xdot[slot], rates = np.split(rates, [slot.stop - slot.start])
    return pose_of(new, root.at.actInv(placement * to.inverse())), rates
