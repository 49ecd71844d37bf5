"""Joint stops: bounds of joint positions at which joints bounce or come to rest.

Internally, every stop bounds an independent joint: the stop of a follower is moved to its leader.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array
from ..common.errors import InputError
from ..common.names import brief, listed, nearest, quoted
from ..system.stated_limits import limits_of
from ..system.system import System
from ..system.urdf_elements import UNLIMITED
from .toml.schema import ByName, Either, Key, ListOf, Table, Text
from .toml.signal_tables import NUMBER, POSITIVE

FILE = "file"  # value of the option for the limits of the robot's file
STOP_TABLE = Table(
    {
        "lower": Key(NUMBER, "lower stop [rad | m]", default="none"),
        "upper": Key(NUMBER, "upper stop [rad | m]", default="none"),
        "restitution": Key(NUMBER, "ratio of the rates after and before, 0 to 1", default="0"),
        "rest_rate": Key(
            POSITIVE, "rebound below which a joint rests [rad/s | m/s]", default="1e-06"
        ),
    },
    "a stop",
)  # fmt: skip
STOPS = Either((Text((FILE,)), ByName(Either((ListOf(NUMBER), STOP_TABLE)))))
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
    stop: Stop

    @property
    def side(self) -> str:
        """Side of the joint that has the stop, "lower" or "upper"."""
        return "lower" if self.sign * self.ratio > 0.0 else "upper"


def parse_stops(value: Any, system: System) -> dict[str, Stop]:
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
    stops = {}
    for name, entry in value.items():
        if not isinstance(name, str) or name not in joints:
            hint = nearest(str(name), list(joints))
            raise InputError(
                f"stops: '{system.name}' has no joint {quoted(str(name))}; {hint}its joints are "
                f"{listed(list(joints), 8)}"
            )
        if joints[name].kind.is_ball:
            raise InputError(
                f"stops: expected hinges and slides, got ball joint {quoted(name)}. Load it as "
                "three hinges, or omit its stop"
            )
        stops[name] = _stop_of(entry, name)
    bounds_of(system, stops)
    return {name: stops[name] for name in joints if name in stops}


def bounds_of(system: System, stops: Mapping[str, Stop]) -> tuple[Bound, ...]:
    """Return the bounds that stops put on independent joints, at most two for each.

    Args:
        system: The system.
        stops: {joint: its stops}.
    Returns:
        The bounds, in the order of the joints; the tighter one of two on the same side.
    Raises:
        InputError: A follower has several leaders, or the stops of two joints contradict.
    """
    tightest: dict[tuple[int, float], Bound] = {}
    joints = {joint.name: joint for joint in system.tree.joints}
    for name, stop in stops.items():
        joint = joints[name]
        x, v, ratio, offset = _leader(system, name, joint.x.start, joint.v.start)
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
    return tuple(tightest.values())


def check_start(bounds: tuple[Bound, ...], x: Array) -> None:
    """Raise InputError if an initial shape (nx,) lies outside its stops."""
    for bound in bounds:
        beyond = bound.sign * (bound.position - float(x[bound.x]))
        if beyond > _WITHIN * max(1.0, abs(bound.position)):
            stop = bound.stop
            raise InputError(
                f"stops: the initial position of joint '{bound.joint}' is {beyond:.3g} beyond its "
                f"{bound.side} stop (lower {stop.lower:g}, upper {stop.upper:g}). Start within the "
                "stops (x0=), or widen them"
            )


def _leader(system: System, name: str, x: int, v: int) -> tuple[int, int, float, float]:
    """Return indices of coordinate and rate of the leader of a joint, its ratio and its offset."""
    coupled = system.coupled
    if coupled is None:
        return x, v, 1.0, 0.0
    terms = coupled.terms(v)
    if len(terms) != 1:
        raise InputError(
            f"stops: joint '{name}' follows {len(terms)} joints. Put stops on these joints instead"
        )
    ((lead, ratio),) = terms
    ((lead_x, _),) = coupled.value_terms(x)
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


def _stops_of_file(value: str, system: System) -> dict[str, Stop]:
    """Return the position limits of the robot's file as stops without restitution."""
    if value != FILE:
        raise InputError(
            f"stops: expected 'file', or {{joint: Stop or (lower, upper)}}, got {brief(value)}"
        )
    stops = {}
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
