"""Systems made from others: joined at a frame, cut at a joint, paired, or rooted elsewhere.

Each function records in `Origin.derivation` how it was called, so that files of motions can make
the system again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import InputError
from ..common.names import listed, nearest, quoted
from ..lie.groups import SO2, SO3
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
    refuse_forced_balls,
    renamed,
    renamed_contents,
    reversed_ball,
    reversed_balls,
    take_apart,
    to_system,
    twists_of,
)
from .joints import axes_of, root_joint
from .rebuild import PRISMATIC, REVOLUTE, joint_along
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
    taken, names = names_in(take_apart(a)), names_in(take_apart(b)) - {b.root_name}
    prefix, number = "", 1
    while taken & {prefix + name for name in names}:
        prefix = f"{b.name}_" if number == 1 else f"{b.name}{number}_"
        number += 1
    return prefix


def join(
    a: System, b: System, *, at: str, onto: str, offset: Array, prefix: str, name: str = ""
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
        InputError: A frame is unknown, the groups or gravity differ, or a joint moves the other
            robot out of the group.
    """
    first, second = place_of(a, at, "at"), place_of(b, onto, "onto")
    if reason := same_motions(a, b):
        raise InputError(f"join: {reason}")
    A, B = take_apart(a), renamed(take_apart(b), prefix)
    for system, assembly, link in ((a, A, first.link), (b, B, prefix + second.link)):
        if outside := leaves_group(assembly, twists_of(system), assembly.path(link)):
            raise InputError(
                f"join: joint {quoted(outside)} of '{system.name}' moves the frame out of the "
                f"group {a.group.name}. Join at a link before it, or lock it"
            )
    edge = Edge(
        f"{at}+{prefix}{onto}", first.link, prefix + second.link, first.on_link,
        pin.XYZQUATToSE3(offset) * second.on_link.inverse(),
    )  # fmt: skip
    root = replace(A.root, armature=A.root.armature + B.root.armature)
    joined = Assembly({**A.links, **B.links}, (*A.edges, edge, *B.edges), root, a.gravity)
    second_contents = renamed_contents(contents_of(b), prefix)
    refuse_forced_balls(second_contents, reversed_balls(B, joined), "join")
    arguments = {"at": at, "onto": onto, "offset": offset.tolist(), "prefix": prefix, "name": name}
    return to_system(
        joined, name or f"{a.name}+{b.name}", both_contents(contents_of(a), second_contents),
        Derivation("join", (a, b), arguments),
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
        InputError: The groups or gravity differ.
    """
    if reason := same_motions(a, b):
        raise InputError(f"pair: {reason}")
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
        nq, nv = joint.nq, joint.nv
        edges.append(Edge(
            joint_name, above, below, at, to, joint, np.zeros(nv),
            np.outer([-np.inf, np.inf], np.ones(nq)),
            np.outer([-np.inf, np.inf, -np.inf, np.inf], np.ones(nv)), pin.FrameType.JOINT,
        ))  # fmt: skip
        if not is_last:
            links[below] = Link(pin.Inertia.Zero())
        above, at = below, pin.SE3.Identity()
    both = Assembly(
        {**A.links, **links, **B.links}, (*A.edges, *edges, *B.edges), A.root, a.gravity
    )
    contents = both_contents(contents_of(a), renamed_contents(contents_of(b), prefix))
    return to_system(
        both, name or f"{a.name} and {b.name}", contents,
        Derivation("pair", (a, b), {"prefix": prefix, "name": name}),
    )  # fmt: skip


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
    moved, contents = replace(assembly, root=root), contents_of(system)
    refuse_forced_balls(contents, reversed_balls(assembly, moved), "root")
    derivation = Derivation("reroot", (system,), {"link": link, "name": name})
    return to_system(moved, name or system.name, contents, derivation)


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
    outside = tuple(e for e in edges if e.below not in below)
    arguments = {"link": link, "part": part, "root": root, "name": name}
    derivation = Derivation("cut", (system,), arguments)
    joints = {e.name for e in (inside if part else outside) if e.joint is not None}
    contents = contents_of(system, joints)
    links = {n: entry for n, entry in assembly.links.items() if (n in below) == bool(part)}
    if not part:
        carrier = Assembly(links, outside, assembly.root, assembly.gravity)
        return to_system(carrier, name or system.name, contents, derivation)
    joint, to = new_root(system, edge.below, pin.SE3.Identity())
    base = Root(_root_name(links, inside), joint, edge.below, assembly.root.at, to, np.zeros(joint.nv))
    released = Assembly(links, inside, base, assembly.gravity)
    if root and root != edge.below:
        if root not in links:
            raise InputError(
                f"root: the released part has no link {quoted(root)}; {nearest(root, [*links])}"
                f"its links are {listed(links, 60)}"
            )
        whole = to_system(released, name, contents, derivation)
        joint, to = new_root(whole, root, pin.SE3.Identity())
        moved = replace(released, root=replace(base, joint=joint, link=root, to=to))
        refuse_forced_balls(contents, reversed_balls(released, moved), "root")
        released = moved
    return to_system(released, name or edge.below, contents, derivation)


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
    taken = names_in(assembly)
    if pivot == "all":
        base = pin.SE3(np.eye(3), contact.translation)
    elif pivot == "normal":
        to = base.actInv(contact) * to
    else:
        names = [_unused(f"tilt_{axis}", taken) for axis in "xy"]
        inner = [_unused(f"{names[0]}_link", taken), _unused("stance", taken)]
        links |= {entry: Link(pin.Inertia.Zero()) for entry in inner}
        root_link = inner[1]
        free = np.outer([-np.inf, np.inf], np.ones(1))
        rates = np.outer([-np.inf, np.inf, -np.inf, np.inf], np.ones(1))
        identity, kind = pin.SE3.Identity(), pin.FrameType.JOINT
        edges += [
            Edge(names[0], inner[1], inner[0], identity, identity, pin.JointModelRX(), np.zeros(1),
                 free, rates, kind),
            Edge(names[1], inner[0], link, identity, base.actInv(contact) * to, pin.JointModelRY(),
                 np.zeros(1), free, rates, kind),
        ]  # fmt: skip
        to = pin.SE3.Identity()
    root = Root(_unused("contact", taken), joint, root_link, base, to, np.zeros(joint.nv))
    standing = Assembly(links, tuple(edges), root, assembly.gravity)
    contents = contents_of(system)
    refuse_forced_balls(contents, reversed_balls(assembly, standing), "land")
    arguments = {"frame": frame, "at": at, "pivot": pivot, "up": up, "name": name}
    return to_system(
        standing, name or f"{system.name} on {frame}", contents,
        Derivation("stand", (system,), arguments),
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


def carry_state(
    old: System, new: System, pose: Array, x: Array, xi: Array, xdot: Array, *, prefix: str = ""
) -> Instant:
    """Return the state of a derived system at which its links move as those of the old one.

    Joints that only the new system has are at zero.  If they carry its first common link, they
    move with it.

    Args:
        old: System whose state is known.
        new: System with some or all of its links, and the same joints between them.
        pose: Pose of the old system, (size,).
        x: Shape of the old system, (nx,).
        xi: Body twist of the old system, (r,).
        xdot: Shape rate of the old system, (m,).
        prefix: Text before the names of the old system in the new one.
    """
    before, after = take_apart(old), take_apart(new)
    model = old.sorted_model
    data = model.createData()
    q, v = old.sorted_q(pose, x), old.sorted_v(xi, xdot)
    pin.forwardKinematics(model, data, q, v)
    x_new, xdot_new = new.space.neutral.copy(), np.zeros(new.m)
    turned = reversed_balls(renamed(before, prefix), after)
    joints = {prefix + joint.name: joint for joint in old.space.joints}
    for joint in new.space.joints:
        if joint.name in joints:
            own = joints[joint.name]
            here = x[own.x], xdot[own.v]
            x_new[joint.x], xdot_new[joint.v] = (
                reversed_ball(*here) if joint.name in turned else here
            )
    root, own = after.root, before.root
    same_root = root.link == prefix + own.link and root.joint.shortname() == own.joint.shortname()
    if same_root and root.at == own.at and root.to == own.to:
        return Instant(pose.copy(), x_new, xdot_new, xi.copy())
    path = _path_to_known(after, {prefix + name for name in before.links})
    link = path[-1].below if path else root.link
    joint, on_joint = before.places[link.removeprefix(prefix)]
    placement, twist = data.oMi[joint] * on_joint, on_joint.actInv(data.v[joint])
    # Twists of the root and of the joints on the path, all at zero, in the frame of the link.
    columns, to, slots = list[Array](), pin.SE3.Identity(), list[slice]()
    for edge in path[::-1]:
        to = edge.to * to
        if edge.joint is not None:
            columns.append(to.toActionMatrixInverse() @ axes_of(edge.joint))
            slots.append(next(j.v for j in new.space.joints if j.name == edge.name))
        to = edge.at * to
    to = root.to * to
    columns.append(to.toActionMatrixInverse() @ axes_of(root.joint))
    rates = np.linalg.lstsq(np.hstack(columns), twist.vector, rcond=None)[0]
    for slot in slots:
        xdot_new[slot], rates = np.split(rates, [slot.stop - slot.start])
    return Instant(pose_of(new, root.at.actInv(placement * to.inverse())), x_new, xdot_new, rates)


def _path_to_known(assembly: Assembly, known: set[str]) -> tuple[Edge, ...]:
    """Return the joints from the root link to the first link that is known."""
    first = next(
        name for name in (assembly.root.link, *(e.below for e in assembly.directed()))
        if name in known
    )  # fmt: skip
    return assembly.path(first)
