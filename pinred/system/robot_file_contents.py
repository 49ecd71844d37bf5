"""The source of a robot, and the contents of its file other than bodies and joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import partial
from types import MappingProxyType
from typing import Any

import pinocchio as pin

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, FrozenArrays
from ..common.names import plain
from .find_robot_files import Visuals
from .force_interface import Force
from .hinge_triples import HingeTriple
from .locked_joints import LockedJoints, LockValue
from .loops.loop import Constraint


@checks_arguments
@dataclass(frozen=True)
class Actuator:
    """An actuator at a joint, as in MuJoCo.

    Its length is l = gear·x, with rate v.  With the control u, clamped to its limits, the force is

        f = (g₀ + g₁ l + g₂ v) u + b₀ + b₁ l + b₂ v,

    clamped to its limits.  The torque at the joint is gear·f.  At a ball, x is the rotation vector
    of the child relative to the parent, and l̇ is gear·ω.

    Attributes:
        name: Name of the actuator.
        joint: Name of its joint.
        kind: "motor" (f = g₀ u), "position" (f = g₀ u + b₁ l + b₂ v with b₁ = −g₀), "velocity"
            (f = g₀ (u − v)), "damper" (f = g₂ v u), or "general".
        gear: Factors of the force, (1,), or about the axes of a ball, (3,).
        gain: Gain (g₀, g₁, g₂).
        bias: Bias (b₀, b₁, b₂).
        control_limits: Smallest and largest control, or None.
        force_limits: Smallest and largest force f, or None.
        torque_limits: Smallest and largest sum of the torques of all actuators at the joint
            [N·m | N], or None.
        in_parent: Whether the gear of a ball has the axes of the parent instead of the child.
        on_base: Whether the joint moves the base.
    """

    name: str
    joint: str
    gear: tuple[float, ...] = (1.0,)
    gain: tuple[float, float, float] = (1.0, 0.0, 0.0)
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    control_limits: tuple[float, float] | None = None
    force_limits: tuple[float, float] | None = None
    torque_limits: tuple[float, float] | None = None
    in_parent: bool = False
    on_base: bool = False

    @property
    def kind(self) -> str:
        """The element of MJCF that has this gain and bias."""
        (g0, g1, g2), (b0, b1, b2) = self.gain, self.bias
        if (g1, g2, b0) == (0.0, 0.0, 0.0):
            if b1 == b2 == 0.0:
                return "motor"
            if b1 == -g0 and b2 <= 0.0:
                return "position"
            if b1 == 0.0 and b2 == -g0:
                return "velocity"
        elif g0 == g1 == 0.0 and self.bias == (0.0, 0.0, 0.0):
            return "damper"
        return "general"

    def __str__(self) -> str:
        gear = " ".join(f"{value:g}" for value in self.gear)
        limits = [
            f"{what} from {limits[0]:g} to {limits[1]:g}"
            for what, limits in (
                ("control", self.control_limits),
                ("force", self.force_limits),
                ("torque", self.torque_limits),
            )
            if limits is not None
        ]
        return ", ".join([f"{self.name}: {self.kind} at {self.joint}, gear {gear}", *limits])


@dataclass(frozen=True, eq=False)
class Derivation:
    """How a system was made from others; see `derived_systems`.

    Attributes:
        function: Name of the function.
        systems: The other systems.
        arguments: Texts and numbers that the function takes, by name.
        doubts: Warnings about inertias, if they follow from those about the other systems; None
            if the model must be searched for them.
        closed: Values of joints at a closed shape, by name, if the systems have loops.
    """

    function: str
    systems: tuple[Any, ...]  # of System, which has an Origin and so imports this module
    arguments: Mapping[str, Any]
    doubts: tuple[str, ...] | None = None
    closed: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Origin:
    """The file or name from which a system was loaded.

    Attributes:
        source: Name of the robot, or absolute path of its file; "" if `text` is set.
        lock: Values of the locked joints as requested, {joint: value}.
        root: Body of an MJCF file that was chosen as the root, if any.
        meshes: Additional folders in which meshes are searched; the folders above the file are
            always searched.
        text: Content of the file, if the robot was loaded from a text.
        derivation: How the system was made from others, if it was; `source` is "".
    """

    source: str
    lock: Mapping[str, LockValue]
    root: str | None = None
    meshes: tuple[str, ...] = ()
    text: str | None = None
    derivation: Derivation | None = None


@dataclass(frozen=True, eq=False)
class Keyframe(FrozenArrays):
    """A named state in a robot file.  The arrays are read-only.

    Attributes:
        pose: Pose of the base, (size,).
        x: Shape, (m,) [rad | m].
        xi: Body twist of the base [linear; angular], (r,).
        xdot: Shape rate, (m,) [rad/s | m/s].
        time: Time [s].
        controls: Controls of actuators by name (see Scene.controls).
    """

    pose: Array
    x: Array
    xi: Array
    xdot: Array
    time: float = 0.0
    controls: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Coupling:
    """A joint that follows others: x_follower = Σ ratio · x_leader + offset.

    All x are shape coordinates, not displacements from a reference position.

    Attributes:
        follower: Name of the follower joint.
        ratios: Ratio of the follower's rate to the rate of each leader, {leader: ratio}.
        offset: Value of the follower when all leaders are at zero [rad | m].
    """

    follower: str
    ratios: Mapping[str, float]
    offset: float

    @property
    def leaders(self) -> tuple[str, ...]:
        """Names of the joints that the follower follows."""
        return tuple(self.ratios)

    def __str__(self) -> str:
        terms = [f"{ratio:g}·{leader}" for leader, ratio in self.ratios.items()]
        law = " + ".join(terms).replace("+ -", "- ")
        shift = "" if self.offset == 0.0 else f" {'+-'[self.offset < 0]} {abs(self.offset):g}"
        return f"{self.follower} = {law}{shift}"


@dataclass(frozen=True)
class LeftOut:
    """Actions of one kind in a robot file that pinred does not simulate.

    Attributes:
        what: Kind of action, such as "actuators".
        names: Names of the actions.
        demanded: Whether loading emits no warning: limits, which a simulation reports that exceeds
            them, and plugins that wait for commands.
    """

    what: str
    names: tuple[str, ...]
    demanded: bool = False

    def __str__(self) -> str:
        return f"{self.what}: {shortened(self.names)}"


@dataclass(frozen=True)
class Contents:
    """Contents of a robot file other than bodies and joints.

    Attributes:
        left_out: Actions that are not simulated, by kind.
        passive: Springs, dampers and dry friction at shape joints.  They act only in
            scenes with passive=True.
        actuators: Actuators whose forces are linear.  They act only in scenes with controls.
        keyframes: Named states.
        couplings: Couplings of follower joints to their leaders.
        freed: Name of a body that the file fixes to the world but that floats in pinred, or "".
        warnings: Warnings about parts of the file that are not read as written.
        visuals: Shapes for playback that were passed to `load` together with the model.
        locked: The locked joints; None if no joint was locked.
        merged: Hinges that became balls.
        loops: Constraints that close kinematic loops.
        coupled_loops: Loops that couplings replace, because their closed shapes are linear in
            independent joints.
        links: Inertia of each link with mass, in its own frame; links fixed to each other are
            merged in the model.
    """

    left_out: tuple[LeftOut, ...] = ()
    passive: tuple[Force, ...] = ()
    actuators: tuple[Actuator, ...] = ()
    keyframes: Mapping[str, Keyframe] = field(default_factory=partial(MappingProxyType, {}))
    couplings: tuple[Coupling, ...] = ()
    freed: str = ""
    warnings: tuple[str, ...] = ()
    visuals: Visuals | None = None
    locked: LockedJoints | None = None
    merged: tuple[HingeTriple, ...] = ()
    loops: tuple[Constraint, ...] = ()
    coupled_loops: tuple[Constraint, ...] = ()
    links: Mapping[str, pin.Inertia] = field(default_factory=partial(MappingProxyType, {}))

    def __reduce__(self) -> tuple[Any, ...]:
        # Read-only views of mappings cannot be pickled.
        values = [getattr(self, entry.name) for entry in fields(self)]
        return type(self), tuple(dict(v) if isinstance(v, MappingProxyType) else v for v in values)


def shortened(names: tuple[str, ...], most: int = 6) -> str:
    """Return a list of names in words; after the first `most` names only the total count."""
    shown = ", ".join(map(plain, names[:most]))
    return shown if len(names) <= most else f"{shown}, … ({len(names)} in all)"
