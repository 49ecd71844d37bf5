"""Robot parameters by name: inertias, placements, values of locked joints, and gravity.

A placement describes the joint on its carrier, the body to which the joint is attached: origin x,
y, z [m], then roll, pitch, yaw [rad], as in a URDF file, in the frame of the carrier's joint.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import pinocchio as pin

from ..common.arrays import Array, entries_of, read_only
from ..common.errors import InputError, UnsupportedOperationError
from ..common.names import brief, listed, nearest, quoted
from .body_parameters import SIZES as BODY_SIZES
from .body_parameters import (
    Bodies,
    body_names,
    body_parameter,
    inertia_of,
    numbers,
    whole_body,
)
from .locked_joints import LockedJoints, moments_of
from .loops.loop import Loop
from .loops.loop_assembly import moving_joints
from .system import System, in_gravity, nominal, with_numbers

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


# Number of values of gravity, a vector in the world frame [m/s²], and of gravity.strength, its
# magnitude along the nominal direction [m/s²].
GRAVITY = {"gravity": 3, "gravity.strength": 1}
# {kind: larger kind that also sets this property}
_INCLUDED_IN = {"translation": "placement"} | {
    kind: "log_cholesky" for kind in BODY_SIZES if kind != "log_cholesky"
}
_HUGE = 1e100  # largest accepted value [kg, kg m², m, m/s²]; larger products overflow
_NONE: Mapping[str, Array] = MappingProxyType({})
_INERTIAL = ("mass", "com", "inertia")  # kinds that "all" includes for every body


def size_of(system: System, name: str) -> int | None:
    """Return the number of values of a robot parameter; None if the name has another form.

    Raises InputError for unknown bodies and joints.
    """
    if isinstance(name, str) and name in GRAVITY:
        return GRAVITY[name]
    parameter = body_parameter(system, name) or joint_parameter(system, name)
    return None if parameter is None else parameter.size


def plain_value(value: Array) -> float | Array:
    """Convert a value to the form that scenes show: a number or a read-only array."""
    return read_only(value.copy()) if value.size > 1 else float(value[0])


def kinds_near(system: System, name: object, known: Sequence[str] = ()) -> str:
    """Return a hint that lists the parameter names of a robot, with the nearest valid name first.

    Args:
        system: Robot.
        name: Unknown name.
        known: Additional valid names.
    """
    names = [f"{body}.{size}" for body in body_names(system) for size in BODY_SIZES]
    names += [
        f"{joint}.{place}" for joint in list(system.sorted_model.names)[2:] for place in PLACED
    ]
    locked = system.contents.locked
    names += [] if locked is None else [f"{joint}.lock" for joint in locked.names]
    hint = nearest(str(name), [*known, *GRAVITY, *names]) if isinstance(name, str) else ""
    return (
        f"{hint}the robot's parameters are {', '.join(f'LINK.{size}' for size in BODY_SIZES)}, "
        f"{', '.join(f'JOINT.{name}' for name in (*PLACED, 'lock'))}, {', '.join(GRAVITY)}"
    )


def joined(already: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Merge two parameter mappings; `given` overrides entries of `already` that it replaces."""
    values = {**already, **given}
    for name in already.keys() - given.keys():
        if any(
            name.endswith(f".{kind}") and name.removesuffix(kind) + larger in given
            for kind, larger in _INCLUDED_IN.items()
        ) or (name in GRAVITY and "gravity" in given):
            del values[name]
    return values


def with_parameters(system: System, parameters: Any) -> System:
    """Return the system with new parameter values; all other parameters keep their values.

    Raises:
        InputError: A name is unknown, or the values are not physical.
    """
    if not isinstance(parameters, Mapping):
        raise InputError(f"parameters must be {{name: value}}, got {brief(parameters)}")
    base, values = nominal(system), joined(system.parameters, parameters)
    varied = ModelParameters(base, list(values))
    for name in values:
        if name not in varied.names:
            raise InputError(f"parameters: there is no {brief(name)}; {kinds_near(base, name)}")
    return varied.system(varied.checked(values))


def all_names(system: System) -> list[str]:
    """Return the parameter names of all bodies (mass, com, inertia) and of all placements."""
    names = [str(name) for name in system.sorted_model.names]
    bodies = [i for i in range(1, len(names)) if system.sorted_model.inertias[i].mass > 0.0]
    words = [whole_body(system, i - 1) for i in bodies]
    inertial = [f"{word}.{kind}" for word in words for kind in _INERTIAL]
    return [*inertial, *(f"{name}.placement" for name in names[2:])]


def requested(system: System, parameters: Any) -> tuple[dict[str, Any], list[str]]:
    """Split requested parameters into values, and names that are not robot parameters.

    Args:
        system: Robot.
        parameters: {name: value}; or a list of names, which take the robot's values; or "all" for
            the robot's inertias and placements.
    Returns:
        Values, {name: value}, and the requested names that are not robot parameters.
    Raises:
        InputError: `parameters` has none of these forms.
    """
    if isinstance(parameters, Mapping):
        return dict(parameters), []
    takes_all = isinstance(parameters, str) and parameters == "all"
    names = all_names(system) if takes_all else entries_of(parameters)
    is_text = isinstance(parameters, str) and not takes_all
    if names is None or is_text or not all(isinstance(name, str) for name in names):
        raise InputError(
            "parameters must be {name: value}, a list of names, or 'all' for the robot's inertias "
            f"and placements, got {brief(parameters)}"
        )
    robot_names = [name for name in names if size_of(system, name) is not None]
    present = ModelParameters(system, robot_names).own()
    values = {
        name: present[name] if present[name].size > 1 else float(present[name][0])
        for name in robot_names
    }
    return values, [name for name in names if name not in robot_names]


class ModelParameters:
    """A robot as a function of its parameters.

    Attributes:
        names: Names of the parameters.
        sizes: Number of values by name.
        free: Indices of the bodies whose inertias vary; 0 is the root.
        placed: Indices of the bodies whose joint placements vary.
        turned: Bodies among `placed` whose joint axes rotate.
        links: Frames of links attached to locked joints, whose placements on their bodies vary.
        gravity: Whether gravity varies.
    """

    def __init__(self, system: System, names: Sequence[str]) -> None:
        """Select the parameters by name.

        Args:
            system: The robot.
            names: Names of the parameters.
        Raises:
            InputError: Two parameters set the same property, or a parameter would open a loop that
                couplings replace.
            UnsupportedOperationError: A parameter changes the lengths of a closed loop.
        """
        self._system = system
        self._bodies, self._joints = Bodies(system, names), Joints(system, names)
        self._gravity = [name for name in names if isinstance(name, str) and name in GRAVITY]
        if len(self._gravity) > 1:
            raise InputError("parameters: give gravity or gravity.strength, not both")
        self.gravity = bool(self._gravity)
        for parameter in self._bodies.parameters:
            if parameter.body in self._joints.free:
                raise InputError(
                    f"parameters: '{parameter.name}' belongs to a body whose inertia also "
                    "depends on the value of a locked joint. Omit one of these parameters."
                )
        self.sizes = {entry.name: entry.size for entry in self._bodies.parameters}
        self.sizes |= {entry.name: entry.size for entry in self._joints.parameters}
        self.sizes |= {name: GRAVITY[name] for name in self._gravity}
        self.names = tuple(self.sizes)
        self.free = tuple(sorted({*self._bodies.free, *self._joints.free}))
        self.placed, self.turned = self._joints.placed, self._joints.turned
        self.links = self._joints.links
        self._refuse_in_loops()

    def _refuse_in_loops(self) -> None:
        """Reject parameters that change the lengths of loops."""
        system = self._system
        moved_bodies, links = {body + 1 for body in self.placed}, {*self.links}
        for loop in (*system.loops, *system.contents.coupled_loops):
            ends = {loop.frame_a, loop.frame_b} if isinstance(loop, Loop) else set()
            fixed = loop in system.loops and not isinstance(loop, Loop)
            if fixed or not (moving_joints(system, loop) & moved_bodies or ends & links):
                continue
            names = listed([name for name in self.names if "." in name], 6)
            if loop in system.loops:
                raise UnsupportedOperationError(
                    f"parameters: {names} change the lengths of the closed loop "
                    f"{quoted(loop.name)}, which would have to be assembled again. Load the robot "
                    "with other placements, or vary masses, centres and inertias."
                )
            raise InputError(
                f"parameters: {names}: loop {quoted(loop.name)} is a coupling for the "
                "placements in the file, so they cannot vary. Load the robot with other placements."
            )

    def own(self) -> dict[str, Array]:
        """Return the current values of the parameters in the system, {name: (size,)}."""
        values = self._bodies.own() | self._joints.own()
        if self._gravity:
            g = self._system.gravity
            is_vector = self._gravity == ["gravity"]
            values[self._gravity[0]] = g if is_vector else np.array([float(np.linalg.norm(g))])
        return values

    def checked(
        self, given: Mapping[str, Any], known: Mapping[str, Array] = _NONE
    ) -> dict[str, Array]:
        """Return validated, read-only values of all parameters.

        Args:
            given: Values by name.
            known: Already validated values of the other parameters.
        Returns:
            {name: (size,)}.
        Raises:
            InputError: The values are not physical.
        """
        values = {
            name: read_only(numbers(given[name], name, size))
            for name, size in self.sizes.items()
            if name in given
        }
        for body in self._bodies.changed_by(given):
            self._bodies.dynamic(body, {**known, **values})
        for name, value in values.items():
            if np.abs(value).max() > _HUGE:
                raise InputError(
                    f"parameters: '{name}' is above {_HUGE:g}, so that products overflow; use "
                    "other units"
                )
        if self._gravity == ["gravity.strength"] and not self._system.gravity.any():
            raise InputError(
                f"parameters: '{self._system.name}' has zero gravity, so "
                "'gravity.strength' has no direction to scale; give the vector 'gravity'"
            )
        return {name: values[name] if name in values else known[name] for name in self.names}

    def inertias(
        self, values: Mapping[str, Array], changed: Collection[str] | None = None
    ) -> dict[int, tuple[Array, dict[str, Array]]]:
        """Return {body: (moments (10,), derivatives {parameter name: (10, size)})}.

        Moments are about the joint's origin: mass m, first moment m c, then second moments xx, xy,
        xz, yy, yz, zz.

        Args:
            values: Values of all parameters, {name: (size,)}.
            changed: Parameters whose bodies are returned; None for all.
        """
        names = self.sizes if changed is None else changed
        bodies = {i: self._bodies.dynamic(i, values) for i in self._bodies.changed_by(names)}
        for i, moments, slopes in self._joints.inertias(values, names):
            bodies[i] = moments, slopes
        return dict(sorted(bodies.items()))

    def body_rows(
        self, changes: Mapping[str, Array], values: Mapping[str, Array]
    ) -> tuple[dict[int, Array], dict[int, str]] | None:
        """Return the moments of bodies for many values of their parameters.

        Args:
            changes: Changed values, {name: (N, size)}.
            values: Values of all parameters, {name: (size,)}, for those that do not change.
        Returns:
            {body: (N, 10)} as `inertias`, and {row: reason} of the rows that are not physical; or
            None if a change is not of a body's mass, centre, inertia or payload.
        """
        return self._bodies.rows(changes, values)

    def placements(
        self, values: Mapping[str, Array], changed: Collection[str] | None = None
    ) -> dict[int, tuple[pin.SE3, dict[str, Array]]]:
        """Return {body: (joint placement, derivatives {parameter name: (6, size)})}.

        Derivatives are twists in the carrier's frame, at its origin.

        Args:
            values: Values of all parameters, {name: (size,)}.
            changed: Parameters whose bodies are returned; None for all.
        """
        names = self.sizes if changed is None else changed
        return {i: (place, twists) for i, place, twists in self._joints.placements(values, names)}

    def places(self, values: Mapping[str, Array]) -> dict[int, tuple[pin.SE3, dict[str, Array]]]:
        """Return {frame: (placement on its body, derivatives {parameter name: (6, size)})}.

        Derivatives are twists in the body's frame, at its origin.
        """
        return self._joints.places(values)

    def gravity_of(self, values: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return gravity in the world frame, (3,), and {parameter name: derivatives (3, size)}."""
        g = self._system.gravity
        if not self._gravity:
            return g, np.zeros((3, 0))
        value = values[self._gravity[0]]
        if self._gravity == ["gravity"]:
            return value, np.eye(3)
        unit = g / np.linalg.norm(g)
        return value[0] * unit, unit[:, None]

    def system(self, values: Mapping[str, Array]) -> System:
        """Return a copy of the system with these parameter values."""
        if not self.names:
            return self._system
        inertias = {i + 1: inertia_of(moments) for i, (moments, _) in self.inertias(values).items()}
        places = {i + 1: place for i, (place, _) in self.placements(values).items()}
        frames = {k: place for k, (place, _) in self.places(values).items()}
        other = with_numbers(self._system, inertias, places, frames)
        if self._gravity:
            other = in_gravity(other, self.gravity_of(values)[0])
        vars(other)["_parameters"] = {name: plain_value(values[name]) for name in self.names}
        return other

    def perturbed(self, rng: np.random.Generator) -> dict[str, Array]:
        """Return random parameter values that differ from the values of the system."""
        values = self._bodies.perturbed(rng) | self._joints.perturbed(rng)
        return values | {name: 1.3 * self.own()[name] for name in self._gravity}

    def gravity_name(self) -> str:
        """Return the name of the parameter that varies gravity, or ""."""
        return self._gravity[0] if self._gravity else ""
