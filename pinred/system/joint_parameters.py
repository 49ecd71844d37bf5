"""Placements of joints and values of locked joints by name, such as "elbow.placement".

A placement is that of the joint on the body which carries it: of the origin x, y, z [m], and of
roll, pitch and yaw [rad], as in a URDF file, in the frame of the carrier's joint.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ..common.arrays import Array, as_floats, vector
from ..common.errors import InputError
from ..common.names import nearest
from ..common.plain_names import listed, quoted
from .locked_joints import LockedJoints, moments_of
from .system import System

SIZES = {"placement": 6, "translation": 3, "lock": 1}
PLACED = ("placement", "translation")  # the kinds that any joint but the root has


@dataclass(frozen=True)
class JointParameter:
    """A parameter of a joint.  joint: its name.  kind: one of SIZES."""

    name: str
    joint: str
    kind: str

    @property
    def size(self) -> int:
        """Number of its numbers."""
        return SIZES[self.kind]


def joint_parameter(system: System, name: str) -> JointParameter | None:
    """Return what a name stands for; None if it has not the form of one.

    Raises InputError for a joint that is not there, or whose placement means nothing.
    """
    word, _, kind = name.rpartition(".") if isinstance(name, str) else ("", "", "")
    if kind not in SIZES or not word:
        return None
    if kind == "lock":
        locked = system.contents.locked
        known = [] if locked is None else list(locked.names)
        if locked is not None and word in locked.frozen and word not in known:
            raise InputError(f"parameters: '{name}' does not vary: {locked.why_not(word)}")
        if word not in known:
            raise InputError(
                f"parameters: '{system.name}' has no locked joint {quoted(word)} whose value may "
                f"vary; {nearest(word, known)}those are {listed(known, 60) or 'none'}"
            )
        return JointParameter(name, word, kind)
    known = [str(each) for each in system.model.names][2:]
    if word not in known:
        root = word == system.root_name
        hint = (
            "that is the root, whose placement only says where the world is; "
            if root
            else nearest(word, known)
        )
        raise InputError(
            f"parameters: '{system.name}' has no joint {quoted(word)} with a placement on another "
            f"body; {hint}those are {listed(known, 60)}"
        )
    return JointParameter(name, word, kind)


class Joints:
    """The placements of joints, and inertias behind locked ones, as functions of parameters.

    parameters: in their order.  placed: indices of the bodies, 0 for the root, whose joints are
    placed by them, sorted.  free: those whose inertias they change.  turned: of `placed`, those
    whose axes they turn.  links: frames of links that they move on their bodies.
    """

    def __init__(self, system: System, names: Sequence[str]) -> None:
        """Find the parameters.  Raises InputError for those that say the same thing twice."""
        self._system = system
        found = [joint_parameter(system, name) for name in names]
        self.parameters = tuple(each for each in found if each is not None)
        self._of: dict[int, list[JointParameter]] = {}
        self._locks = {each.joint: each.name for each in self.parameters if each.kind == "lock"}
        behind: set[int] = set()
        free: set[int] = set()
        if self._locks:
            for joint, moved in self._placements({}).items():
                if moved[1].keys() & self._locks.keys():
                    behind.add(self._body(joint))
            for i, place in self._locked.carried({}).items():
                heavy = self._locked.raw.inertias[i].mass > 0.0
                if heavy and place.twists.keys() & self._locks.keys():
                    free.add(self._body(place.joint))
        for each in self.parameters:
            if each.kind == "lock":
                continue
            body = self._body(each.joint)
            if body in behind:
                raise InputError(
                    f"parameters: '{each.name}' is decided by {', '.join(self._locks.values())}; "
                    "leave out one of them"
                )
            if others := self._of.get(body):
                raise InputError(
                    f"parameters: '{each.name}' and '{others[0].name}' are one joint's; name one "
                    "of them"
                )
            self._of[body] = [each]
        self.placed = tuple(sorted(behind | set(self._of)))
        self.turned = tuple(
            i for i in self.placed if i in behind or self._of[i][0].kind == "placement"
        )
        self.free = tuple(sorted(free))
        self._frames = self._locked.frames(system.model, list(self._locks)) if self._locks else {}
        self.links = tuple(sorted(self._frames))

    def own(self) -> dict[str, Array]:
        """Return the values that the system has, {name: (size,)}."""
        out = {}
        for each in self.parameters:
            if each.kind == "lock":
                out[each.name] = np.array([self._locked.frozen[each.joint]])
                continue
            place = self._system.model.jointPlacements[self._body(each.joint) + 1]
            rpy = pin.rpy.matrixToRpy(place.rotation)
            out[each.name] = np.concatenate([place.translation, rpy])[: each.size]
        return out

    def checked(self, values: Mapping[str, Any]) -> dict[str, Array]:
        """Return values as arrays."""
        out = {}
        for each in self.parameters:
            what = f"parameters['{each.name}']"
            given = np.atleast_1d(as_floats(values[each.name], what))
            out[each.name] = vector(given, each.size, what)
        return out

    def perturbed(self, rng: np.random.Generator) -> dict[str, Array]:
        """Return values that have nothing in common with those of the system."""
        return {
            name: value + rng.uniform(0.1, 0.4, len(value)) for name, value in self.own().items()
        }

    def placements(
        self, values: Mapping[str, Array]
    ) -> Iterator[tuple[int, pin.SE3, dict[str, Array]]]:
        """Yield body, placement of its joint, and its twists (6, size) by each value.

        Twists are in the carrier's frame, taken at its origin.
        """
        behind = self._placements(values) if self._locks else {}
        for i in self.placed:
            if i in self._of:
                (each,) = self._of[i]
                own = self._system.model.jointPlacements[i + 1]
                yield (i, *_placed(own, each, values[each.name]))
            else:
                place, twists = behind[str(self._system.model.names[i + 1])]
                yield (
                    i,
                    place,
                    {
                        name: twists[joint][:, None]
                        for joint, name in self._locks.items()
                        if joint in twists
                    },
                )

    def inertias(
        self, values: Mapping[str, Array]
    ) -> Iterator[tuple[int, Array, dict[str, Array]]]:
        """Yield body, its moments (10,) about its joint's origin, and their slopes (10, size)."""
        names, now = self._system.model.names, self._lock_values(values)
        for i in self.free:
            joint = "" if i == 0 and self._floats else str(names[i + 1])
            J, slopes = self._locked.inertia(joint, now)
            found = {
                name: moments_of(slopes[joint])[:, None] for joint, name in self._locks.items()
            }
            yield i, moments_of(J), found

    def places(self, values: Mapping[str, Array]) -> dict[int, tuple[pin.SE3, dict[str, Array]]]:
        """Return of each of `links` its place on its body, and twists (6, 1) by each value.

        Twists are in the body's frame, taken at its origin.
        """
        if not self._frames:
            return {}
        carried, out = self._locked.carried(self._lock_values(values)), {}
        for k, frame in self._frames.items():
            under = carried[self._locked.raw.frames[frame].parentJoint]
            found = {
                name: under.twists[joint][:, None]
                for joint, name in self._locks.items()
                if joint in under.twists
            }
            out[k] = under.moved * self._locked.raw.frames[frame].placement, found
        return out

    @property
    def _locked(self) -> LockedJoints:
        locked = self._system.contents.locked
        assert locked is not None
        return locked

    @property
    def _floats(self) -> bool:
        return not self._locked.raw.existJointName(self._system.root_name)

    def _placements(
        self, values: Mapping[str, Array]
    ) -> dict[str, tuple[pin.SE3, Mapping[str, Array]]]:
        found = self._locked.placements(self._lock_values(values))
        return {joint: place for joint, place in found.items() if joint != self._system.root_name}

    def _lock_values(self, values: Mapping[str, Array]) -> dict[str, float]:
        return {
            joint: float(values[name][0]) for joint, name in self._locks.items() if name in values
        }

    def _body(self, joint: str) -> int:
        return int(self._system.model.getJointId(joint)) - 1 if joint else 0


def _placed(own: pin.SE3, each: JointParameter, value: Array) -> tuple[pin.SE3, dict[str, Array]]:
    """Return a placement, and its twists by the numbers of a parameter."""
    p = value[:3]
    twists = np.zeros((6, each.size))
    twists[:3, :3] = np.eye(3)
    if each.kind == "translation":
        return pin.SE3(own.rotation, p), {each.name: twists}
    roll, pitch, yaw = value[3:]
    R = pin.rpy.rpyToMatrix(roll, pitch, yaw)
    turn = pin.rpy.rpyToMatrix(0.0, 0.0, yaw)
    axes = np.transpose([
        turn @ pin.rpy.rpyToMatrix(0.0, pitch, 0.0) @ [1.0, 0.0, 0.0],
        turn @ [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
    ])  # fmt: skip
    twists[3:, 3:] = axes
    twists[:3, 3:] = -np.cross(axes.T, p).T  # of the origin, that the frame's own may stay
    return pin.SE3(R, p), {each.name: twists}
