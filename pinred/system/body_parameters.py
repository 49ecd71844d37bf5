"""Inertial parameters of bodies by name, such as "hand.mass".

A body consists of all links that are fixed to each other, and moves with one joint.  The body can
be named after any of its links or after its joint.  Values are in the frame of the joint.

Mass, centre of mass and moments about the centre vary independently.  Any positive mass with any
centre is physical; moments are validated.  Log-Cholesky parameters are always physical (C. Rucker,
P. Wensing, Smooth parameterization of rigid-body inertia, IEEE Robotics and Automation Letters 7
(2022) 2771–2778).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ..common.arrays import Array, as_floats, read_only, vector
from ..common.errors import InputError
from ..common.names import listed, nearest, quoted
from .inertia_rows import LEAST, find_unphysical, moments_of_rows
from .system import System

# Number of values of each kind of parameter.
SIZES = {
    "mass": 1, "com": 3, "inertia": 6, "payload.mass": 1, "payload.at": 3, "log_cholesky": 10,
}  # fmt: skip
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # entries xx, xy, xz, yy, yz, zz
# Permutation from pinred's order of moments to that of Pinocchio's dynamic parameters (xx, xy, yy,
# xz, yz, zz).  The permutation is its own inverse.
_TO_PINOCCHIO = [0, 1, 2, 3, 4, 5, 7, 6, 8, 9]


@dataclass(frozen=True)
class BodyParameter:
    """A parameter of a body.

    Attributes:
        name: Name of the parameter.
        body: Index of the body, 0 for the root.
        kind: Kind of parameter, a key of SIZES.
    """

    name: str
    body: int
    kind: str

    @property
    def size(self) -> int:
        """Number of values."""
        return SIZES[self.kind]


def body_parameter(system: System, name: str) -> BodyParameter | None:
    """Return the body parameter that a name denotes, or None if the name has another form.

    Raises:
        InputError: The body is unknown.
    """
    kinds = [kind for kind in SIZES if isinstance(name, str) and name.endswith(f".{kind}")]
    if not kinds:
        return None
    kind = max(kinds, key=len)
    word, bodies = name[: -len(kind) - 1], body_names(system)
    if word not in bodies:
        names = list(bodies)
        raise InputError(
            f"parameters: '{system.name}' has no link or joint {quoted(word)}; "
            f"{nearest(word, names)}they are {listed(names, 60)}"
        )
    return BodyParameter(name, bodies[word], kind)


def body_names(system: System) -> dict[str, int]:
    """Return {name of link or joint: body index}; link names take precedence."""
    model = system.sorted_model
    joints = {str(model.names[i]): i - 1 for i in range(1, model.njoints)}
    links = [f for f in model.frames if f.type == pin.FrameType.BODY and f.parentJoint > 0]
    return joints | {str(f.name): int(f.parentJoint) - 1 for f in links}


class Bodies:
    """The inertias of some bodies as functions of parameters.

    Attributes:
        parameters: Body parameters, in the order of their names.
        free: Indices of the bodies that the parameters change, sorted.
    """

    def __init__(self, system: System, names: Sequence[str]) -> None:
        """Select the body parameters from a list of names.

        Args:
            system: Robot.
            names: Names of parameters of all kinds.
        Raises:
            InputError: Two parameters set the same property of a body.
        """
        self._system = system
        parameters = [body_parameter(system, name) for name in names]
        self.parameters = tuple(entry for entry in parameters if entry is not None)
        self.free = tuple(sorted({entry.body for entry in self.parameters}))
        self._body_of = {entry.name: entry.body for entry in self.parameters}
        # {body: {kind: name of the parameter}}
        self._names: dict[int, dict[str, str]] = {body: {} for body in self.free}
        self._nominal: dict[tuple[int, str], Array] = {}
        self._last: dict[int, tuple[list[Array], tuple[Array, dict[str, Array]]]] = {}
        for entry in self.parameters:
            names_of_body = self._names[entry.body]
            if other := names_of_body.get(entry.kind):
                raise InputError(
                    f"parameters: '{entry.name}' and '{other}' belong to the same body. Name one "
                    "of them."
                )
            names_of_body[entry.kind] = entry.name
        for names_of_body in self._names.values():
            others = [name for kind, name in names_of_body.items() if kind != "log_cholesky"]
            if "log_cholesky" in names_of_body and others:
                raise InputError(
                    f"parameters: '{names_of_body['log_cholesky']}' sets all parameters of a body. "
                    f"Omit '{others[0]}'."
                )

    def own(self) -> dict[str, Array]:
        """Return the current values of the parameters in the system, {name: (size,)}."""
        return {entry.name: _value(self._body(entry), entry.kind) for entry in self.parameters}

    def changed_by(self, names: Iterable[str]) -> list[int]:
        """Return the indices of the bodies that these parameters change, sorted."""
        return sorted({self._body_of[name] for name in names if name in self._body_of})

    def dynamic(self, body: int, values: Mapping[str, Array]) -> tuple[Array, dict[str, Array]]:
        """Compute mass, first and second moments of a body about the origin of its joint.

        If the value arrays are read-only, the last result is cached by the identity of the arrays.

        Args:
            body: Index of the body.
            values: Values of all parameters, {name: (size,)}.
        Returns:
            Moments, (10,): mass m, first moment m c, then second moments xx, xy, xz, yy, yz, zz;
            and their derivatives with respect to the parameters, {name: (10, size)}.
        Raises:
            InputError: The values are not physical.
        """
        own_values = [values[name] for name in self._names[body].values()]
        last = self._last.get(body)
        if last is None or any(a is not b for a, b in zip(last[0], own_values, strict=True)):
            last = own_values, self._dynamic(body, values)
            if not any(value.flags.writeable for value in own_values):
                self._last[body] = last
        return last[1]

    def rows(
        self, changes: Mapping[str, Array], values: Mapping[str, Array]
    ) -> tuple[dict[int, Array], dict[int, str]] | None:
        """Compute moments of bodies for many values (see ModelParameters.body_rows)."""
        if not all(name in self._body_of for name in changes):
            return None
        count = len(next(iter(changes.values())))
        moments, reasons = dict[int, Array](), dict[int, str]()
        for body in self.changed_by(changes):
            names = self._names[body]
            if "log_cholesky" in names:
                return None
            kinds = {
                kind: np.atleast_2d(changes.get(name, values[name]))
                if (name := names.get(kind))
                else self._nominal_value(body, kind)[None]
                for kind in ("mass", "com", "inertia", "payload.mass", "payload.at")
            }
            rows = {kind: np.broadcast_to(v, (count, v.shape[1])) for kind, v in kinds.items()}
            for k, reason in find_unphysical(rows, names).items():
                reasons.setdefault(k, reason)
            moments[body] = moments_of_rows(rows)
        return moments, reasons

    def _dynamic(self, body: int, values: Mapping[str, Array]) -> tuple[Array, dict[str, Array]]:
        names = self._names[body]
        if name := names.get("log_cholesky"):
            log_cholesky = pin.LogCholeskyParameters(values[name])
            jacobian = np.asarray(log_cholesky.calculateJacobian())[_TO_PINOCCHIO]
            total = np.asarray(log_cholesky.toDynamicParameters())[_TO_PINOCCHIO]
            _refuse_unphysical(total, name)
            return total, {name: jacobian}
        m, c, moments, load, load_at = (
            values[names[kind]] if kind in names else self._nominal_value(body, kind)
            for kind in ("mass", "com", "inertia", "payload.mass", "payload.at")
        )
        if "mass" in names and not m[0] > 0.0:
            raise InputError(f"parameters: '{names['mass']}' must be above zero, got {m[0]:g}")
        if load[0] < 0.0:
            raise InputError(
                f"parameters: '{names['payload.mass']}' must not be negative, got {load[0]:g}"
            )
        total, by_mass, by_centre = _point_moments(float(m[0]), c)
        total[4:] += moments
        load_moments, by_load, by_place = _point_moments(float(load[0]), load_at)
        total += load_moments
        by_moments = np.eye(10)[:, 4:]
        if "inertia" in names:
            at_centre = np.concatenate([m, np.zeros(3), moments])
            _refuse_unphysical(at_centre, names["inertia"])
        derivatives = {
            "mass": by_mass[:, None],
            "com": by_centre,
            "inertia": by_moments,
            "payload.mass": by_load[:, None],
            "payload.at": by_place,
        }
        return total, {names[kind]: slope for kind, slope in derivatives.items() if kind in names}

    def perturbed(self, rng: np.random.Generator) -> dict[str, Array]:
        """Return random physical values that differ from those of the system."""
        values = {}
        for entry in self.parameters:
            body = self._body(entry)
            reach = np.sqrt(np.trace(body.inertia) / max(body.mass, 1e-300)) + 1e-3
            value = _value(body, entry.kind)
            if entry.kind == "mass":
                value = value * rng.uniform(1.2, 1.8)
            elif entry.kind == "payload.mass":
                value = np.array([body.mass * rng.uniform(0.2, 0.8)])
            elif entry.kind == "inertia":
                A = rng.normal(size=(3, 3))
                spread = np.trace(body.inertia) * A @ A.T / np.trace(A @ A.T)
                moments = np.trace(spread) * np.eye(3) - spread
                value = value + np.array([moments[i, j] for i, j in _PAIRS])
            elif entry.kind == "log_cholesky":
                value = value + 0.2 * rng.normal(size=10)
            else:
                value = value + reach * rng.normal(size=3)
            values[entry.name] = value
        return values

    def _nominal_value(self, body: int, kind: str) -> Array:
        """Return the cached nominal value of one kind of parameter for a body."""
        if (body, kind) not in self._nominal:
            inertia = self._system.sorted_model.inertias[body + 1]
            self._nominal[body, kind] = read_only(_value(inertia, kind))
        return self._nominal[body, kind]

    def _body(self, parameter: BodyParameter) -> pin.Inertia:
        return self._system.sorted_model.inertias[parameter.body + 1]


def numbers(value: Any, name: str, size: int) -> Array:
    """Return a parameter's value as a new array, (size,).

    Raises ShapeError with the name of the parameter if the length or type is wrong.
    """
    if type(value) is np.ndarray and value.shape == (size,) and value.dtype == float:
        copied: Array = value.copy()
        if np.isfinite(copied).all():
            return copied
    what = f"parameters['{name}']"
    return np.array(vector(np.atleast_1d(as_floats(value, what)), size, what))


def inertia_of(moments: Array) -> pin.Inertia:
    """Convert moments about the joint's origin, (10,), to a Pinocchio inertia."""
    return pin.Inertia.FromDynamicParameters(moments[_TO_PINOCCHIO])


def _value(body: pin.Inertia, kind: str) -> Array:
    """Compute the value of one kind of parameter from a body's inertia."""
    if kind == "mass":
        return np.array([body.mass])
    if kind == "com":
        return np.array(body.lever)
    if kind == "inertia":
        return np.array([body.inertia[i, j] for i, j in _PAIRS])
    if kind == "log_cholesky":
        try:
            pseudo = pin.PseudoInertia.FromInertia(body)
            return np.asarray(
                pin.LogCholeskyParameters(_log_cholesky(pseudo.toMatrix())).parameters
            )
        except np.linalg.LinAlgError:
            raise InputError(
                "a body whose mass lies in a plane, on a line or in a point has no log-Cholesky "
                "parameters; vary mass, com and payload"
            ) from None
    return np.zeros(SIZES[kind])


def _log_cholesky(J: Array) -> Array:
    """Compute Pinocchio's log-Cholesky parameters, (10,), of a pseudo-inertia J = U Uᵀ, (4, 4)."""
    U = np.linalg.cholesky(J[::-1, ::-1])[::-1, ::-1]
    scaled = U / U[3, 3]
    diagonal = np.log(np.append(U[3, 3], np.diag(scaled)[:3]))
    return np.append(diagonal, scaled[[0, 1, 0, 0, 1, 2], [1, 2, 2, 3, 3, 3]])


def _point_moments(m: float, c: Array) -> tuple[Array, Array, Array]:
    """Compute the moments of a point mass about the origin, and their derivatives.

    Args:
        m: Mass [kg].
        c: Position of the mass, (3,) [m].
    Returns:
        Mass, first and second moments, (10,), and their derivatives with respect to m, (10,), and
        to c, (10, 3).
    """
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


def _refuse_unphysical(moments: Array, name: str) -> None:
    """Raise InputError unless the pseudo-inertia of (10,) moments is positive semidefinite."""
    if not np.isfinite(moments).all():
        raise InputError(f"parameters: '{name}' is too large, so that moments are not finite")
    pseudo = pin.PseudoInertia.FromDynamicParameters(moments[_TO_PINOCCHIO])
    eigenvalues = np.linalg.eigvalsh(pseudo.toMatrix())
    if not eigenvalues[0] >= -LEAST * eigenvalues[-1]:
        raise InputError(
            f"parameters: '{name}' is not physical: no positive masses have these moments (each "
            "principal moment is at most the sum of the other two)"
        )
