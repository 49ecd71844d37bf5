"""Branches such as both legs, or legs and arms, computed together in SIMD lanes.

Branches with equal joints share one sweep, whose symbols represent one number per branch.  Limbs
that differ in length or in their parent share it as far as their joints are of the same types; the
parent of each lane then has its own link and lane.  CasADi does not distinguish packed symbols from
others.  Therefore a list of marks (see `Mark`) records where numbers are packed into lanes, and
where lanes become plain numbers again: one lane, or the sum over all.  `lowering` generates vector
instructions for packed expressions.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace

import casadi as ca

from .body_frames import Body
from .scalars import Scalar, Vec, total

WIDEST = 4  # largest number of lanes; a 256-bit register holds 4 doubles
_LEAST_SHARED = 2  # smallest number of joints that limbs share if they are joined


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
        parents: Index of the link, and lane, of the parent of each body; −1 and 0 for the root.
        body: The body; constants that differ between lanes are packed.
    """

    lanes: tuple[int, ...]
    parents: tuple[tuple[int, int], ...]
    body: Body

    @property
    def parent(self) -> int:
        """Index of the parent link, −1 for the root; that of the first lane if they differ."""
        return self.parents[0][0]


class Lanes:
    """The marks of one CasADi graph.

    Attributes:
        joins: Whether limbs of different lengths or parents share lanes.
        marks: The marks that each Function needs, by its name.
    """

    def __init__(self, *, joins: bool = True) -> None:
        """Create an empty list of marks."""
        self.joins = joins
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
        return [Link((i,), ((body.parent, 0),), body) for i, body in enumerate(bodies)]
    children: list[list[int]] = [[] for _ in bodies]
    for i in range(1, len(bodies)):
        children[bodies[i].parent].append(i)
    kinds = _branch_kinds(bodies, children, driven, coupled)
    root = _Part((0,), None)
    pending = [root]
    while pending:
        part = pending.pop()
        members = part.members
        columns = [sorted(children[i], key=lambda child: (kinds[child], child)) for i in members]
        combined = list(zip(*columns, strict=True)) if len(members) > 1 else None
        for branch in _combine(columns[0], kinds) if combined is None else combined:
            body, alone = bodies[branch[0]], branch[0] in coupled
            joint = (body.kind.name, branch[0] in driven) if not (body.is_ball or alone) else None
            part.branches.append(_Part(tuple(branch), joint))
        pending += part.branches
    pieces = _with_joined_limbs(root) if lanes.joins else list(root)
    return _ordered(pieces, bodies, lanes)


def from_parents(link: Link, links: Sequence[Link], values: Sequence[Vec], lanes: Lanes) -> Vec:
    """Return numbers of the parent of each lane of a link; values: numbers of each link."""
    if _is_aligned(link, links):
        return values[link.parent]
    return [
        lanes.pack([lanes.lane(values[i][k], j, len(links[i].lanes)) for i, j in link.parents])
        for k in range(len(values[link.parent]))
    ]


def to_parents(link: Link, links: Sequence[Link], values: Vec, lanes: Lanes) -> dict[int, Vec]:
    """Return numbers of a link, summed for each lane of its parents, by parent link."""
    width, parent = len(link.lanes), link.parent
    if _is_aligned(link, links):
        across = 1 if len(links[parent].lanes) == width else width
        return {parent: [lanes.sum(value, across) for value in values]}
    sums: dict[int, Vec] = {}
    for i in dict.fromkeys(above for above, _ in link.parents):
        lanes_of_parent = [[k for k, place in enumerate(link.parents) if place == (i, lane)]
               for lane in range(len(links[i].lanes))]  # fmt: skip
        sums[i] = [
            lanes.pack(
                [total([lanes.lane(value, k, width) for k in group]) for group in lanes_of_parent]
            )
            for value in values
        ]
    return sums


def _is_aligned(link: Link, links: Sequence[Link]) -> bool:
    """Return whether a link has the lanes of its parent, or one body as parent."""
    width = len(links[link.parent].lanes)
    if width == 1:
        return len(set(link.parents)) == 1
    return list(link.parents) == [(link.parent, lane) for lane in range(width)]


@dataclass(eq=False)
class _Part:
    """Bodies of a link, before their constants are packed.

    Attributes:
        members: The bodies, one per lane.
        joint: What the joints of other limbs need to have in common with those of the members;
            None: the members are not joined with others.
        branches: The parts behind it.
    """

    members: tuple[int, ...]
    joint: object
    branches: list[_Part] = field(default_factory=list)

    def __iter__(self) -> Iterator[_Part]:
        """Yield the part and all parts behind it, parents first."""
        yield self
        for branch in reversed(self.branches):
            yield from branch

    def __len__(self) -> int:
        """Return the number of parts of the iteration."""
        return 1 + sum(map(len, self.branches))

    @property
    def is_limb(self) -> bool:
        """Whether all bodies behind it are in the same lanes, or in one chain."""
        if any(part.joint is None for part in self):
            return False
        width = len(self.members)
        return width > 1 or all(len(part.members) == 1 and len(part.branches) < 2 for part in self)

    def matches(self, other: _Part) -> list[tuple[_Part, _Part]]:
        """Return the branches of two parts, from these parts on, that can share lanes."""
        too_wide = len(self.members) + len(other.members) > WIDEST
        if too_wide or self.joint != other.joint:
            return []
        pairs = [(self, other)]
        for a, b in zip(self._longest_first, other._longest_first, strict=False):
            pairs += a.matches(b)
        return pairs

    def joined(self, other: _Part) -> _Part:
        """Return a part with the lanes of two; behind it, what matches is joined, too."""
        unpaired, branches = [*self.branches, *other.branches], []
        for a, b in zip(self._longest_first, other._longest_first, strict=False):
            if a.matches(b):
                branches.append(a.joined(b))
                unpaired = [branch for branch in unpaired if branch not in (a, b)]
        return _Part((*self.members, *other.members), self.joint, branches + unpaired)

    @property
    def _longest_first(self) -> list[_Part]:
        return sorted(self.branches, key=len, reverse=True)


def _with_joined_limbs(root: _Part) -> list[_Part]:
    """Return all parts of a tree, with limbs joined as long as this leaves fewer parts.

    The sweep of a link costs about as much with four lanes as with one.  A single pair of joints is
    not worth the additional operations on lanes.
    """
    trunk, limbs, pending = [], list[_Part](), [root]
    while pending:
        part = pending.pop()
        trunk.append(part)
        for branch in part.branches:
            (limbs if branch.is_limb else pending).append(branch)
    count, done = len(limbs), list[_Part]()
    while limbs:
        limbs.sort(key=len)
        limb = limbs.pop()
        shared = [len(limb.matches(other)) for other in limbs]
        if max(shared, default=0) < _LEAST_SHARED:
            done.append(limb)
            continue
        limbs.append(limb.joined(limbs.pop(shared.index(max(shared)))))
    if len(done) == count:
        return list(root)
    return [*trunk, *(part for limb in done for part in limb)]


def _ordered(parts: list[_Part], bodies: list[Body], lanes: Lanes) -> list[Link]:
    """Return parts as links, parents first."""
    place, links = {-1: (-1, 0)}, list[Link]()
    while parts:
        waiting = []
        for part in parts:
            above = [bodies[i].parent for i in part.members]
            if not all(i in place for i in above):
                waiting.append(part)
                continue
            place |= {i: (len(links), lane) for lane, i in enumerate(part.members)}
            merged = _merged([bodies[i] for i in part.members], lanes)
            links.append(Link(part.members, tuple(place[i] for i in above), merged))
        parts = waiting
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
