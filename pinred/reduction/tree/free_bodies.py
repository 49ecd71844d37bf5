"""Bodies whose inertias, steps from their parents and links are symbols, in the sweep's frames.

In these frames inertias are linear in those in the joint's own frame, so that a kernel takes them
as they come and no division or sine of them is in it.  Of a step, it takes cosines and sines.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...common.memo import once
from ...system.system import System
from ...system.variants import nominal
from .body_frames import Body, bodies_of, cosine, sine
from .scalars import Scalar, add

NUMBERS = 10  # of an inertia: mass, moment (3,), inertia about the origin (6,)
STEP = 8  # of a step: cosine and sine of α and of δ, the joint's offset, shift (3,)
LINK = 12  # of a link's place on its body: rotation, row by row, and origin (3,)
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_ANGLES, _OFFSET, _SHIFT = (slice(0, 2), slice(2, 4)), slice(4, 5), slice(5, 8)  # of a step
_FOLDED = {"0": 0.0, "+": 1.0, "-": -1.0}
_FOLDED_AS = {number: word for word, number in _FOLDED.items()}


@dataclass(frozen=True)
class Freed:
    """The numbers of bodies that are inputs of a kernel.

    inertias: indices of the bodies, 0 for the root, whose inertias are.  steps: of those whose
    steps from their parents are, with the pattern of each: for its STEP numbers, "x" for an
    input, "0", "+" and "-" for 0, 1 and −1, "n" for the number that the robot has.  links: frames
    of the model whose places on their bodies are, of those that forces act on.
    """

    inertias: tuple[int, ...] = ()
    steps: tuple[tuple[int, str], ...] = ()
    links: tuple[int, ...] = ()

    @property
    def size(self) -> int:
        """How many numbers the kernel takes: of all bodies, then of all steps, then of links."""
        return self._links_at + LINK * len(self.links)

    @property
    def _links_at(self) -> int:
        return NUMBERS * len(self.inertias) + STEP * len(self.steps)

    def __bool__(self) -> bool:
        return bool(self.inertias or self.steps or self.links)

    def of_inertia(self, body: int) -> slice:
        """Return the place of a body's inertia among the numbers."""
        first = NUMBERS * self.inertias.index(body)
        return slice(first, first + NUMBERS)

    def of_step(self, body: int) -> slice:
        """Return the place of a body's step among the numbers."""
        at = [i for i, _ in self.steps].index(body)
        first = NUMBERS * len(self.inertias) + STEP * at
        return slice(first, first + STEP)

    def of_link(self, frame: int) -> slice:
        """Return the place of a link's place among the numbers."""
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
    """Return what a kernel takes as inputs for these bodies and links.

    turned: of `placed`, those whose axes turn.  generic: whether placements may become any; else
    the pattern is that of the system's own numbers.
    """
    if not generic:
        bodies, own = bodies_of(system), bodies_of(nominal(system))
        steps = [(i, _pattern(bodies[i], own[i])) for i in placed]
    else:
        steps = [(i, "x" * STEP if i in turned else "nnnnnxxx") for i in placed]
    return Freed(tuple(inertias), tuple(steps), tuple(links))


def _pattern(body: Body, own: Body) -> str:
    """Return the pattern of a step's numbers.  own: the body as it was loaded."""
    now, first, words = step_of_body(body), step_of_body(own), _words(body)
    return "".join(
        "n" * (part.stop - part.start) if part is not _SHIFT and same else words[part]
        for part in (*_ANGLES, _OFFSET, _SHIFT)
        for same in [np.array_equal(now[part], first[part])]
    )


def pattern_of(system: System, body: int) -> str:
    """Return the pattern that leaves all numbers of a body's step free which are no 0 or ±1."""
    words = _words(bodies_of(system)[body])
    return words[: _OFFSET.start] + "n" + words[_SHIFT]


def _words(body: Body) -> str:
    """Return the pattern of a step none of whose numbers is what it was."""
    step, words = step_of_body(body), ""
    for angle in _ANGLES:  # a turn by any angle, or by quarters
        pair = [_FOLDED_AS.get(number, "x") for number in step[angle].tolist()]
        words += "xx" if "x" in pair else "".join(pair)
    return words + "x" + "".join("0" if number == 0.0 else "x" for number in step[_SHIFT])


def with_free(bodies: Sequence[Body], freed: Freed, numbers: Sequence[Scalar]) -> list[Body]:
    """Return the bodies, those that are freed with these numbers, (freed.size,)."""
    out = list(bodies)
    for i in freed.inertias:
        mass, *rest = numbers[freed.of_inertia(i)]
        out[i] = replace(out[i], mass=mass, moment=list(rest[:3]), inertia=list(rest[3:]))
    for i, pattern in freed.steps:
        own = step_of_body(bodies[i])
        step = [
            given if word == "x" else float(number) if word == "n" else _FOLDED[word]
            for word, given, number in zip(pattern, numbers[freed.of_step(i)], own, strict=True)
        ]
        out[i] = replace(
            out[i], alpha=(step[0], step[1]), delta=(step[2], step[3]), offset=step[4], r=step[5:]
        )
    return out


def total_mass(bodies: Sequence[Body]) -> Scalar:
    """Return the mass of all bodies."""
    total: Scalar = 0.0
    for body in bodies:
        total = add(total, body.mass)
    return total


def frame_map(body: Body) -> Array:
    """Return the map, (10, 10), from a body's moments in its joint's frame to those in its own.

    Both are m, m c, and the inertia about the frame's origin, xx, xy, xz, yy, yz, zz.
    """
    R, p = np.asarray(body.frame.rotation), np.asarray(body.frame.translation)
    out = np.zeros((NUMBERS, NUMBERS))
    for k, unit in enumerate(np.eye(NUMBERS)):
        m, h = unit[0], unit[1:4]
        I = np.zeros((3, 3))
        for value, (i, j) in zip(unit[4:], _PAIRS, strict=True):
            I[i, j] = I[j, i] = value
        moved = I - 2.0 * (h @ p) * np.eye(3) + np.outer(h, p) + np.outer(p, h)
        moved += m * (p @ p * np.eye(3) - np.outer(p, p))
        turned = R.T @ moved @ R
        out[0, k], out[1:4, k] = m, R.T @ (h - m * p)
        out[4:, k] = [turned[i, j] for i, j in _PAIRS]
    return out


def step_slopes(parent: Body, body: Body) -> Array:
    """Return the slopes, (STEP, 6), of a body's numbers by the twist that moves its placement.

    body: with the placement that it has.  The twist is in the frame of the parent's joint, taken
    at its origin.
    """
    (ca, sa), (cd, sd) = body.alpha, body.delta
    c, s = body.beta
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    in_frame = parent.frame.toActionMatrixInverse()
    # ω = e_x α̇ + Rx e_y δ̇ + Rx Ry e_z ε̇, after the turn by β.
    axes = np.array([[1.0, 0.0, sd], [0.0, ca, -sa * cd], [0.0, sa, ca * cd]])
    rates = np.linalg.solve(axes, turn @ in_frame[3:])
    shift = in_frame[:3] - pin.skew(np.array(body.r, dtype=float)) @ in_frame[3:]
    angles = [-sa * rates[0], ca * rates[0], -sd * rates[1], cd * rates[1], rates[2]]
    return np.vstack([*angles, shift])


def step_of_body(body: Body) -> Array:
    """Return the numbers (STEP,) of a body's step."""
    return np.array(_step_of(body), dtype=float)


def _step_of(body: Body) -> list[Scalar]:
    return [*body.alpha, *body.delta, body.offset, *body.r]


def other_placement(parent: Body, body: Body, pattern: str, rng: np.random.Generator) -> pin.SE3:
    """Return a random placement of a body's joint whose numbers have a pattern."""
    step, size = step_of_body(body), 0.1 + float(np.linalg.norm(np.asarray(body.r, dtype=float)))
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
    there = pin.SE3(R, step[5:])
    return parent.frame * there * body.frame.inverse()


def of_bodies(bodies: Sequence[Body], freed: Freed) -> list[Scalar]:
    """Return the numbers of freed inertias and steps as these bodies have them, symbols or not."""
    inertias = [bodies[i] for i in freed.inertias]
    out = [n for body in inertias for n in (body.mass, *body.moment, *body.inertia)]
    return out + [number for i, _ in freed.steps for number in _step_of(bodies[i])]


def link_numbers(body: Body, place: pin.SE3) -> Array:
    """Return the numbers (LINK,) of a link with a place in the frame of its body's joint."""
    there = body.frame.actInv(place)
    return np.concatenate([np.asarray(there.rotation).ravel(), there.translation])


def link_slopes(body: Body, place: pin.SE3, twists: Array) -> Array:
    """Return the slopes (LINK, N) of a link's numbers by twists (6, N) that move its place.

    The twists are in the frame of the body's joint, taken at its origin.
    """
    turn, out = body.frame.rotation.T, np.empty((LINK, twists.shape[1]))
    for k, (v, w) in enumerate(zip(twists[:3].T, twists[3:].T, strict=True)):
        out[:9, k] = (turn @ pin.skew(w) @ place.rotation).ravel()
        out[9:, k] = turn @ (v + np.cross(w, place.translation))
    return out


def free_numbers(system: System, freed: Freed) -> Array:
    """Return the numbers of bodies that are freed, (freed.size,), as a kernel takes them."""
    if not freed:
        return np.empty(0)

    def make() -> Array:
        bodies, frames = bodies_of(system), system.model.frames
        links = [link_numbers(bodies[frames[k].parentJoint - 1], frames[k].placement)
                 for k in freed.links]  # fmt: skip
        return np.concatenate([np.array(of_bodies(bodies, freed), dtype=float), *links])

    return once(system, (free_numbers, freed), make)
