"""Replace hinge triples by balls, which have no gimbal lock (see hinge_triples)."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from ..common.arrays import Array, entries_of
from ..common.errors import InputError, ModelError
from ..common.names import brief, listed, quoted
from ..common.parameter import Parameter, value_of
from .coordinates import InitialState
from .copy_model import NewJoint, rebuild
from .force_interface import Force
from .hinge_triples import HingeTriple, hinge_triples
from .joints import root_chain
from .locked_joints import LockValue, lock_attitude
from .passive import MERGED, Damper, Friction, JointForce, Spring
from .robot_file_contents import Coupling, LeftOut

LIMITS = "limits of merged hinges"  # kind of actions that are not simulated (LeftOut.what)


def requested_balls(balls: bool | Iterable[str]) -> bool | tuple[str, ...]:
    """Return the option balls of `load` as True, False or names.  Raises InputError."""
    if isinstance(balls, bool):
        return balls
    names = None if isinstance(balls, str) else entries_of(balls)
    if names is None or not all(isinstance(name, str) for name in names):
        raise InputError(
            "balls must be True, False, or a list of names of balls or of their hinges, got "
            f"{brief(balls)}"
        )
    return tuple(dict.fromkeys(names))


@dataclass(frozen=True, eq=False)
class Merge:
    """Hinge triples that become balls.

    Attributes:
        triples: The triples.
        skipped: Triples that move like balls and stay hinges, because their values differ.
    """

    triples: tuple[HingeTriple, ...] = ()
    skipped: tuple[HingeTriple, ...] = ()

    @property
    def hinges(self) -> frozenset[str]:
        """Names of the hinges that became balls."""
        return frozenset(name for triple in self.triples for name in triple.hinges)

    def model(self, raw: pin.Model) -> pin.Model:
        """Return a copy of a model with these balls; `raw` itself if there are none.

        Frames of the hinges, and of the bodies between them, are left out.

        Args:
            raw: Model with the hinges.
        """
        if not self.triples:
            return raw
        frozen: dict[int, Array] = {}
        replaced: dict[int, list[NewJoint]] = {}
        without: set[int] = set()
        neutral = pin.neutral(raw)
        for triple in self.triples:
            *inner, last = (raw.getJointId(name) for name in triple.hinges)
            for i in inner:
                joint = raw.joints[i]
                frozen[i] = neutral[joint.idx_q : joint.idx_q + joint.nq]
            replaced[last] = [_ball(raw, triple)]
            for number, frame in enumerate(raw.frames):
                is_own = frame.parentJoint == last and frame.type == pin.FrameType.JOINT
                if frame.parentJoint in inner or is_own:
                    without.add(number)
        return rebuild(raw, frozen=frozen, replaced=replaced, without_frames=without)

    def values(
        self, x: Mapping[str, Array], xdot: Mapping[str, Array]
    ) -> tuple[dict[str, Array], dict[str, Array]]:
        """Convert coordinates and rates of joints, {joint: array}, to those with these balls."""
        x, xdot = dict(x), dict(xdot)
        for triple in self.triples:
            angles = np.concatenate([x[name] for name in triple.hinges])
            rates = np.concatenate([xdot[name] for name in triple.hinges])
            x = _exchanged(x, triple, triple.attitude(angles))
            xdot = _exchanged(xdot, triple, triple.rate(angles, rates))
        return x, xdot

    def initial(self, state: InitialState, names: Sequence[str]) -> InitialState:
        """Return an initial state with these balls.

        Args:
            state: State of hinges and slides.
            names: Names of the hinges and slides, (m,).
        """
        if not self.triples:
            return state
        x, xdot = (dict(zip(names, v[:, None], strict=True)) for v in (state.x, state.xdot))
        x, xdot = self.values(x, xdot)
        return replace(
            state, x=np.concatenate([*x.values()]), xdot=np.concatenate([*xdot.values()])
        )

    def with_hinges(self, names: Iterable[str]) -> list[str]:
        """Return names of joints, with the hinges of each of these balls in its place."""
        hinges = {triple.name: triple.hinges for triple in self.triples}
        return [hinge for name in names for hinge in hinges.get(name, (name,))]

    def limits(self, raw: pin.Model) -> tuple[LeftOut, ...]:
        """Return the limits of the hinges that became balls, which a ball does not have."""
        names = []
        for name in (name for triple in self.triples for name in triple.hinges):
            k = raw.joints[raw.getJointId(name)].idx_q
            limits = (raw.lowerPositionLimit[k], raw.upperPositionLimit[k])
            if raw.joints[raw.getJointId(name)].nq == 1 and np.isfinite(limits).any():
                names.append(name)
        return (LeftOut(LIMITS, tuple(names)),) if names else ()

    def forces(self, passive: Iterable[Force]) -> tuple[Force, ...]:
        """Return the forces that act on none of these balls."""
        merged = self.hinges
        return tuple(
            force
            for force in passive
            if not (isinstance(force, JointForce) and force.joint in merged)
        )

    def left_out(self, passive: Iterable[Force]) -> tuple[LeftOut, ...]:
        """Return the forces at the hinges that became balls, which are not simulated."""
        words = actions_of(passive)
        names = [
            f"{triple.name} ({', '.join(words[triple.hinges[0]])})"
            for triple in self.triples
            if triple.hinges[0] in words
        ]
        return (LeftOut(MERGED, tuple(names)),) if names else ()

    def warnings(self, raw: pin.Model) -> tuple[str, ...]:
        """Return warnings about armature, and about triples that stay hinges."""
        rotors = [
            triple.name
            for triple in self.triples
            if raw.armature[raw.joints[raw.getJointId(triple.hinges[0])].idx_v]
        ]
        warnings = [
            f"hinges {listed(triple.hinges, 3)} stay hinges, although balls=True: {triple.why_not}"
            for triple in self.skipped
        ]
        if rotors:
            warnings.append(
                f"the armature of merged hinges acts about all axes of the balls {listed(rotors)}; "
                "on the hinges it acts about their axes, which are at right angles only where the "
                "second hinge is at zero"
            )
        return tuple(warnings)


def _exchanged(entries: dict[str, Array], triple: HingeTriple, value: Array) -> dict[str, Array]:
    """Return entries with the value of a ball in the place of its first hinge."""
    exchanged = {}
    for name, entry in entries.items():
        if name == triple.hinges[0]:
            exchanged[triple.name] = value
        elif name not in triple.hinges:
            exchanged[name] = entry
    return exchanged


def _ball(raw: pin.Model, triple: HingeTriple) -> NewJoint:
    """Return the ball of a triple: its frame is that of the last hinge at zero, at the centre."""
    at = pin.SE3(np.eye(3), triple.centre)
    rotor = raw.armature[raw.joints[raw.getJointId(triple.hinges[0])].idx_v]
    return NewJoint(
        triple.name,
        pin.JointModelSpherical(),
        at,
        armature=np.full(3, rotor),
        body=at.inverse(),
    )


def actions_of(passive: Iterable[Force]) -> dict[str, tuple[str, ...]]:
    """Return the springs, dampers and friction at each joint, in words that can be compared."""
    words: dict[str, tuple[str, ...]] = {}
    for force in passive:
        if isinstance(force, JointForce):
            words[force.joint] = (*words.get(force.joint, ()), _strength(force))
    return words


def _strength(force: JointForce) -> str:
    """Return the kind and the coefficients of a force, without a spring's rest position."""
    values: list[float | Parameter] = []
    if isinstance(force, Spring):
        values = [force.stiffness, *force.polynomial]
    elif isinstance(force, Damper):
        values = [force.coefficient, *force.polynomial]
    elif isinstance(force, Friction):
        values = [force.most]
    return " ".join([force.kind, *(f"{value_of(value):g}" for value in values)])


def coupled_joints(couplings: Iterable[Coupling]) -> set[str]:
    """Return the names of followers and leaders."""
    return {name for coupling in couplings for name in (coupling.follower, *coupling.leaders)}


def merge_of(
    raw: pin.Model,
    balls: bool | tuple[str, ...],
    *,
    passive: Sequence[Force] = (),
    kept: Collection[str] = (),
) -> Merge:
    """Return the hinge triples of a model that `load(balls=…)` turns into balls.

    Args:
        raw: Model of hinges, slides and balls.
        balls: True for all triples that can be merged, or names of balls or of their hinges.
        passive: Springs, dampers and friction at joints.
        kept: Joints that must stay, because they are locked or coupled.
    Returns:
        The merge.
    Raises:
        InputError: A name is unknown.
        ModelError: Hinges that were named cannot become a ball.
    """
    if balls is False or balls == ():
        return Merge()
    triples = hinge_triples(raw, kept, actions_of(passive))
    free = [triple for triple in triples if not triple.why_not]
    if balls is True:
        used = {name for triple in free for name in triple.hinges}
        alike = [t for t in triples if t.difference and not t.obstacle]
        skipped = [t for t in alike if used.union(kept).isdisjoint(t.hinges)]
        return Merge(tuple(free), tuple(skipped))
    chosen = {_named(raw, triples, name).hinges for name in balls if not _is_ball(raw, name)}
    return Merge(tuple(triple for triple in free if triple.hinges in chosen))


def _is_ball(raw: pin.Model, name: str) -> bool:
    """Return whether a joint is a ball already."""
    return name in list(raw.names) and raw.joints[raw.getJointId(name)].nq == 4


def _named(raw: pin.Model, triples: Sequence[HingeTriple], name: str) -> HingeTriple:
    """Return the triple with the name of its ball or of a hinge.  Raises PinredError."""
    of_name = [triple for triple in triples if name == triple.name or name in triple.hinges]
    for triple in of_name:
        if not triple.why_not:
            return triple
    valid = [triple.name for triple in triples if not triple.why_not]
    listing = f"balls can be {listed(valid, 40)}" if valid else "no three hinges can become a ball"
    if of_name:
        # Prefer the triple that has this name, or begins with this hinge.
        triple = min(of_name, key=lambda t: (t.name != name, t.hinges[0] != name))
        raise ModelError(
            f"balls: hinges {listed(triple.hinges, 3)} cannot become a ball, because "
            f"{triple.why_not}; or leave the name out ({listing})"
        )
    if name not in list(raw.names)[1:]:
        raise InputError(f"balls: no ball or hinge {quoted(name)}; {listing}")
    chain = root_chain(raw)
    is_root = raw.getJointId(name) <= (1 if chain is None else chain.last)
    why = "moves the root" if is_root else "is not one of three consecutive hinges"
    raise ModelError(f"balls: joint {quoted(name)} {why}; {listing}")


def locked_hinges(
    raw: pin.Model, balls: bool | tuple[str, ...], lock: Mapping[str, LockValue]
) -> tuple[dict[str, LockValue], bool | tuple[str, ...]]:
    """Replace each ball to lock by its hinges, which then stay hinges.

    A value for a hinge takes precedence over that of its ball.

    Args:
        raw: Model with the hinges.
        balls: See `merge_of`.
        lock: Values of joints or balls to lock.
    Returns:
        Values of joints of `raw` to lock, and `balls` without the names of balls that are locked.
    Raises:
        InputError: A ball has a number other than zero.
    """
    if balls is False:
        return dict(lock), balls
    names = list(raw.names)
    triples = {triple.name: triple for triple in hinge_triples(raw) if not triple.why_not}
    values: dict[str, LockValue] = {}
    hinges: dict[str, LockValue] = {}
    for name, value in lock.items():
        # A ball may have the name of its first hinge, which a number then locks.
        is_joint = name in names and not isinstance(value, tuple)
        if is_joint or name not in triples:
            values[name] = value
            continue
        triple = triples[name]
        attitude = lock_attitude(name, value, f"; or lock its hinges: {listed(triple.hinges)}")
        # The identity has the angles zero, without round-off.
        angles = triple.angles(attitude) if attitude[:3].any() else np.zeros(3)
        hinges |= dict(zip(triple.hinges, angles.tolist(), strict=True))
    if not isinstance(balls, bool):
        balls = tuple(name for name in balls if name not in lock or name in names)
    return hinges | values, balls
