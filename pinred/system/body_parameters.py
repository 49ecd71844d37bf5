"""Inertial parameters of links and bodies by name, such as "hand.mass".

A body consists of all links that are fixed to each other, and moves with one joint.  "hand.mass",
"hand.com" and "hand.inertia" are those of the link alone, in its own frame, as in the file; pinred
recombines them with the links that are fixed to it.  "hand.body.mass" and so on are those of the
whole body, in the frame of its joint.  A joint names its body, if at most one of its links has
mass.  A payload is a point mass on the body, in the frame of its joint.

Mass, centre of mass and moments about the centre vary independently.  Any positive mass with any
centre is physical; moments are validated.  Log-Cholesky parameters are always physical (C. Rucker,
P. Wensing, Smooth parameterization of rigid-body inertia, IEEE Robotics and Automation Letters 7
(2022) 2771–2778).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from ..common.arrays import Array, as_floats, read_only, vector
from ..common.errors import InputError
from ..common.memo import once
from ..common.names import listed, nearest, quoted
from .locked_joints import moments_of as moments_of_pseudo
from .system import System

# Number of values of each property of an inertia, and of a payload.
_OWN = {"mass": 1, "com": 3, "inertia": 6, "log_cholesky": 10}
_PAYLOAD = {"payload.mass": 1, "payload.at": 3}
# Number of values of each kind of parameter.  "link.mass" is another name of "mass" that never
# means the body, for files that earlier versions read differently.
SIZES = {
    **_OWN, **_PAYLOAD, **{f"body.{kind}": n for kind, n in _OWN.items()},
    **{f"link.{kind}": n for kind, n in _OWN.items()},
}  # fmt: skip
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # entries xx, xy, xz, yy, yz, zz
# Permutation from pinred's order of moments to that of Pinocchio's dynamic parameters (xx, xy, yy,
# xz, yz, zz).  The permutation is its own inverse.
_TO_PINOCCHIO = [0, 1, 2, 3, 4, 5, 7, 6, 8, 9]
# Eigenvalues of a pseudo-inertia below this fraction of the largest one count as round-off.
_LEAST = 1e-12
# Moments of a body beyond those of its links, such as rotors, count above this fraction of them.
# Smaller ones are round-off.
_REST = 1e-9
# Keys of the parts of a body: name of the link, and whether the part is a payload.
_WHOLE, _LOAD = ("", False), ("", True)


@dataclass(frozen=True)
class BodyParameter:
    """A parameter of a body.

    Attributes:
        name: Name of the parameter.
        body: Index of the body, 0 for the root.
        kind: Property of the inertia or the payload, such as "mass" or "payload.mass".
        link: Link whose property it is; "" for the whole body.
    """

    name: str
    body: int
    kind: str
    link: str = ""

    @property
    def size(self) -> int:
        """Number of values."""
        return SIZES[self.kind]


def body_parameter(system: System, name: str) -> BodyParameter | None:
    """Return the body parameter that a name denotes, or None if the name has another form.

    Raises:
        InputError: The link or joint is unknown, or it is a joint that moves several links with
            mass, so that the name is vague.
    """
    word_and_kind = _split(system, name)
    if word_and_kind is None:
        return None
    word, kind = word_and_kind
    bodies = body_names(system)
    if word not in bodies:
        names = list(bodies)
        raise InputError(
            f"parameters: '{system.name}' has no link or joint {quoted(word)}; "
            f"{nearest(word, names)}they are {listed(names, 60)}"
        )
    body = bodies[word]
    whose, _, entry = kind.rpartition(".")
    if whose in ("body", "payload"):
        return BodyParameter(name, body, entry if whose == "body" else kind)
    links = _links_of(system, body)
    heavy = [link for link, link_part in links.items() if link_part.inertia.mass > 0.0]
    if word not in links:
        if len(heavy) > 1 or whose:
            raise InputError(
                f"parameters: {quoted(name)}: joint {quoted(word)} moves the links "
                f"{listed(heavy or links, 6) or 'none'}. Write '{word}.body.{entry}' for the whole "
                f"body, or 'LINK.{entry}' for one of these links"
            )
        return BodyParameter(name, body, entry)
    has_known_mass = heavy or not system.sorted_model.inertias[body + 1].mass
    alone = all(link == word for link in heavy) and links[word].at.isIdentity(0.0)
    is_body = not has_known_mass or (alone and not _rest(system, body).any())
    return BodyParameter(name, body, entry, "" if is_body else word)


def _split(system: System, name: str) -> tuple[str, str] | None:
    """Return the name of the link or joint, and the kind; None if the name has another form."""
    kinds = [kind for kind in SIZES if isinstance(name, str) and name.endswith(f".{kind}")]
    splits = [(name[: -len(kind) - 1], kind) for kind in sorted(kinds, key=len, reverse=True)]
    bodies = body_names(system) if splits else {}
    return next((split for split in splits if split[0] in bodies), splits[0] if splits else None)


def body_names(system: System) -> dict[str, int]:
    """Return {name of link or joint: body index}; link names take precedence."""
    model = system.sorted_model
    joints = {str(model.names[i]): i - 1 for i in range(1, model.njoints)}
    links = [f for f in model.frames if f.type == pin.FrameType.BODY and f.parentJoint > 0]
    return joints | {str(f.name): int(f.parentJoint) - 1 for f in links}


def whole_body(system: System, body: int) -> str:
    """Return the name of a body: that of its joint, with ".body" if it may be another's."""
    joint = str(system.sorted_model.names[body + 1])
    links = _links_of(system, body)
    heavy = [link for link, part in links.items() if part.inertia.mass > 0.0]
    is_other = body_names(system)[joint] != body or joint in links
    return f"{joint}.body" if is_other or len(heavy) > 1 else joint


def refuse_vague(system: System, name: str) -> None:
    """Reject a name in a file that earlier versions of pinred read as the whole body.

    Args:
        system: Robot.
        name: Name of a parameter of any kind, or of an entry of one.
    Raises:
        InputError: The name states neither "link" nor "body", and the link's values differ from
            those of its body.
    """
    if _split(system, name) is None:
        name = name.rpartition(".")[0]
    word_and_kind = _split(system, name)
    if word_and_kind is None or word_and_kind[0] not in body_names(system):
        return  # Another message names what is unknown.
    parameter = body_parameter(system, name)
    if parameter is None or not parameter.link or name != f"{parameter.link}.{parameter.kind}":
        return
    body, kind = parameter.body, parameter.kind
    links = _links_of(system, body)
    other_links = [
        n for n, part in links.items() if part.inertia.mass > 0.0 and n != parameter.link
    ]
    if kind == "mass" and not other_links:
        return
    fixed = (
        f"is fixed to {listed(other_links, 6)}"
        if other_links
        else "is not in the frame of its joint"
    )
    raise InputError(
        f"parameters: {quoted(name)} in a file is vague, since link {quoted(parameter.link)} "
        f"{fixed}: write '{parameter.link}.link.{kind}' for the link alone, or "
        f"'{parameter.link}.body.{kind}' for the whole body"
    )


def name_in_files(system: System, name: str) -> str:
    """Return the name of a parameter that files contain; see `refuse_vague`."""
    parameter = body_parameter(system, name)
    if parameter is None or not parameter.link:
        return name
    return f"{parameter.link}.link.{parameter.kind}"


def link_inertias(model: pin.Model) -> dict[str, pin.Inertia]:
    """Return the inertia of each link with mass, in its own frame, as far as a model states it.

    Pinocchio keeps the inertia of a link that is fixed to another in the frame of the fixed joint.
    Where no link is fixed to another, the inertia belongs to the joint, and no link is stated.
    """
    inertias = dict[str, pin.Inertia]()
    moments = [moments_of(inertia) for inertia in model.inertias]
    moving, carrying = dict[int, list[str]](), set[int]()
    for frame in model.frames:
        joint = int(frame.parentJoint)
        if frame.type != pin.FrameType.BODY or not joint:
            continue
        above = model.frames[frame.parentFrame]
        if above.type != pin.FrameType.FIXED_JOINT or above.parentJoint != joint:
            moving.setdefault(joint, []).append(str(frame.name))
        elif above.inertia.mass > 0.0:
            at_joint = above.placement.act(above.inertia)
            inertias[str(frame.name)] = frame.placement.actInv(at_joint)
            moments[joint] -= moments_of(at_joint)
            carrying.add(joint)
    for joint in carrying:
        names = moving.get(joint, [])
        if moments[joint][0] > _REST * model.inertias[joint].mass and len(names) == 1:
            place = model.frames[model.getFrameId(names[0], pin.FrameType.BODY)].placement
            inertias[names[0]] = place.actInv(inertia_of(moments[joint]))
    return inertias


@dataclass(frozen=True, eq=False)
class _Link:
    """A link of a body.

    Attributes:
        at: Placement of the link on the body.
        inertia: Inertia of the link, in its own frame.
    """

    at: pin.SE3
    inertia: pin.Inertia

    @cached_property
    def moved(self) -> Array:
        """Matrix from moments about the link's origin to those about the joint's, (10, 10)."""
        T = self.at.homogeneous
        columns = [moments_of_pseudo(T @ _pseudo(unit) @ T.T) for unit in np.eye(10)]
        return read_only(np.transpose(columns))


def _links_of(system: System, body: int) -> dict[str, _Link]:
    """Return the links of a body, by name."""

    def make() -> dict[int, dict[str, _Link]]:
        stated = system.contents.links or link_inertias(system.sorted_model)
        links = dict[int, dict[str, _Link]]()
        for frame in system.sorted_model.frames:
            if frame.type == pin.FrameType.BODY and frame.parentJoint > 0:
                name, of_body = str(frame.name), links.setdefault(int(frame.parentJoint) - 1, {})
                inertia = stated.get(name, pin.Inertia.Zero())
                of_body.setdefault(name, _Link(frame.placement.copy(), inertia))
        return links

    return once(system, _Link, make).get(body, {})


def _rest(system: System, body: int) -> Array:
    """Return the moments of a body beyond those of its links, (10,); zeros if they are round-off.

    Rotors of a root belong to no link.
    """
    total = moments_of(system.sorted_model.inertias[body + 1])
    links = [link.moved @ moments_of(link.inertia) for link in _links_of(system, body).values()]
    difference = total - np.sum([np.zeros(10), *links], axis=0)
    scale = np.abs([total, *links]).sum(axis=0)
    return np.where(np.abs(difference) > _REST * scale, difference, 0.0)


@dataclass(frozen=True, eq=False)
class _Part:
    """The inertia of a link, or of a whole body, as a function of parameters.

    Attributes:
        inertia: Inertia in the file.
        names: {kind: name of the parameter}.
        moved: Matrix from its moments to those about the joint's origin, (10, 10); None for the
            identity.
    """

    inertia: pin.Inertia
    names: dict[str, str] = field(default_factory=dict)
    moved: Array | None = None

    @cached_property
    def own(self) -> dict[str, Array]:
        """Mass, centre and moments in the file, and no payload."""
        kinds = ("mass", "com", "inertia", *_PAYLOAD)
        return {kind: read_only(_value(self.inertia, kind)) for kind in kinds}

    def moments(self, values: Mapping[str, Array]) -> tuple[Array, dict[str, Array]]:
        """Compute the moments about the joint's origin, and their derivatives.

        Args:
            values: Values of all parameters, {name: (size,)}.
        Returns:
            Moments, (10,), and their derivatives, {name: (10, size)}.
        Raises:
            InputError: The values are not physical.
        """
        names = self.names
        if name := names.get("log_cholesky"):
            log_cholesky = pin.LogCholeskyParameters(values[name])
            slopes = {name: np.asarray(log_cholesky.calculateJacobian())[_TO_PINOCCHIO]}
            total = np.asarray(log_cholesky.toDynamicParameters())[_TO_PINOCCHIO]
            if not np.isfinite(total).all():
                raise InputError(
                    f"parameters: '{name}' is too large, so that moments are not finite"
                )
        else:
            row = {
                kind: values[names[kind]] if kind in names else v for kind, v in self.own.items()
            }
            for reason in self.find_unphysical({k: v[None] for k, v in row.items()}).values():
                raise InputError(reason)
            total, slopes = _moments(row, names)
        if self.moved is None:
            return total, slopes
        moved = {name: self.moved @ slope for name, slope in slopes.items()}
        return (self.moved @ total[:, None])[:, 0], moved

    def rows(self, values: Mapping[str, Array]) -> Array:
        """Compute moments for many values, {kind: (N, size)}; rows have the bits of `moments`."""
        total = values["mass"] * _moments_of_unit_masses(values["com"])
        total[:, 4:] += values["inertia"]
        if self.names.keys() & _PAYLOAD:
            total += values["payload.mass"] * _moments_of_unit_masses(values["payload.at"])
        return total if self.moved is None else (self.moved @ total[:, :, None])[:, :, 0]

    def find_unphysical(self, values: Mapping[str, Array]) -> dict[int, str]:
        """Return {row: reason} of the rows, {kind: (N, size)}, that no physical body has."""
        reasons: dict[int, str] = {}
        least = self.inertia.mass  # A link without mass may stay so.
        for kind, rule in (("mass", "be above zero"), ("payload.mass", "not be negative")):
            if kind in self.names:
                column = values[kind][:, 0]
                valid = (column > 0.0) | ((column == 0.0) & (kind != "mass" or least == 0.0))
                for k in np.flatnonzero(~valid).tolist():
                    text = f"parameters: '{self.names[kind]}' must {rule}, got {column[k]:g}"
                    reasons.setdefault(k, text)
        if name := self.names.get("inertia"):
            for k in np.flatnonzero(~_are_physical(values["mass"], values["inertia"])).tolist():
                reasons.setdefault(
                    k,
                    f"parameters: '{name}' is not physical: no positive masses have these moments "
                    "(each principal moment is at most the sum of the other two)",
                )
        return reasons

    def perturbed(self, kind: str, rng: np.random.Generator, body: pin.Inertia) -> Array:
        """Return a random physical value that differs from that of the file.

        Args:
            kind: Kind of parameter.
            rng: Random numbers.
            body: Inertia of the body, for scale.
        """
        inertia = self.inertia if self.inertia.mass > 0.0 else body
        reach = float(np.sqrt(np.trace(inertia.inertia) / max(inertia.mass, 1e-300))) + 1e-3
        if kind == "mass":
            return np.array([float(inertia.mass) * rng.uniform(1.2, 1.8)])
        if kind == "payload.mass":
            return np.array([float(inertia.mass) * rng.uniform(0.2, 0.8)])
        value: Array = _value(self.inertia, kind)
        if kind == "inertia":
            A = rng.normal(size=(3, 3))
            spread = np.trace(inertia.inertia) * A @ A.T / np.trace(A @ A.T)
            moments = np.trace(spread) * np.eye(3) - spread
            added: Array = np.array([moments[i, j] for i, j in _PAIRS])
            return value + added
        if kind == "log_cholesky":
            return value + 0.2 * rng.normal(size=10)
        return value + reach * rng.normal(size=3)


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
            InputError: Two parameters set the same property of a link or a body.
        """
        self._system = system
        parameters = [body_parameter(system, name) for name in names]
        self.parameters = tuple(entry for entry in parameters if entry is not None)
        self.free = tuple(sorted({entry.body for entry in self.parameters}))
        self._body_of = {entry.name: entry.body for entry in self.parameters}
        self._parts: dict[int, dict[tuple[str, bool], _Part]] = {body: {} for body in self.free}
        self._last: dict[int, tuple[list[Array], tuple[Array, dict[str, Array]]]] = {}
        for entry in self.parameters:
            part = self._part(entry)
            if other := part.names.get(entry.kind):
                raise InputError(
                    f"parameters: '{entry.name}' and '{other}' belong to the same body. Name one "
                    "of them."
                )
            part.names[entry.kind] = entry.name
        self._fixed = {body: self._fixed_moments(body) for body in self.free}

    def _part(self, entry: BodyParameter) -> _Part:
        """Return the part of a body that a parameter changes; make it at first."""
        by_link, key = self._parts[entry.body], (entry.link, entry.kind in _PAYLOAD)
        if key not in by_link:
            if key == _LOAD:
                by_link[key] = _Part(pin.Inertia.Zero())
            elif key == _WHOLE:
                by_link[key] = _Part(self._body(entry.body))
            else:
                link = _links_of(self._system, entry.body)[entry.link]
                by_link[key] = _Part(link.inertia, moved=link.moved)
        return by_link[key]

    def _fixed_moments(self, body: int) -> Array:
        """Return the moments of a body that its parameters do not change, (10,).

        Raises:
            InputError: Two parameters set the same property.
        """
        by_link = self._parts[body]
        links = [key for key in by_link if key not in (_WHOLE, _LOAD)]
        first = {key: next(iter(part.names.values())) for key, part in by_link.items()}
        if _WHOLE in by_link and links:
            raise InputError(
                f"parameters: '{first[_WHOLE]}' sets the whole body, of which '{first[links[0]]}' "
                "sets a link. Omit one of them."
            )
        for key, part in by_link.items():
            other_names = [name for kind, name in part.names.items() if kind != "log_cholesky"]
            other_names += [first[_LOAD]] if key == _WHOLE and _LOAD in by_link else []
            if "log_cholesky" in part.names and other_names:
                raise InputError(
                    f"parameters: '{part.names['log_cholesky']}' sets all parameters of a "
                    f"{'body' if key == _WHOLE else 'link'}. Omit '{other_names[0]}'."
                )
        if _WHOLE in by_link:
            return np.zeros(10)
        if not links:
            return moments_of(self._body(body))
        total = _rest(self._system, body)
        for name, link in _links_of(self._system, body).items():
            if (name, False) not in by_link:
                total = total + link.moved @ moments_of(link.inertia)
        return total

    def _body(self, body: int) -> pin.Inertia:
        return self._system.sorted_model.inertias[body + 1]

    def own(self) -> dict[str, Array]:
        """Return the current values of the parameters in the system, {name: (size,)}."""
        return {
            entry.name: _value(self._part(entry).inertia, entry.kind) for entry in self.parameters
        }

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
        by_link = self._parts[body].values()
        own_values = [values[name] for part in by_link for name in part.names.values()]
        last = self._last.get(body)
        if last is None or any(a is not b for a, b in zip(last[0], own_values, strict=True)):
            moments = [part.moments(values) for part in by_link]
            total = self._fixed[body].copy()
            for of_part, _ in moments:
                total += of_part
            slopes = {name: slope for _, by_name in moments for name, slope in by_name.items()}
            last = own_values, (total, slopes)
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
            total = np.repeat(self._fixed[body][None], count, axis=0)
            for part in self._parts[body].values():
                if "log_cholesky" in part.names:
                    return None
                rows = {
                    kind: np.broadcast_to(
                        np.atleast_2d(changes.get(name, values[name]))
                        if (name := part.names.get(kind))
                        else own[None],
                        (count, len(own)),
                    )
                    for kind, own in part.own.items()
                }
                for k, reason in part.find_unphysical(rows).items():
                    reasons.setdefault(k, reason)
                total += part.rows(rows)
            moments[body] = total
        return moments, reasons

    def perturbed(self, rng: np.random.Generator) -> dict[str, Array]:
        """Return random physical values that differ from those of the system."""
        return {
            entry.name: self._part(entry).perturbed(entry.kind, rng, self._body(entry.body))
            for entry in self.parameters
        }


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


def moments_of(inertia: pin.Inertia) -> Array:
    """Convert a Pinocchio inertia to moments about the origin of its frame, (10,)."""
    return np.array(inertia.toDynamicParameters())[_TO_PINOCCHIO]


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
    return np.zeros(_PAYLOAD[kind])


def _log_cholesky(J: Array) -> Array:
    """Compute Pinocchio's log-Cholesky parameters, (10,), of a pseudo-inertia J = U Uᵀ, (4, 4)."""
    U = np.linalg.cholesky(J[::-1, ::-1])[::-1, ::-1]
    scaled = U / U[3, 3]
    diagonal = np.log(np.append(U[3, 3], np.diag(scaled)[:3]))
    return np.append(diagonal, scaled[[0, 1, 0, 0, 1, 2], [1, 2, 2, 3, 3, 3]])


def _moments(row: Mapping[str, Array], names: Mapping[str, str]) -> tuple[Array, dict[str, Array]]:
    """Compute the moments of an inertia with a payload, and their derivatives.

    Args:
        row: Values of the kinds mass, com, inertia, payload.mass and payload.at, (size,) each.
        names: {kind: name of the parameter}.
    Returns:
        Moments, (10,), and their derivatives with respect to the parameters, {name: (10, size)}.
    """
    total, by_mass, by_centre = _point(float(row["mass"][0]), row["com"])
    total[4:] += row["inertia"]
    load, by_load, by_place = _point(float(row["payload.mass"][0]), row["payload.at"])
    if names.keys() & _PAYLOAD:
        total += load
    derivatives = {
        "mass": by_mass[:, None],
        "com": by_centre,
        "inertia": np.eye(10)[:, 4:],
        "payload.mass": by_load[:, None],
        "payload.at": by_place,
    }
    return total, {names[kind]: slope for kind, slope in derivatives.items() if kind in names}


def _point(m: float, c: Array) -> tuple[Array, Array, Array]:
    """Compute the moments of a point mass about the origin, and their derivatives.

    Args:
        m: Mass [kg].
        c: Position of the mass, (3,) [m].
    Returns:
        Mass, first and second moments, (10,), and their derivatives with respect to m, (10,), and
        to c, (10, 3).
    """
    x, y, z = c.tolist()
    by_mass = _moments_of_unit_masses(c[None])[0]
    by_centre = m * np.array([
        [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0],
        [0.0, 2.0 * y, 2.0 * z], [-y, -x, 0.0], [-z, 0.0, -x],
        [2.0 * x, 0.0, 2.0 * z], [0.0, -z, -y], [2.0 * x, 2.0 * y, 0.0],
    ])  # fmt: skip
    return m * by_mass, by_mass, by_centre


def _moments_of_unit_masses(c: Array) -> Array:
    """Compute the moments, (N, 10), of point masses of 1 kg at c (N, 3) about the origin."""
    x, y, z = c.T
    second = y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y
    return np.stack([np.ones_like(x), x, y, z, *second], axis=1)


def _pseudo(moments: Array) -> Array:
    """Return the pseudo-inertia, (4, 4), of moments, (10,)."""
    m, x, y, z, xx, xy, xz, yy, yz, zz = moments
    half = 0.5 * (xx + yy + zz)
    return np.array([
        [half - xx, -xy, -xz, x], [-xy, half - yy, -yz, y], [-xz, -yz, half - zz, z], [x, y, z, m],
    ])  # fmt: skip


def _are_physical(mass: Array, moments: Array) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return whether pseudo-inertias at the centre of mass are positive semidefinite, (N,)."""
    xx, xy, xz, yy, yz, zz = moments.T
    pseudo = np.zeros((len(moments), 4, 4))
    half = 0.5 * (xx + yy + zz)
    for i, value in enumerate((half - xx, half - yy, half - zz, mass[:, 0])):
        pseudo[:, i, i] = value
    for (i, j), value in zip(((0, 1), (0, 2), (1, 2)), (xy, xz, yz), strict=True):
        pseudo[:, i, j] = pseudo[:, j, i] = -value
    eigenvalues = np.linalg.eigvalsh(pseudo)
    return np.asarray(eigenvalues[:, 0] >= -_LEAST * eigenvalues[:, -1])
