"""Limbs of one build as lanes of one computation: both legs at once, both arms at once.

The sweep is written once for such limbs, on symbols that stand for one number per limb.
To CasADi all symbols are alike, so a list of marks beside the expressions says where such a
symbol begins (numbers packed into lanes) and where lanes become plain numbers again (one lane,
or the sum over all).  `lowering` makes vector instructions of what depends on them.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import casadi as ca

from .body_frames import Body
from .scalars import Scalar

WIDEST = 4  # lanes: numbers in a 256-bit register


@dataclass(frozen=True)
class Mark:
    """The origin of a symbol.

    kind: "pack" (one number per lane), "lane" (the number in lane `lane`) or "sum" (of all
    lanes).  width: number of lanes.  operands: numbers to pack, or the packed one.
    """

    kind: str
    width: int
    operands: tuple[ca.SX, ...]
    lane: int = 0


@dataclass(frozen=True)
class Link:
    """One body, or the bodies of several limbs that correspond.

    lanes: indices of the bodies, one per lane.  parent: index of the parent link, −1 for the
    root.  body: with constants that are packed where the bodies differ.
    """

    lanes: tuple[int, ...]
    parent: int
    body: Body


class Lanes:
    """The marks of one graph.  marks: those that each Function made of it needs, by its name."""

    def __init__(self) -> None:
        """Begin without marks."""
        self.marks: dict[str, list[Mark]] = {}
        self._marks: list[Mark] = []
        self._symbols: list[ca.SX] = []

    def pack(self, numbers: Sequence[Scalar]) -> Scalar:
        """Return one number per lane, or just the number if it is one float for all."""
        first = numbers[0]
        if len(numbers) == 1 or all(isinstance(n, float) and n == first for n in numbers):
            return first
        return self._mark(Mark("pack", len(numbers), tuple(ca.SX(n) for n in numbers)))

    def lane(self, packed: Scalar, lane: int, width: int) -> Scalar:
        """Return the number in one of the lanes."""
        if width == 1 or isinstance(packed, float):
            return packed
        return self._mark(Mark("lane", width, (packed,), lane))

    def sum(self, packed: Scalar, width: int) -> Scalar:
        """Return the sum over the lanes."""
        if isinstance(packed, float):
            return packed * width
        return packed if width == 1 else self._mark(Mark("sum", width, (packed,)))

    def function(self, name: str, inputs: list[ca.SX], output: ca.SX) -> ca.Function:
        """Return a Function (inputs, symbols) → (operands, output).

        symbols: those of the marks it needs, each after the ones it depends on.  operands:
        those of the same marks, in the same order.
        """
        number = {symbol.element_hash(): k for k, symbol in enumerate(self._symbols)}
        needed: set[int] = set()
        new = [output]
        while new:
            found = {
                number.get(s.element_hash(), -1) for s in ca.symvar(ca.veccat(ca.SX(0, 1), *new))
            }
            found -= needed | {-1}
            needed |= found
            new = [operand for k in found for operand in self._marks[k].operands]
        order = sorted(needed)
        marks = [self._marks[k] for k in order]
        symbols = ca.vertcat(ca.SX(0, 1), *(self._symbols[k] for k in order))
        operands = ca.vertcat(ca.SX(0, 1), *(v for mark in marks for v in mark.operands))
        outputs = [ca.densify(operands), ca.densify(output)]
        self.marks[name] = marks
        return ca.Function(name, [*inputs, symbols], outputs, {"cse": True})

    def _mark(self, mark: Mark) -> ca.SX:
        self._marks.append(mark)
        self._symbols.append(ca.SX.sym(f"{mark.kind}{len(self._marks)}"))
        return self._symbols[-1]


def links_of(
    bodies: list[Body],
    lanes: Lanes | None,
    driven: Collection[int],
    coupled: Collection[int] = (),
) -> list[Link]:
    """Return the bodies as links, parents first; without lanes, every body is one.

    driven: the bodies whose joints move at a prescribed rate.  coupled: those whose joints move
    together with others; limbs that carry one are computed alone.
    """
    if lanes is None:
        return [Link((i,), body.parent, body) for i, body in enumerate(bodies)]
    children: list[list[int]] = [[] for _ in bodies]
    for i in range(1, len(bodies)):
        children[bodies[i].parent].append(i)
    build = _builds(bodies, children, driven, coupled)
    links: list[Link] = []
    waiting: list[tuple[tuple[int, ...], int]] = [((0,), -1)]
    while waiting:
        members, parent = waiting.pop()
        merged = _merged([bodies[i] for i in members], lanes)
        links.append(Link(members, parent, merged))
        rows = [sorted(children[i], key=lambda child: (build[child], child)) for i in members]
        found = list(zip(*rows, strict=True)) if len(members) > 1 else _alike(rows[0], build)
        waiting += [(limb, len(links) - 1) for limb in found]
    return links


def _builds(
    bodies: list[Body],
    children: list[list[int]],
    driven: Collection[int],
    coupled: Collection[int],
) -> list[int]:
    """Return for each body a number that stands for the joints behind it and how they branch."""
    numbers: dict[tuple[object, ...], int] = {}
    build = [0] * len(bodies)
    for i in range(len(bodies) - 1, -1, -1):
        behind = tuple(sorted(build[child] for child in children[i]))
        alone = i if i in coupled else 0
        kind = (bodies[i].prismatic, i in driven, alone, behind)
        build[i] = numbers.setdefault(kind, len(numbers))
    return build


def _alike(limbs: list[int], build: list[int]) -> list[tuple[int, ...]]:
    """Return limbs in groups of one build that fit into the lanes."""
    groups: dict[int, list[int]] = {}
    for limb in limbs:
        groups.setdefault(build[limb], []).append(limb)
    return [
        tuple(group[k : k + WIDEST])
        for group in groups.values()
        for k in range(0, len(group), WIDEST)
    ]


def _merged(bodies: list[Body], lanes: Lanes) -> Body:
    """Return one body for all lanes."""
    if len(bodies) == 1:
        return bodies[0]

    def numbers(name: str) -> list[Scalar]:
        return [
            lanes.pack(entry) for entry in zip(*(getattr(b, name) for b in bodies), strict=True)
        ]

    return replace(
        bodies[0],
        alpha=tuple(numbers("alpha")),
        beta=tuple(numbers("beta")),
        delta=tuple(numbers("delta")),
        r=numbers("r"),
        moment=numbers("moment"),
        inertia=numbers("inertia"),
        mass=lanes.pack([b.mass for b in bodies]),
        armature=lanes.pack([b.armature for b in bodies]),
    )
