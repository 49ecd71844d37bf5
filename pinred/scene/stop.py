"""Joint stops: bounds of joint positions at which joints bounce or come to rest.

Internally, every stop bounds an independent joint: the stop of a follower is moved to its leader.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array
from ..common.errors import InputError
from ..common.names import brief, listed, nearest, quoted
from ..system.loops.kinematics import on_surfaces
from ..system.loops.loop import BallSurface, Constraint, JointPolynomial
from ..system.merge_hinges import LIMITS as LIMITS_OF_HINGES
from ..system.passive import UNLIMITED, angles_of_balls, limits_of
from ..system.system import System
from .toml.schema import ByName, Either, Key, ListOf, Table, Text
from .toml.value_tables import NUMBER, POSITIVE

FILE = "file"  # value of the option for the limits of the robot's file
STOP_TABLE = Table(
    {
        "lower": Key(NUMBER, "lower stop [rad | m]", default="none"),
        "upper": Key(NUMBER, "upper stop [rad | m]", default="none"),
        "restitution": Key(NUMBER, "ratio of rates after and before", default="0; 1 for balls"),
        "rest_rate": Key(
            POSITIVE, "rebound below which a joint rests [rad/s | m/s]", default="1e-06"
        ),
        "angle": Key(POSITIVE, "largest angle of a ball [rad]", default="none"),
        "swing": Key(POSITIVE, "largest tilt of the axis of a ball [rad]", default="none"),
        "twist": Key(ListOf(NUMBER, 2), "lower and upper twist of a ball [rad]", default="none"),
        "axis": Key(ListOf(NUMBER, 3), "axis of swing and twist of a ball", default="[0, 0, 1]"),
    },
    "a stop",
)  # fmt: skip
STOPS = Either((Text((FILE,)), ByName(Either((ListOf(NUMBER), STOP_TABLE)))))
_UNDEFINED = 1e-6  # Cosine of half the swing below which a twist is not defined.
_WITHIN = 1e-12  # Distance beyond a stop that counts as round-off of an initial shape [rad | m].


@checks_arguments
@dataclass(frozen=True)
class Stop:
    """The stops of one joint.

    At a stop, the joint bounces back with `restitution` times its rate. Without restitution, it
    comes to rest, and leaves the stop when the reaction of the stop would pull. Rebounds become
    shorter and shorter. If a rebound is slower than `rest_rate`, does not leave the stop by more
    than the tolerance of the scene, and the forces push the joint back, then the joint rests. The
    table of impacts contains the energy that this removes.

    Attributes:
        lower: Smallest position [rad | m]; −inf for none.
        upper: Largest position [rad | m]; inf for none.
        restitution: Ratio of the rates after and before an impact, from 0 to 1.
        rest_rate: Largest rate of a rebound that may be replaced by rest [rad/s | m/s].
    """

    lower: float = -math.inf
    upper: float = math.inf
    restitution: float = 0.0
    rest_rate: float = 1e-6

    def __post_init__(self) -> None:
        for name in ("lower", "upper", "restitution", "rest_rate"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
                raise InputError(f"{name} of a stop: expected a number, got {brief(value)}")
            object.__setattr__(self, name, float(value))
        if not self.lower < self.upper:
            raise InputError(
                f"expected lower < upper, got {self.lower:g} and {self.upper:g}. Swap them, "
                "or lock the joint when the robot is loaded (lock=)"
            )
        if math.isinf(self.lower) and math.isinf(self.upper):
            raise InputError(
                "expected a finite lower or upper stop, got none. Omit the joint instead"
            )
        if not 0.0 <= self.restitution <= 1.0:
            raise InputError(
                f"restitution: expected a number from 0 (rest) to 1 (no loss), got "
                f"{self.restitution:g}"
            )
        if not (0.0 < self.rest_rate < math.inf):
            raise InputError(
                f"rest_rate: expected a positive rate [rad/s | m/s], got {self.rest_rate:g}"
            )


@checks_arguments
@dataclass(frozen=True)
class BallStop:
    """The stops of a ball joint: bounds of its angle, its swing and its twist.

    The attitude R of the child in the parent is a twist about `axis`, followed by a swing that
    tilts this axis by the shortest way. A ball at rest at its stop moves on a surface of attitudes,
    such as a cone, and leaves it when the reaction of the stop would pull; see Stop for rebounds.

    Attributes:
        angle: Largest angle of the whole rotation, below π [rad]; inf for none.
        swing: Largest angle between the axis in the child and in the parent, below π [rad]; inf
            for none.
        twist: Smallest and largest angle about the axis, within ±π [rad]; infinite for none.
        axis: Axis of swing and twist, in both bodies, (3,), of any length.
        restitution: Ratio of the rates after and before an impact, from 0 to 1.
        rest_rate: Largest rate of a rebound that may be replaced by rest [rad/s].
    """

    angle: float = math.inf
    swing: float = math.inf
    twist: tuple[float, float] = (-math.inf, math.inf)
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    restitution: float = 1.0
    rest_rate: float = 1e-6

    def __post_init__(self) -> None:
        twist, axis = (tuple(map(float, values)) for values in (self.twist, self.axis))
        length = math.hypot(*axis)
        if len(axis) != 3 or not 0.0 < length < math.inf:
            raise InputError(f"axis: expected three numbers that are not all 0, got {brief(axis)}")
        for name in ("angle", "swing"):
            if not (0.0 < getattr(self, name) < math.pi or getattr(self, name) == math.inf):
                raise InputError(
                    f"{name}: expected an angle between 0 and π, got {getattr(self, name):g}. Omit "
                    "it for none"
                )
        inside = len(twist) == 2 and -math.pi < twist[0] < twist[1] < math.pi
        if not inside and twist != (-math.inf, math.inf):
            raise InputError(
                f"twist: expected (lower, upper) within ±π, got {brief(twist)}. Omit it for none"
            )
        if math.isinf(self.angle) and math.isinf(self.swing) and all(map(math.isinf, twist)):
            raise InputError("expected a finite angle, swing or twist, got none. Omit the joint")
        if not 0.0 <= self.restitution <= 1.0:
            raise InputError(
                f"restitution: expected a number from 0 (rest) to 1 (no loss), got "
                f"{self.restitution:g}"
            )
        if not (0.0 < self.rest_rate < math.inf):
            raise InputError(f"rest_rate: expected a positive rate, got {self.rest_rate:g}")
        object.__setattr__(self, "twist", twist)
        object.__setattr__(self, "axis", tuple(a / length for a in axis))


@dataclass(frozen=True)
class Bound:
    """One side of the stops of an independent joint, s (x − position) ≥ 0.

    Attributes:
        joint: Name of the joint that has the stop, perhaps a follower.
        x: Index of the independent coordinate.
        v: Index of the independent rate.
        sign: s: 1 for a lower bound, −1 for an upper one.
        position: Position of the independent joint at the stop [rad | m].
        ratio: Rate of the joint with the stop, per rate of the independent joint; 1 unless it
            follows.
        stop: The stop.
    """

    joint: str
    x: int
    v: int
    sign: float
    position: float
    ratio: float
    stop: Stop | BallStop

    @property
    def surface(self) -> Constraint | None:
        """The constraint of a joint at rest; None for a hinge or slide, which is locked then."""
        return None

    @property
    def rates(self) -> tuple[int, ...]:
        """Indices of the independent rates that move the joint."""
        return (self.v,)

    @property
    def side(self) -> str:
        """Side of the joint that has the stop, "lower" or "upper"."""
        return "lower" if self.sign * self.ratio > 0.0 else "upper"

    def values(self, x: Array) -> Array:
        """Return the bounded values, (…), at shapes x (…, nx) [rad | m]."""
        return np.asarray(x[..., self.x])

    def normal(self, x: Array, m: int) -> Array:  # noqa: ARG002
        """Return the rates of the gap per rate of the shape, (m,), at shape x (nx,)."""
        gradient = np.zeros(m)
        gradient[self.v] = self.sign
        return gradient

    def normal_rate(self, x: Array, xdot: Array) -> Array:  # noqa: ARG002
        """Return the time derivative of the normal at shape rate xdot (m,), (m,)."""
        return np.zeros(len(xdot))


@dataclass(frozen=True)
class SumBound(Bound):
    """One side of the stops of a joint that follows several hinges and slides.

    The bounded value is that of the joint itself; `x` and `v` are those of its first leader.

    Attributes:
        terms: Index of the coordinate, index of the rate, and ratio of each leader.
        offset: Value of the joint with all leaders at zero [rad | m].
        leader: Name of the first leader.
    """

    terms: tuple[tuple[int, int, float], ...] = ()
    offset: float = 0.0
    leader: str = ""

    @property
    def surface(self) -> JointPolynomial:
        """The shapes with the joint at its stop: a polynomial of degree zero."""
        return JointPolynomial(self.joint, self.leader, (self.position,))

    @property
    def rates(self) -> tuple[int, ...]:
        """Indices of the independent rates that move the joint."""
        return tuple(v for _, v, _ in self.terms)

    def values(self, x: Array) -> Array:
        """Return the bounded values, (…), at shapes x (…, nx) [rad | m]."""
        return np.asarray(sum(ratio * x[..., k] for k, _, ratio in self.terms) + self.offset)

    def normal(self, x: Array, m: int) -> Array:  # noqa: ARG002
        """Return the rates of the gap per rate of the shape, (m,), at shape x (nx,)."""
        gradient = np.zeros(m)
        for _, v, ratio in self.terms:
            gradient[v] = self.sign * ratio
        return gradient


@dataclass(frozen=True)
class BallBound(Bound):
    """One bound of a ball joint; `x` and `v` are its first coordinate and rate.

    Attributes:
        kind: "angle", "swing" or "twist".
    """

    kind: str = "angle"

    @property
    def side(self) -> str:
        """Name of the bound: "angle", "swing", "lower" or "upper"."""
        return self.kind if self.kind != "twist" else super().side

    def values(self, x: Array) -> Array:
        """Return the bounded angles, (…), at shapes x (…, nx) [rad]."""
        v, w = self._quaternion(x)
        n = self._axis
        along = v @ n
        if self.kind == "angle":
            return np.asarray(2.0 * np.arctan2(np.linalg.norm(v, axis=-1), np.abs(w)))
        if self.kind == "swing":
            across = np.linalg.norm(np.cross(v, n), axis=-1)
            return np.asarray(2.0 * np.arctan2(across, np.hypot(along, w)))
        sign = np.where(w < 0.0, -1.0, 1.0)
        return np.asarray(2.0 * np.arctan2(sign * along, np.abs(w)))

    def normal(self, x: Array, m: int) -> Array:
        """Return the rates of the gap per rate of the shape, (m,), at shape x (nx,)."""
        v, w = self._quaternion(x)
        n = self._axis
        along, across = float(v @ n), np.cross(v, n)
        if self.kind == "angle":
            rates = math.copysign(1.0, w) * v / max(float(np.linalg.norm(v)), 1e-300)
        elif self.kind == "swing":
            tilted = w * np.cross(n, across) + along * across
            size = math.hypot(along, float(w)) * float(np.linalg.norm(across))
            rates = tilted / max(size, 1e-300)
        else:
            rates = n + (along * (v - along * n) - w * across) / (along**2 + w**2)
        gradient = np.zeros(m)
        gradient[self.v : self.v + 3] = self.sign * rates
        return gradient

    def normal_rate(self, x: Array, xdot: Array) -> Array:
        """Return the time derivative of the normal at shape rate xdot (m,), (m,)."""
        v, w = self._quaternion(x)
        n, rates = self._axis, xdot[self.v : self.v + 3]
        dv, dw = 0.5 * (w * rates + np.cross(v, rates)), -0.5 * float(v @ rates)
        along, across = float(v @ n), np.cross(v, n)
        dalong, dacross = float(dv @ n), np.cross(dv, n)
        if self.kind == "angle":
            tilted, change = math.copysign(1.0, w) * v, math.copysign(1.0, w) * dv
        elif self.kind == "swing":
            tilted = w * np.cross(n, across) + along * across
            change = dw * np.cross(n, across) + w * np.cross(n, dacross)
            change += dalong * across + along * dacross
        else:
            size = along**2 + float(w) ** 2
            tilted = (along * (v - along * n) - w * across) / size
            change = dalong * (v - 2.0 * along * n) + along * dv - dw * across - w * dacross
            change = (change - 2.0 * (along * dalong + float(w) * dw) * tilted) / size
        if self.kind != "twist":  # a unit vector
            length = max(float(np.linalg.norm(tilted)), 1e-300)
            unit = tilted / length
            change = (change - (unit @ change) * unit) / length
        gradient_rate = np.zeros(len(xdot))
        gradient_rate[self.v : self.v + 3] = self.sign * change
        return gradient_rate

    def is_undefined(self, x: Array) -> bool:
        """Return whether the angle is not defined at shape x (nx,): a twist at a swing of π."""
        v, w = self._quaternion(x)
        return self.kind == "twist" and math.hypot(float(v @ self._axis), float(w)) < _UNDEFINED

    @property
    def rates(self) -> tuple[int, ...]:
        """Indices of the rates of the ball."""
        return tuple(range(self.v, self.v + 3))

    @property
    def surface(self) -> BallSurface:
        """The attitudes at the stop."""
        return BallSurface(self.joint, self.kind, self.position, tuple(self._axis.tolist()))

    def _quaternion(self, x: Array) -> tuple[Array, Array]:
        """Return the vectors (…, 3) and scalars (…) of the ball's quaternions."""
        return x[..., self.x : self.x + 3], x[..., self.x + 3]

    @property
    def _axis(self) -> Array:
        assert isinstance(self.stop, BallStop)
        return np.array(self.stop.axis)


def place(bounds: Sequence[Bound], x: Array) -> None:
    """Move joints to their stops, in a shape x (nx,) that is at them up to round-off."""
    surfaces = dict[int, list[BallSurface]]()
    for bound in bounds:
        if isinstance(bound, BallBound):
            surfaces.setdefault(bound.x, []).append(bound.surface)
        elif not isinstance(bound, SumBound):
            x[bound.x] = bound.position
    sums = [bound for bound in bounds if isinstance(bound, SumBound)]
    if sums:  # the leaders that are not at stops of their own move
        held = {bound.x for bound in bounds if bound.surface is None}
        ratios = np.zeros((len(sums), len(x)))
        for row, bound in zip(ratios, sums, strict=True):
            for k, _, ratio in bound.terms:
                row[k] = 0.0 if k in held else ratio
        x += np.linalg.pinv(ratios) @ [bound.position - float(bound.values(x)) for bound in sums]
    for k, of_ball in surfaces.items():
        x[k : k + 4] = on_surfaces(of_ball, x[k : k + 4])


def stop_of_table(entries: Mapping[str, Any]) -> Stop | BallStop:
    """Return the stops that a table of a scene file describes."""
    of_ball = {"angle", "swing", "twist", "axis"} & entries.keys()
    mixed = {"lower", "upper"} & entries.keys()
    if of_ball and mixed:
        raise InputError(
            f"expected {' and '.join(sorted(mixed))} of a hinge or slide, or "
            f"{' and '.join(sorted(of_ball))} of a ball, got both"
        )
    return BallStop(**entries) if of_ball else Stop(**entries)


def parse_stops(value: Any, system: System) -> dict[str, Stop | BallStop]:
    """Convert the option `stops`.

    Args:
        value: None, "file", or {joint: Stop, (lower, upper) or (lower, upper, restitution)}.
        system: The system.
    Returns:
        {joint: its stops}, in the order of the robot's joints; empty for None.
    Raises:
        InputError: The value has another form, a joint is unknown or not a hinge or slide, or the
            robot's file has no position limits.
    """
    if value is None:
        return {}
    if isinstance(value, str):
        value = _stops_of_file(value, system)
    if not isinstance(value, Mapping):
        raise InputError(
            f"stops: expected 'file', or {{joint: Stop or (lower, upper)}}, got {brief(value)}"
        )
    joints = {joint.name: joint for joint in system.tree.joints}
    stops: dict[str, Stop | BallStop] = {}
    for name, entry in value.items():
        if not isinstance(name, str) or name not in joints:
            hint = nearest(str(name), list(joints))
            raise InputError(
                f"stops: '{system.name}' has no joint {quoted(str(name))}; {hint}its joints are "
                f"{listed(list(joints), 8)}"
            )
        is_ball = joints[name].kind.is_ball
        if is_ball != isinstance(entry, BallStop):
            expected = "a BallStop for ball joint" if is_ball else "a Stop for joint"
            raise InputError(f"stops: expected {expected} {quoted(name)}, got {brief(entry)}")
        stops[name] = entry if isinstance(entry, BallStop) else _stop_of(entry, name)
    bounds_of(system, stops)
    return {name: stops[name] for name in joints if name in stops}


def is_number_of_stop(name: str, system: System) -> bool:
    """Return whether a name has the form "JOINT.stop.NUMBER" with a joint of a system."""
    joint, dots, _ = name.rpartition(".stop.")
    return bool(dots) and joint in {tree_joint.name for tree_joint in system.tree.joints}


def number_of_stop(stops: Mapping[str, Stop | BallStop], name: str, what: str) -> float:
    """Return the number of a stop that a name states.

    Args:
        stops: {joint: its stops}.
        name: Name of the number, such as "elbow.stop.restitution".
        what: The argument that contains the name, for messages.
    Returns:
        The number.
    Raises:
        InputError: The scene states no stops of this joint, or they have no such number.
    """
    joint, field = _parts_of_name(name)
    if joint not in stops:
        raise InputError(
            f"{what}: {quoted(name)}: expected a scene with stops of {quoted(joint)}, got stops of "
            f"{listed(list(stops), 8) or 'no joint'}. Add {quoted(joint)} to its stops"
        )
    numbers = numbers_of_stop(stops[joint])
    if field not in numbers:
        raise InputError(
            f"{what}: {quoted(name)}: expected one of the numbers {', '.join(numbers)} of a stop, "
            f"got {quoted(field)}; {nearest(field, list(numbers))}".rstrip("; ")
        )
    return numbers[field]


def numbers_of_stop(stop: Stop | BallStop) -> dict[str, float]:
    """Return the numbers of a stop by name."""
    return {name: value for name, value in vars(stop).items() if isinstance(value, float)}


def changed_stops(
    stops: Mapping[str, Stop | BallStop], numbers: Mapping[str, float]
) -> dict[str, Stop | BallStop]:
    """Return stops with other numbers.

    Args:
        stops: {joint: its stops}.
        numbers: Values by name, such as {"elbow.stop.restitution": 0.5}.
    Returns:
        The stops.
    Raises:
        InputError: A joint has no stops, or a number is not valid.
    """
    changes: dict[str, dict[str, float]] = {}
    for name, value in numbers.items():
        number_of_stop(stops, name, "members")
        joint, field = _parts_of_name(name)
        changes.setdefault(joint, {})[field] = value
    changed = dict(stops)
    for joint, values in changes.items():
        try:
            changed[joint] = replace(changed[joint], **values)  # type: ignore[arg-type]
        except InputError as error:
            raise InputError(f"stops['{joint}']: {error}") from None
    return changed


def _parts_of_name(name: str) -> tuple[str, str]:
    """Return joint and number of a name such as "elbow.stop.restitution"."""
    joint, _, field = name.rpartition(".stop.")
    return joint, field


def bounds_of(system: System, stops: Mapping[str, Stop | BallStop]) -> tuple[Bound, ...]:
    """Return the bounds that stops put on independent joints, at most two for each but balls.

    Args:
        system: The system.
        stops: {joint: its stops}.
    Returns:
        The bounds, in the order of the joints; the tighter one of two on the same side.
    Raises:
        InputError: A continuous joint follows several, or the stops of two joints contradict.
    """
    tightest: dict[tuple[int, float], Bound] = {}
    joints = {joint.name: joint for joint in system.tree.joints}
    of_balls, of_sums = list[Bound](), list[Bound]()
    for name, stop in stops.items():
        if isinstance(stop, BallStop):
            of_balls += _bounds_of_ball(system, name, stop)
            continue
        joint = joints[name]
        x, v = joint.x.start, joint.v.start
        leaders = None if system.coupled is None else system.coupled.terms(v)
        if leaders is not None and not leaders:
            raise InputError(f"stops: joint '{name}' never moves, by its coupling. Omit its stop")
        if leaders is not None and len(leaders) > 1:
            of_sums += _bounds_of_sum(system, name, x, v, stop)
            continue
        x, v, ratio, offset = _leader(system, x, v)
        for sign, position in ((1.0, stop.lower), (-1.0, stop.upper)):
            if math.isinf(position):
                continue
            side = sign * math.copysign(1.0, ratio)
            bound = Bound(name, x, v, side, (position - offset) / ratio, ratio, stop)
            other = tightest.get((v, side))
            if other is None or side * (bound.position - other.position) > 0.0:
                tightest[v, side] = bound
    for (v, side), bound in tightest.items():
        above = tightest.get((v, -1.0))
        if side > 0.0 and above is not None and not bound.position < above.position:
            raise InputError(
                f"stops: the stops of '{bound.joint}' and '{above.joint}' leave no room, because "
                "one joint follows the other. Change one of them"
            )
    return (*tightest.values(), *of_sums, *of_balls)


def _bounds_of_sum(system: System, name: str, x: int, v: int, stop: Stop) -> list[Bound]:
    """Return the bounds of a joint that follows several others, at coordinate x and rate v."""
    coupled = system.coupled
    assert coupled is not None
    places = [k for k, _ in coupled.value_terms(x)]
    rates = coupled.terms(v)
    terms = tuple((k, rate, ratio) for k, (rate, ratio) in zip(places, rates, strict=True))
    model = system.sorted_model
    wound = {str(n) for n, joint in zip(model.names, model.joints, strict=True) if joint.nq != 1}
    leaders = [system.space.names[rate] for rate, _ in rates]
    leader = next((each for each in leaders if each not in wound), "")
    if name in wound or not leader:
        raise InputError(
            f"stops: joint '{name}' follows {len(rates)} joints, and "
            f"{name if leader else 'each of them'} is continuous. Put stops on these joints instead"
        )
    arguments = (1.0, stop, terms, float(coupled.offset[x]), leader)
    return [
        SumBound(name, places[0], rates[0][0], sign, position, *arguments)
        for sign, position in ((1.0, stop.lower), (-1.0, stop.upper))
        if not math.isinf(position)
    ]


def _bounds_of_ball(system: System, name: str, stop: BallStop) -> list[Bound]:
    """Return the bounds of a ball."""
    joint = next(joint for joint in system.space.joints if joint.name == name)
    limits = [
        ("angle", -1.0, stop.angle), ("swing", -1.0, stop.swing),
        ("twist", 1.0, stop.twist[0]), ("twist", -1.0, stop.twist[1]),
    ]  # fmt: skip
    return [
        BallBound(name, joint.x.start, joint.v.start, sign, limit, 1.0, stop, kind)
        for kind, sign, limit in limits
        if not math.isinf(limit)
    ]


def stop_numbers(stops: Mapping[str, Stop | BallStop]) -> dict[str, float]:
    """Return the finite numbers on which motions with stops depend smoothly.

    A rest rate only chooses the rebound at which an accumulation ends.

    Args:
        stops: {joint: its stops}.
    Returns:
        {"elbow.stop.upper": position, …}; none of balls.
    """
    return {
        f"{joint}.stop.{name}": value
        for joint, stop in stops.items()
        if isinstance(stop, Stop)
        for name, value in numbers_of_stop(stop).items()
        if name != "rest_rate" and math.isfinite(value)
    }


def starts_beyond(bounds: tuple[Bound, ...], x: Array) -> dict[int, str]:
    """Describe the initial shapes that lie outside their stops.

    Args:
        bounds: The bounds.
        x: Initial shapes, (N, nx) [rad | m | 1].
    Returns:
        {index of the shape: why it is refused}.
    """
    reasons: dict[int, str] = {}
    for bound in bounds:
        beyond = bound.sign * (bound.position - bound.values(x))
        stop = bound.stop
        limits = f"{bound.position:g} rad"
        if isinstance(stop, Stop):
            limits = f"lower {stop.lower:g}, upper {stop.upper:g}"
        for k in np.flatnonzero(beyond > _WITHIN * max(1.0, abs(bound.position))).tolist():
            reasons.setdefault(
                k,
                f"stops: the initial position of joint '{bound.joint}' is {beyond[k]:.3g} beyond "
                f"its {bound.side} stop ({limits}). Start within the stops (x0=), or widen them",
            )
    return reasons


def _leader(system: System, x: int, v: int) -> tuple[int, int, float, float]:
    """Return indices of coordinate and rate of the leader of a joint, its ratio and its offset."""
    coupled = system.coupled
    if coupled is None:
        return x, v, 1.0, 0.0
    ((lead, ratio),), ((lead_x, _),) = coupled.terms(v), coupled.value_terms(x)
    return lead_x, lead, ratio, float(coupled.offset[x])


def _stop_of(entry: Any, name: str) -> Stop:
    """Return the stops of one joint."""
    if isinstance(entry, Stop):
        return entry
    numbers = list(entry) if isinstance(entry, Sequence) and not isinstance(entry, str) else []
    if len(numbers) not in (2, 3):
        raise InputError(
            f"stops['{name}']: expected a Stop, (lower, upper) or (lower, upper, restitution), "
            f"got {brief(entry)}"
        )
    try:
        return Stop(*numbers)
    except InputError as error:
        raise InputError(f"stops['{name}']: {error}") from None


def _stops_of_file(value: str, system: System) -> dict[str, Stop | BallStop]:
    """Return the position limits of the robot's file as stops without restitution."""
    if value != FILE:
        raise InputError(
            f"stops: expected 'file', or {{joint: Stop or (lower, upper)}}, got {brief(value)}"
        )
    merged = next((left.names for left in system.left_out if left.what == LIMITS_OF_HINGES), ())
    if merged:
        raise InputError(
            f"stops: the file of '{system.name}' bounds {listed(list(map(quoted, merged)), 4)}, "
            "hinges that became balls, so 'file' would leave bounds out. Load the robot with "
            "balls=False, or state the stops by joint, such as {ball: BallStop(angle=…)}"
        )
    stops: dict[str, Stop | BallStop] = {
        name: BallStop(angle=angle, restitution=0.0)
        for name, angle in angles_of_balls(system).items()
    }
    for limit in limits_of(system):
        if limit.kind == "position" and limit.lower < limit.upper:
            lower = limit.lower if abs(limit.lower) < UNLIMITED else -math.inf
            upper = limit.upper if abs(limit.upper) < UNLIMITED else math.inf
            stops[limit.joint] = Stop(lower, upper)
    if not stops:
        raise InputError(
            f"stops: the file of '{system.name}' has no position limits. Pass "
            "{joint: (lower, upper)}"
        )
    return stops
