"""Bodies whose inertias, steps or links are variable parameters, that is, inputs of a kernel.

Inertias in the body frames of the sweep depend linearly on inertias in the joint frames.  A kernel
takes inertias in the frames of the sweep, and cosines and sines of the angles of a step, so that it
needs no divisions or trigonometric functions for its parameters.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...common.memo import once
from ...system.system import System, nominal
from .body_frames import Body, bodies_of, cosine, sine
from .scalars import Scalar, add

NUMBERS = 10  # parameters of an inertia: mass, moment (3,), inertia about the origin (6,)
STEP = 8  # parameters of a step: cosine and sine of α and of δ, the joint's offset, shift (3,)
LINK = 12  # parameters of a link's placement on its body: rotation, row by row, and origin (3,)
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_ANGLES, _OFFSET, _SHIFT = (slice(0, 2), slice(2, 4)), slice(4, 5), slice(5, 8)  # slices of a step
_FOLDED = {"0": 0.0, "+": 1.0, "-": -1.0}  # constant for each pattern character
_FOLDED_AS = {number: letter for letter, number in _FOLDED.items()}


@dataclass(frozen=True)
class Freed:
    """The parameters of bodies that are inputs of a kernel.

    Attributes:
        inertias: Indices of the bodies with variable inertias, 0 for the root.
        steps: Indices of the bodies with variable steps from their parents, each with a pattern of
            STEP characters: "x" for an input, "0", "+" and "-" for the constants 0, 1 and −1,
            "n" for the robot's own value.
        links: Frames of the model, on which forces act, with variable placements on their bodies.
    """

    inertias: tuple[int, ...] = ()
    steps: tuple[tuple[int, str], ...] = ()
    links: tuple[int, ...] = ()

    @property
    def size(self) -> int:
        """Number of inputs, ordered as inertias of all bodies, then all steps, then all links."""
        return self._links_at + LINK * len(self.links)

    @property
    def _links_at(self) -> int:
        return NUMBERS * len(self.inertias) + STEP * len(self.steps)

    def __bool__(self) -> bool:
        return bool(self.inertias or self.steps or self.links)

    def of_inertia(self, body: int) -> slice:
        """Return the slice of a body's inertia among the inputs."""
        first = NUMBERS * self.inertias.index(body)
        return slice(first, first + NUMBERS)

    def of_step(self, body: int) -> slice:
        """Return the slice of a body's step among the inputs."""
        at = [i for i, _ in self.steps].index(body)
        first = NUMBERS * len(self.inertias) + STEP * at
        return slice(first, first + STEP)

    def of_link(self, frame: int) -> slice:
        """Return the slice of a link's placement among the inputs."""
        first = self._links_at + LINK * self.links.index(frame)
        return slice(first, first + LINK)


NOTHING = Freed()


def freed_of(
    system: System,
    inertias: Sequence[int],
    placed: Sequence[int],
    turned: Collection[int],
    links: Sequence[int] = (),
    *,
    generic: bool,
) -> Freed:
    """Select the kernel inputs that make some bodies and links variable.

    Args:
        system: The system.
        inertias: Bodies with variable inertias.
        placed: Bodies with variable joint placements.
        turned: Bodies among `placed` whose joint axes change direction.
        links: Frames with variable placements.
        generic: Whether placements may take any value.  Otherwise the patterns
            follow from the present placements of the system.
    Returns:
        The inputs.
    """
    if not generic:
        bodies, originals = bodies_of(system), bodies_of(nominal(system))
        steps = [(i, _pattern(bodies[i], originals[i])) for i in placed]
    else:
        steps = [(i, "x" * STEP if i in turned else "nnnnnxxx") for i in placed]
    return Freed(tuple(inertias), tuple(steps), tuple(links))


def _pattern(body: Body, original: Body) -> str:
    """Return the pattern of a step's parameters.  original: the body as it was loaded."""
    step, original_step, letters = step_of_body(body), step_of_body(original), _letters(body)
    return "".join(
        "n" * (block.stop - block.start) if block is not _SHIFT and same else letters[block]
        for block in (*_ANGLES, _OFFSET, _SHIFT)
        for same in [np.array_equal(step[block], original_step[block])]
    )


def pattern_of(system: System, body: int) -> str:
    """Return the pattern in which all parameters of a step except 0 and ±1 are inputs."""
    letters = _letters(bodies_of(system)[body])
    return letters[: _OFFSET.start] + "n" + letters[_SHIFT]


def _letters(body: Body) -> str:
    """Return the pattern of a step whose parameters have all changed."""
    step, letters = step_of_body(body), ""
    for angle in _ANGLES:  # quarter turns are constants
        pair = [_FOLDED_AS.get(number, "x") for number in step[angle].tolist()]
        letters += "xx" if "x" in pair else "".join(pair)
    return letters + "x" + "".join("0" if number == 0.0 else "x" for number in step[_SHIFT])


def with_free(bodies: Sequence[Body], freed: Freed, numbers: Sequence[Scalar]) -> list[Body]:
    """Return the bodies with variable parameters replaced by `numbers`, (freed.size,)."""
    changed = list(bodies)
    for i in freed.inertias:
        mass, *moments = numbers[freed.of_inertia(i)]
        moment, inertia = list(moments[:3]), list(moments[3:])
        changed[i] = replace(changed[i], mass=mass, moment=moment, inertia=inertia)
    for i, pattern in freed.steps:
        constants, inputs = step_of_body(bodies[i]), numbers[freed.of_step(i)]
        step = [
            value if letter == "x" else float(constant) if letter == "n" else _FOLDED[letter]
            for letter, value, constant in zip(pattern, inputs, constants, strict=True)
        ]
        alpha, delta = (step[0], step[1]), (step[2], step[3])
        changed[i] = replace(changed[i], alpha=alpha, delta=delta, offset=step[4], r=step[5:])
    return changed


def total_mass(bodies: Sequence[Body]) -> Scalar:
    """Return the mass of all bodies."""
    mass: Scalar = 0.0
    for body in bodies:
        mass = add(mass, body.mass)
    return mass


def frame_map(body: Body) -> Array:
    """Return the map, (10, 10), from inertial parameters in the joint frame to the body's frame.

    The parameters are m, m c, and the inertia xx, xy, xz, yy, yz, zz about the frame's origin.
    """
    R, p = np.asarray(body.frame.rotation), np.asarray(body.frame.translation)
    columns = np.zeros((NUMBERS, NUMBERS))
    for k, unit in enumerate(np.eye(NUMBERS)):
        m, h = unit[0], unit[1:4]
        I = np.zeros((3, 3))
        for value, (i, j) in zip(unit[4:], _PAIRS, strict=True):
            I[i, j] = I[j, i] = value
        about_p = I - 2.0 * (h @ p) * np.eye(3) + np.outer(h, p) + np.outer(p, h)
        about_p += m * (p @ p * np.eye(3) - np.outer(p, p))
        in_frame = R.T @ about_p @ R
        columns[0, k], columns[1:4, k] = m, R.T @ (h - m * p)
        columns[4:, k] = [in_frame[i, j] for i, j in _PAIRS]
    return columns


def step_slopes(parent: Body, body: Body) -> Array:
    """Return the derivatives (STEP, 6) of a step with respect to a twist of the placement.

    `body` has its present placement.  The twist is in the frame of the parent's joint, about its
    origin.
    """
    (ca, sa), (cd, sd) = body.alpha, body.delta
    c, s = body.beta
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    in_frame = parent.frame.toActionMatrixInverse()
    # ω = e_x α̇ + Rx e_y δ̇ + Rx Ry e_z ε̇, after the rotation by β.
    axes = np.array([[1.0, 0.0, sd], [0.0, ca, -sa * cd], [0.0, sa, ca * cd]])
    rates = np.linalg.solve(axes, turn @ in_frame[3:])
    shift = in_frame[:3] - pin.skew(np.array(body.r, dtype=float)) @ in_frame[3:]
    angles = [-sa * rates[0], ca * rates[0], -sd * rates[1], cd * rates[1], rates[2]]
    return np.vstack([*angles, shift])


def step_of_body(body: Body) -> Array:
    """Return the parameters (STEP,) of a body's step."""
    return np.array(_step_of(body), dtype=float)


def _step_of(body: Body) -> list[Scalar]:
    return [*body.alpha, *body.delta, body.offset, *body.r]


def other_placement(
    parent: Body, body: Body, pattern: str, length: float, rng: np.random.Generator
) -> pin.SE3:
    """Return a random placement of a body's joint within the pattern of its step.

    Args:
        parent: Parent body.
        body: The body.
        pattern: Pattern of the body's step, see `Freed`.
        length: Length of the robot [m].
        rng: Random generator.
    Returns:
        The placement.
    """
    step = step_of_body(body)
    size = 0.1 * length + float(np.linalg.norm(np.asarray(body.r, dtype=float)))
    angles = [np.arctan2(step[1], step[0]), np.arctan2(step[3], step[2])]
    for k in (0, 1):
        if "x" in pattern[2 * k : 2 * k + 2]:
            angles[k] += rng.uniform(0.1, 0.4)
    if pattern[4] == "x":
        step[4] += rng.uniform(-1.0, 1.0)
    for k in range(5, STEP):
        if pattern[k] == "x":
            step[k] += size * rng.uniform(0.1, 0.5)
    a, d = ((cosine(float(angle)), sine(float(angle))) for angle in angles)
    R = np.eye(3)
    for (c, s), axis in zip(
        (body.beta, a, d, (np.cos(step[4]), np.sin(step[4]))), "zxyz", strict=True
    ):
        R = R @ pin.utils.rotate(axis, float(np.arctan2(s, c)))
    return parent.frame * pin.SE3(R, step[5:]) * body.frame.inverse()


def of_bodies(bodies: Sequence[Body], freed: Freed) -> list[Scalar]:
    """Return the variable parameters of the inertias and steps of bodies.

    Args:
        bodies: Bodies of the system, root first.
        freed: Which parameters are variable.
    Returns:
        Numbers, or symbols if the bodies contain symbols: first inertias, then steps.
    """
    variable = [bodies[i] for i in freed.inertias]
    inertias = [n for body in variable for n in (body.mass, *body.moment, *body.inertia)]
    return inertias + [number for i, _ in freed.steps for number in _step_of(bodies[i])]


def link_numbers(body: Body, place: pin.SE3) -> Array:
    """Return the parameters (LINK,) of a link; place: placement in its body's joint frame."""
    in_frame = body.frame.actInv(place)
    return np.concatenate([np.asarray(in_frame.rotation).ravel(), in_frame.translation])


def link_slopes(body: Body, place: pin.SE3, twists: Array) -> Array:
    """Return the derivatives of a link's parameters along N twists of its placement.

    Args:
        body: Body of the link.
        place: Placement of the link in the frame of the body's joint.
        twists: Twists in this frame, about its origin, (6, N).
    Returns:
        Derivatives, (LINK, N).
    """
    R, derivatives = body.frame.rotation.T, np.empty((LINK, twists.shape[1]))
    for k, (v, w) in enumerate(zip(twists[:3].T, twists[3:].T, strict=True)):
        derivatives[:9, k] = (R @ pin.skew(w) @ place.rotation).ravel()
        derivatives[9:, k] = R @ (v + np.cross(w, place.translation))
    return derivatives


def free_numbers(system: System, freed: Freed) -> Array:
    """Return the variable parameters of a system, (freed.size,), as inputs of a kernel."""
    if not freed:
        return np.empty(0)

    def make() -> Array:
        bodies, frames = bodies_of(system), system.sorted_model.frames
        links = [link_numbers(bodies[frames[k].parentJoint - 1], frames[k].placement)
                 for k in freed.links]  # fmt: skip
        return np.concatenate([np.array(of_bodies(bodies, freed), dtype=float), *links])

    return once(system, (free_numbers, freed), make)
