"""Inertial parameters of bodies by name, such as "hand.mass", and the inertias they make.

A body is what moves with one joint: all links that are fixed to each other.  Any of its links, or
its joint, names it; numbers are in the frame of the joint.  Mass, centre and moments about the
centre are varied apart: any positive mass with any centre leaves a body physical, moments are
checked, and the ten log-Cholesky parameters need no check (C. Rucker, P. Wensing, Smooth
parameterization of rigid-body inertia, IEEE Robotics and Automation Letters 7 (2022) 2771–2778).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ..common.arrays import Array, as_floats, read_only, vector
from ..common.errors import InputError
from ..common.names import nearest
from ..common.plain_names import listed, quoted
from .system import System

# Each kind of parameter, and how many numbers it has.
SIZES = {
    "mass": 1, "com": 3, "inertia": 6, "payload.mass": 1, "payload.at": 3, "log_cholesky": 10,
}  # fmt: skip
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # of moments xx, xy, xz, yy, yz, zz
# Pinocchio's order of the moments among its dynamic parameters: xx, xy, yy, xz, yz, zz.
_THEIRS = (0, 1, 3, 2, 4, 5)
_LEAST = 1e-12  # of the largest eigenvalue of a pseudo-inertia


@dataclass(frozen=True)
class BodyParameter:
    """A parameter of a body.  body: its index, 0 for the root.  kind: one of SIZES."""

    name: str
    body: int
    kind: str

    @property
    def size(self) -> int:
        """Number of its numbers."""
        return SIZES[self.kind]


def body_parameter(system: System, name: str) -> BodyParameter | None:
    """Return what a name stands for; None if it has not the form of one.

    Raises InputError for a body that is not there.
    """
    kinds = [kind for kind in SIZES if isinstance(name, str) and name.endswith(f".{kind}")]
    if not kinds:
        return None
    kind = max(kinds, key=len)
    word, bodies = name[: -len(kind) - 1], body_names(system)
    if word not in bodies:
        known = list(bodies)
        raise InputError(
            f"parameters: '{system.name}' has no link or joint {quoted(word)}; "
            f"{nearest(word, known)}they are {listed(known, 60)}"
        )
    return BodyParameter(name, bodies[word], kind)


def body_names(system: System) -> dict[str, int]:
    """Return the bodies by the names of their links and joints; links take precedence."""
    model = system.model
    found = {str(model.names[i]): i - 1 for i in range(1, model.njoints)}
    links = [f for f in model.frames if f.type == pin.FrameType.BODY and f.parentJoint > 0]
    return found | {str(f.name): int(f.parentJoint) - 1 for f in links}


class Bodies:
    """The inertias of some bodies as functions of parameters.

    parameters: in their order.  free: indices of the bodies that they change, sorted.
    """

    def __init__(self, system: System, names: Sequence[str]) -> None:
        """Find the parameters.  Raises InputError for those that say the same thing twice."""
        self._system = system
        found = [body_parameter(system, name) for name in names]
        self.parameters = tuple(each for each in found if each is not None)
        self.free = tuple(sorted({each.body for each in self.parameters}))
        self._body_of = {each.name: each.body for each in self.parameters}
        self._mine: dict[int, dict[str, str]] = {body: {} for body in self.free}
        for each in self.parameters:
            self._mine[each.body][each.kind] = each.name
        self._owns: dict[tuple[int, str], Array] = {}
        self._last: dict[int, tuple[list[Array], tuple[Array, dict[str, Array]]]] = {}
        seen: dict[tuple[int, str], str] = {}
        for each in self.parameters:
            if other := seen.get((each.body, each.kind)):
                raise InputError(
                    f"parameters: '{each.name}' and '{other}' are one body's; name one of them"
                )
            seen[each.body, each.kind] = each.name
        for body, kind in seen:
            others = [name for (b, k), name in seen.items() if b == body and k != "log_cholesky"]
            if kind == "log_cholesky" and others:
                raise InputError(
                    f"parameters: '{seen[body, kind]}' says all of a body; leave out '{others[0]}'"
                )

    def own(self) -> dict[str, Array]:
        """Return the values that the system has, {name: (size,)}."""
        return {each.name: _own(self._body(each.body), each.kind) for each in self.parameters}

    def checked(self, given: Mapping[str, Any], known: Mapping[str, Array]) -> dict[str, Array]:
        """Return what is given as arrays of its own.  Raises InputError for what no real body has.

        known: values of the others, checked before.
        """
        mine = [each for each in self.parameters if each.name in given]
        out = {}
        for each in mine:
            out[each.name] = read_only(numbers(given[each.name], each.name, each.size))
        whole = {**known, **out}
        for body in self.changed_by(given):
            self.dynamic(body, whole)
        return out

    def changed_by(self, names: Iterable[str]) -> list[int]:
        """Return the bodies that some parameters change, sorted."""
        return sorted({self._body_of[name] for name in names if name in self._body_of})

    def dynamic(self, body: int, values: Mapping[str, Array]) -> tuple[Array, dict[str, Array]]:
        """Return (10,) mass, first and second moments of a body, and their slopes by each value.

        About the joint's origin: m, m c, then xx, xy, xz, yy, yz, zz.  slopes: {name: (10, size)}.
        values: read-only arrays; for the same objects the same is returned.
        Raises InputError, naming the parameter, for what is not physical.
        """
        mine = [values[name] for name in self._mine[body].values()]
        last = self._last.get(body)
        if last is None or any(a is not b for a, b in zip(last[0], mine, strict=True)):
            last = mine, self._dynamic(body, values)
            if not any(value.flags.writeable for value in mine):
                self._last[body] = last
        return last[1]

    def _dynamic(self, body: int, values: Mapping[str, Array]) -> tuple[Array, dict[str, Array]]:
        mine = self._mine[body]
        slopes: dict[str, Array] = {}
        if "log_cholesky" in mine:
            name = mine["log_cholesky"]
            theirs = pin.LogCholeskyParameters(values[name])
            order = [0, 1, 2, 3, *(4 + k for k in _THEIRS)]
            slopes[name] = np.asarray(theirs.calculateJacobian())[order]
            total = np.asarray(theirs.toDynamicParameters())[order]
            _refuse_unphysical(total, name)
            return total, slopes
        m, c, about = (
            values[mine[kind]] if kind in mine else self._own_of(body, kind)
            for kind in ("mass", "com", "inertia")
        )
        total, by_mass, by_centre = _of_point(float(m[0]), c)
        total[4:] += about
        if "mass" in mine:
            if not m[0] > 0.0:
                raise InputError(f"parameters: '{mine['mass']}' must be above zero, got {m[0]:g}")
            slopes[mine["mass"]] = by_mass[:, None]
        if "com" in mine:
            slopes[mine["com"]] = by_centre
        if "inertia" in mine:
            slopes[mine["inertia"]] = np.vstack([np.zeros((4, 6)), np.eye(6)])
            _refuse_unphysical(
                _of_point(float(m[0]), np.zeros(3))[0] + np.append(np.zeros(4), about),
                mine["inertia"],
            )
        if "payload.mass" in mine or "payload.at" in mine:
            load, at = (
                values[mine[kind]] if kind in mine else np.zeros(SIZES[kind])
                for kind in ("payload.mass", "payload.at")
            )
            if load[0] < 0.0:
                raise InputError(
                    f"parameters: '{mine['payload.mass']}' must not be negative, got {load[0]:g}"
                )
            more, by_mass, by_centre = _of_point(float(load[0]), at)
            total += more
            if "payload.mass" in mine:
                slopes[mine["payload.mass"]] = by_mass[:, None]
            if "payload.at" in mine:
                slopes[mine["payload.at"]] = by_centre
        return total, slopes

    def perturbed(self, rng: np.random.Generator) -> dict[str, Array]:
        """Return physical values that have nothing in common with those of the system."""
        out = {}
        for each in self.parameters:
            own = self._body(each.body)
            reach = np.sqrt(np.trace(own.inertia) / max(own.mass, 1e-300)) + 1e-3
            value = _own(own, each.kind)
            if each.kind == "mass":
                value = value * rng.uniform(1.2, 1.8)
            elif each.kind == "payload.mass":
                value = np.array([own.mass * rng.uniform(0.2, 0.8)])
            elif each.kind == "inertia":
                A = rng.normal(size=(3, 3))
                spread = np.trace(own.inertia) * A @ A.T / np.trace(A @ A.T)
                moments = np.trace(spread) * np.eye(3) - spread
                value = value + np.array([moments[i, j] for i, j in _PAIRS])
            elif each.kind == "log_cholesky":
                value = value + 0.2 * rng.normal(size=10) * np.append(1.0, np.ones(9))
            else:
                value = value + reach * rng.normal(size=3)
            out[each.name] = value
        return out

    def _own_of(self, body: int, kind: str) -> Array:
        """Return the value of a kind that a body of the system has, found once."""
        if (body, kind) not in self._owns:
            self._owns[body, kind] = read_only(_own(self._body(body), kind))
        return self._owns[body, kind]

    def _body(self, body: int) -> pin.Inertia:
        return self._system.model.inertias[body + 1]


def numbers(value: Any, name: str, size: int) -> Array:
    """Return the value of a parameter as an array (size,) of its own.  Raises ShapeError."""
    if type(value) is np.ndarray and value.shape == (size,) and value.dtype == float:
        own: Array = value.copy()
        if np.isfinite(own).all():
            return own
    what = f"parameters['{name}']"
    return np.array(vector(np.atleast_1d(as_floats(value, what)), size, what))


def inertia_of(moments: Array) -> pin.Inertia:
    """Return the inertia that has (10,) moments about the joint's origin."""
    theirs = np.concatenate([moments[:4], moments[4:][list(_THEIRS)]])
    return pin.Inertia.FromDynamicParameters(theirs)


def _own(body: pin.Inertia, kind: str) -> Array:
    """Return the value of a kind that a body has."""
    if kind == "mass":
        return np.array([body.mass])
    if kind == "com":
        return np.array(body.lever)
    if kind == "inertia":
        return np.array([body.inertia[i, j] for i, j in _PAIRS])
    if kind == "log_cholesky":
        try:
            theirs = pin.PseudoInertia.FromInertia(body)
            return np.asarray(
                pin.LogCholeskyParameters(_log_cholesky(theirs.toMatrix())).parameters
            )
        except np.linalg.LinAlgError:
            raise InputError(
                "a body whose mass lies in a plane, on a line or in a point has no log-Cholesky "
                "parameters; vary mass, com and payload"
            ) from None
    return np.zeros(SIZES[kind])


def _log_cholesky(J: Array) -> Array:
    """Return Pinocchio's log-Cholesky parameters (10,) of a pseudo-inertia (4, 4), J = U Uᵀ."""
    flip = J[::-1, ::-1]
    U = np.linalg.cholesky(flip)[::-1, ::-1]
    alpha = np.log(U[3, 3])
    scaled = U / U[3, 3]
    d = np.log(np.diag(scaled)[:3])
    return np.array(
        [
            alpha,
            *d,
            scaled[0, 1],
            scaled[1, 2],
            scaled[0, 2],
            scaled[0, 3],
            scaled[1, 3],
            scaled[2, 3],
        ]
    )


def _of_point(m: float, c: Array) -> tuple[Array, Array, Array]:
    """Return the moments (10,) of a point of mass m at c, and their slopes (10,) and (10, 3)."""
    x, y, z = c.tolist()
    by_mass = np.array(
        [1.0, x, y, z, y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y]
    )
    by_centre = m * np.array([
        [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0],
        [0.0, 2.0 * y, 2.0 * z], [-y, -x, 0.0], [-z, 0.0, -x],
        [2.0 * x, 0.0, 2.0 * z], [0.0, -z, -y], [2.0 * x, 2.0 * y, 0.0],
    ])  # fmt: skip
    return m * by_mass, by_mass, by_centre


def _refuse_unphysical(total: Array, name: str) -> None:
    """Raise InputError unless the pseudo-inertia of (10,) moments is positive semidefinite."""
    I = np.zeros((3, 3))
    for value, (i, j) in zip(total[4:], _PAIRS, strict=True):
        I[i, j] = I[j, i] = value
    J = np.zeros((4, 4))
    J[:3, :3] = 0.5 * np.trace(I) * np.eye(3) - I
    J[:3, 3] = J[3, :3] = total[1:4]
    J[3, 3] = total[0]
    eigenvalues = np.linalg.eigvalsh(J)
    if not eigenvalues[0] >= -_LEAST * eigenvalues[-1]:
        raise InputError(
            f"parameters: '{name}' is no inertia of a real body: no positive masses have these "
            "moments (each principal moment is at most the sum of the other two)"
        )
