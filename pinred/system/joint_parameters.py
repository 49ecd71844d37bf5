"""Joint parameters by name, such as "elbow.placement": placements, and values of locked joints.

A placement describes the joint on its carrier, the body to which the joint is attached: origin x,
y, z [m], then roll, pitch, yaw [rad], as in a URDF file, in the frame of the carrier's joint.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import InputError
from ..common.names import listed, nearest, quoted
from .locked_joints import LockedJoints, moments_of
from .system import System

SIZES = {"placement": 6, "translation": 3, "lock": 1}
PLACED = ("placement", "translation")  # kinds of parameters that every joint except the root has


@dataclass(frozen=True)
class JointParameter:
    """A parameter of a joint.

    Attributes:
        name: Name of the parameter.
        joint: Name of the joint.
        kind: Kind of parameter, a key of SIZES.
    """

    name: str
    joint: str
    kind: str

    @property
    def size(self) -> int:
        """Number of values."""
        return SIZES[self.kind]


def joint_parameter(system: System, name: str) -> JointParameter | None:
    """Return the joint parameter that a name denotes, or None if the name has another form.

    Raises:
        InputError: The joint is unknown, or is the root, whose placement has no effect.
    """
    word, _, kind = name.rpartition(".") if isinstance(name, str) else ("", "", "")
    if kind not in SIZES or not word:
        return None
    if kind == "lock":
        locked = system.contents.locked
        names = [] if locked is None else list(locked.names)
        if locked is not None and word in locked.frozen and word not in names:
            raise InputError(f"parameters: '{name}' does not vary: {locked.why_not(word)}")
        if word not in names:
            raise InputError(
                f"parameters: '{system.name}' has no locked joint {quoted(word)} whose value may "
                f"vary; {nearest(word, names)}such joints are {listed(names, 60) or 'none'}"
            )
        return JointParameter(name, word, kind)
    names = [str(joint) for joint in system.sorted_model.names][2:]
    if word not in names:
        hint = nearest(word, names)
        if word == system.root_name:
            hint = "that is the root, whose placement has no effect on the motion; "
        raise InputError(
            f"parameters: '{system.name}' has no joint {quoted(word)} with a placement on another "
            f"body; {hint}such joints are {listed(names, 60)}"
        )
    return JointParameter(name, word, kind)


class Joints:
    """Joint placements, and inertias attached to locked joints, as functions of joint parameters.

    Attributes:
        parameters: Joint parameters, in the order of their names.
        placed: Indices of the bodies whose joint placements depend on the parameters, sorted;
            0 is the root.
        turned: Bodies among `placed` whose joint axes the parameters rotate.
        free: Indices of the bodies whose inertias the parameters change.
        links: Link frames whose placements on their bodies depend on the parameters.
    """

    def __init__(self, system: System, names: Sequence[str]) -> None:
        """Select the joint parameters from a list of names.

        Args:
            system: Robot.
            names: Names of parameters of all kinds.
        Raises:
            InputError: Two parameters set the same placement.
        """
        self._system = system
        parameters = [joint_parameter(system, name) for name in names]
        self.parameters = tuple(entry for entry in parameters if entry is not None)
        self._by_body: dict[int, JointParameter] = {}
        self._locks = {e.joint: e.name for e in self.parameters if e.kind == "lock"}
        behind: set[int] = set()  # bodies whose joint placements depend on locked joints
        free: set[int] = set()
        if self._locks:
            for joint, (_, twists) in self._placements({}).items():
                if twists.keys() & self._locks.keys():
                    behind.add(self._body(joint))
            for i, place in self._locked.carried({}).items():
                heavy = self._locked.raw.inertias[i].mass > 0.0
                if heavy and place.twists.keys() & self._locks.keys():
                    free.add(self._body(place.joint))
        for parameter in self.parameters:
            if parameter.kind == "lock":
                continue
            body = self._body(parameter.joint)
            if body in behind:
                raise InputError(
                    f"parameters: '{parameter.name}' is determined by "
                    f"{', '.join(self._locks.values())}. Omit one of them."
                )
            if other := self._by_body.get(body):
                raise InputError(
                    f"parameters: '{parameter.name}' and '{other.name}' belong to the same "
                    "joint. Name one of them."
                )
            self._by_body[body] = parameter
        self.placed = tuple(sorted(behind | set(self._by_body)))
        self.turned = tuple(
            i for i in self.placed if i in behind or self._by_body[i].kind == "placement"
        )
        self.free = tuple(sorted(free))
        self._frames = (
            self._locked.frames(system.sorted_model, list(self._locks)) if self._locks else {}
        )
        self.links = tuple(sorted(self._frames))

    def own(self) -> dict[str, Array]:
        """Return the current values of the parameters in the system, {name: (size,)}."""
        values = {}
        for parameter in self.parameters:
            if parameter.kind == "lock":
                values[parameter.name] = np.array([self._locked.frozen[parameter.joint]])
                continue
            place = self._system.sorted_model.jointPlacements[self._body(parameter.joint) + 1]
            rpy = pin.rpy.matrixToRpy(place.rotation)
            values[parameter.name] = np.concatenate([place.translation, rpy])[: parameter.size]
        return values

    def perturbed(self, rng: np.random.Generator) -> dict[str, Array]:
        """Return random values that differ from those of the system."""
        return {
            name: value + rng.uniform(0.1, 0.4, len(value)) for name, value in self.own().items()
        }

    def placements(
        self, values: Mapping[str, Array], changed: Collection[str]
    ) -> Iterator[tuple[int, pin.SE3, dict[str, Array]]]:
        """Yield body index, joint placement, and its derivatives as twists, {name: (6, size)}.

        Derivatives are with respect to the parameters.  Twists are in the carrier's frame, at its
        origin.

        Args:
            values: Values of all parameters, {name: (size,)}.
            changed: Parameters that changed; only their bodies are yielded.  If one is the value of
                a locked joint, all bodies attached to locked joints are yielded.
        """
        has_locks = any(name in changed for name in self._locks.values())
        behind = self._placements(values) if has_locks else {}
        for i in self.placed:
            if parameter := self._by_body.get(i):
                if parameter.name in changed:
                    nominal = self._system.sorted_model.jointPlacements[i + 1]
                    yield (i, *_placement(nominal, parameter, values[parameter.name]))
            elif has_locks:
                place, twists = behind[str(self._system.sorted_model.names[i + 1])]
                yield i, place, self._by_parameter(twists)

    def inertias(
        self, values: Mapping[str, Array], changed: Collection[str]
    ) -> Iterator[tuple[int, Array, dict[str, Array]]]:
        """Yield body index, moments (10,) about the joint's origin, and derivatives (10, size).

        Args:
            values: Values of all parameters, {name: (size,)}.
            changed: Parameters that changed.  Nothing is yielded unless one of them is the value of
                a locked joint.
        """
        if not any(name in changed for name in self._locks.values()):
            return
        # A root that `load` added is not a joint of the raw model.
        added_root = not self._locked.raw.existJointName(self._system.root_name)
        lock_values = self._lock_values(values)
        for i in self.free:
            joint = "" if i == 0 and added_root else str(self._system.sorted_model.names[i + 1])
            J, slopes = self._locked.inertia(joint, lock_values)
            moments = {joint: moments_of(slopes[joint]) for joint in self._locks}
            yield i, moments_of(J), self._by_parameter(moments)

    def places(self, values: Mapping[str, Array]) -> dict[int, tuple[pin.SE3, dict[str, Array]]]:
        """Return the placements of `links` on their bodies, and their derivatives, {name: (6, 1)}.

        Derivatives with respect to the parameters are twists in the body's frame, at its origin.
        """
        if not self._frames:
            return {}
        raw, carried = self._locked.raw, self._locked.carried(self._lock_values(values))
        places = {}
        for k, frame in self._frames.items():
            under = carried[raw.frames[frame].parentJoint]
            placement = under.moved * raw.frames[frame].placement
            places[k] = placement, self._by_parameter(under.twists)
        return places

    @property
    def _locked(self) -> LockedJoints:
        locked = self._system.contents.locked
        assert locked is not None
        return locked

    def _by_parameter(self, columns: Mapping[str, Array]) -> dict[str, Array]:
        """Convert vectors {locked joint: (k,)} to columns {parameter name: (k, 1)}."""
        return {
            name: columns[joint][:, None] for joint, name in self._locks.items() if joint in columns
        }

    def _placements(
        self, values: Mapping[str, Array]
    ) -> dict[str, tuple[pin.SE3, Mapping[str, Array]]]:
        placements = self._locked.placements(self._lock_values(values))
        placements.pop(self._system.root_name, None)
        return placements

    def _lock_values(self, values: Mapping[str, Array]) -> dict[str, float]:
        return {
            joint: float(values[name][0]) for joint, name in self._locks.items() if name in values
        }

    def _body(self, joint: str) -> int:
        return int(self._system.sorted_model.getJointId(joint)) - 1 if joint else 0


def _placement(
    nominal: pin.SE3, parameter: JointParameter, value: Array
) -> tuple[pin.SE3, dict[str, Array]]:
    """Return a placement for a parameter value, and its derivatives as twists, (6, size)."""
    p = value[:3]
    twists = np.zeros((6, parameter.size))
    twists[:3, :3] = np.eye(3)
    if parameter.kind == "translation":
        return pin.SE3(nominal.rotation, p), {parameter.name: twists}
    roll, pitch, yaw = value[3:]
    R = pin.rpy.rpyToMatrix(roll, pitch, yaw)
    turn = pin.rpy.rpyToMatrix(0.0, 0.0, yaw)
    axes = np.transpose([
        turn @ pin.rpy.rpyToMatrix(0.0, pitch, 0.0) @ [1.0, 0.0, 0.0],
        turn @ [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
    ])  # fmt: skip
    twists[3:, 3:] = axes
    # Roll, pitch and yaw rotate the joint's frame about its own origin p.  The linear part at the
    # carrier's origin is therefore −ω × p.
    twists[:3, 3:] = -np.cross(axes.T, p).T
    return pin.SE3(R, p), {parameter.name: twists}
