"""Identical branches, such as both legs or both arms, computed together in SIMD lanes.

Branches with equal joints share one sweep, whose symbols represent one number per branch.  CasADi
does not distinguish such packed symbols from others.  Therefore a list of marks (see `Mark`)
records where numbers are packed into lanes, and where lanes become plain numbers again: one lane,
or the sum over all.  `lowering` generates vector instructions for packed
expressions.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import casadi as ca

from .body_frames import Body
from .scalars import Scalar

WIDEST = 4  # largest number of lanes; a 256-bit register holds 4 doubles


@dataclass(frozen=True)
class Mark:
    """The definition of a symbol that packs numbers into lanes, or unpacks lanes to a number.

    Attributes:
        kind: "pack" (one number per lane), "lane" (the number in lane `lane`) or "sum" (the sum
            over all lanes).
        width: Number of lanes.
        operands: Scalars to pack, or the packed symbol.
        lane: Index of the lane.
    """

    kind: str
    width: int
    operands: tuple[ca.SX, ...]
    lane: int = 0


@dataclass(frozen=True)
class Link:
    """One body, or corresponding bodies of several branches.

    Attributes:
        lanes: Indices of the bodies, one per lane.
        parent: Index of the parent link, −1 for the root.
        body: The body; constants that differ between lanes are packed.
    """

    lanes: tuple[int, ...]
    parent: int
    body: Body


class Lanes:
    """The marks of one CasADi graph.

    Attributes:
        marks: The marks that each Function needs, by its name.
    """

    def __init__(self) -> None:
        """Create an empty list of marks."""
        self.marks: dict[str, list[Mark]] = {}
        self._marks: list[Mark] = []
        self._symbols: list[ca.SX] = []

    def pack(self, numbers: Sequence[Scalar]) -> Scalar:
        """Return one number per lane, or the number itself if it is the same float for all."""
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

        Args:
            name: Name of the Function.
            inputs: Inputs of the Function.
            output: Output of the Function.
        Returns:
            The Function.  Its further input has the symbols of the marks that it needs, each after
            its operands; its further output has the operands of these marks, in the same order.
        """
        number = {symbol.element_hash(): k for k, symbol in enumerate(self._symbols)}
        needed: set[int] = set()
        expressions = [output]
        while expressions:
            symbols = ca.symvar(ca.veccat(ca.SX(0, 1), *expressions))
            new = {number.get(s.element_hash(), -1) for s in symbols} - needed - {-1}
            needed |= new
            expressions = [operand for k in new for operand in self._marks[k].operands]
        order = sorted(needed)
        marks = [self._marks[k] for k in order]
        packed = ca.vertcat(ca.SX(0, 1), *(self._symbols[k] for k in order))
        operands = ca.vertcat(ca.SX(0, 1), *(v for mark in marks for v in mark.operands))
        outputs = [ca.densify(operands), ca.densify(output)]
        self.marks[name] = marks
        return ca.Function(name, [*inputs, packed], outputs, {"cse": True})

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
    """Return the bodies as links, parents first.

    Args:
        bodies: Bodies of the tree, root first.
        lanes: Record of the packed symbols; None: every body is its own link.
        driven: Bodies whose joints have a prescribed rate.
        coupled: Bodies whose joints follow a common coordinate.  Branches with such a body
            are not combined.
    Returns:
        The links.
    """
    if lanes is None:
        return [Link((i,), body.parent, body) for i, body in enumerate(bodies)]
    children: list[list[int]] = [[] for _ in bodies]
    for i in range(1, len(bodies)):
        children[bodies[i].parent].append(i)
    kinds = _branch_kinds(bodies, children, driven, coupled)
    links: list[Link] = []
    pending: list[tuple[tuple[int, ...], int]] = [((0,), -1)]
    while pending:
        members, parent = pending.pop()
        merged = _merged([bodies[i] for i in members], lanes)
        links.append(Link(members, parent, merged))
        columns = [sorted(children[i], key=lambda child: (kinds[child], child)) for i in members]
        combined = list(zip(*columns, strict=True)) if len(members) > 1 else None
        branches = _combine(columns[0], kinds) if combined is None else combined
        pending += [(branch, len(links) - 1) for branch in branches]
    return links


def _branch_kinds(
    bodies: list[Body],
    children: list[list[int]],
    driven: Collection[int],
    coupled: Collection[int],
) -> list[int]:
    """Return a number per body that identifies the joints and branching of its subtree."""
    numbers: dict[tuple[object, ...], int] = {}
    kinds = [0] * len(bodies)
    for i in range(len(bodies) - 1, -1, -1):
        subtrees = tuple(sorted(kinds[child] for child in children[i]))
        unique = i if i in coupled else 0
        # Frames of balls are constants of the code, so branches share them only if they are equal.
        ball = bodies[i].frame.rotation.tobytes() if bodies[i].is_ball else b""
        structure = (bodies[i].kind.name, ball, i in driven, unique, subtrees)
        kinds[i] = numbers.setdefault(structure, len(numbers))
    return kinds


def _combine(branches: list[int], kinds: list[int]) -> list[tuple[int, ...]]:
    """Group branches of the same kind, with at most as many branches as SIMD lanes."""
    groups: dict[int, list[int]] = {}
    for branch in branches:
        groups.setdefault(kinds[branch], []).append(branch)
    return [
        tuple(group[k : k + WIDEST])
        for group in groups.values()
        for k in range(0, len(group), WIDEST)
    ]


def _merged(bodies: list[Body], lanes: Lanes) -> Body:
    """Return one body whose constants are packed from the bodies of all lanes."""
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
