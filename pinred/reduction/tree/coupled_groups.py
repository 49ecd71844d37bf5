"""Joints that move together, as the sweep eliminates them: with one column of momentum each.

The joints j of a group move at k_j ẏ.  Inward, from its first member on, a group is open: beside
its articulated inertia and momentum a subtree then has the momentum u per unit of ẏ, and the
group has an inertia D and a momentum s of its own, so that the part of the subtree in
π = ∂L/∂ẏ is u · v + D ẏ + s.  At a member with axis S,

    D += 2 k S·u + k² (S·I S + armature),   s += k S·p,   u += k I S,

and any other joint on the way that is eliminated takes its share of u, D and s.  At the deepest
body that carries all members the group is eliminated as a joint is: I −= u uᵀ/D.  Of groups that
are open at once, D is a matrix.  Outward, π̇ = Σ k_j (v_j × S_j) · h_j, with u ẏ in h_j.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ...system.coupling import Coupled
from .articulated_body import Articulated, Step, along_joint, momentum_of_rate
from .body_frames import Body
from .limbs import Link
from .scalars import INDEX, Scalar, Vec, add, dot, mul, plus, sub


@dataclass
class Column:
    """Momentum of a subtree per unit rate of a group, at its root body."""

    lin: Vec
    ang: Vec


@dataclass
class Closed:
    """An eliminated group: ẏ = drive − gain · v − Σ shares · ẏ of the groups still open."""

    group: int
    gain: Column
    drive: Scalar
    shares: dict[int, Scalar]


class Groups:
    """The groups of one sweep.

    of, ratio: of the joint of each body, the shape coordinate it follows, and by what factor; at
    the root, nothing.  driven: rates of the joints whose rates are known.  members: the bodies
    whose joints move together with others, at rates that are not known.
    """

    def __init__(
        self, bodies: Sequence[Body], rates: Mapping[int, Scalar], coupled: Coupled | None
    ) -> None:
        """Sort the joints."""
        count = range(1, len(bodies))
        self.of = [-1, *(k - 1 for k in count)]
        self.ratio = [1.0] * len(bodies)
        if coupled is not None:
            self.of[1:] = coupled.of.tolist()
            self.ratio[1:] = coupled.ratio.tolist()
        self._leads = {1 + j for j in coupled.leads.tolist()} if coupled else set(count)
        self.driven: dict[int, Scalar] = {}
        moved: dict[int, list[int]] = {}
        for i in count:
            if self.of[i] in rates:
                self.driven[i] = mul(self.ratio[i], rates[self.of[i]])
            elif self.ratio[i] == 0.0:
                self.driven[i] = 0.0
            else:
                moved.setdefault(self.of[i], []).append(i)
        together = {k: group for k, group in moved.items() if len(group) > 1}
        self.members = {i: k for k, group in together.items() for i in group}
        self._homes = {k: _home(bodies, group) for k, group in together.items()}
        self._open: list[dict[int, Column]] = []
        self._shares: list[dict[int, Scalar]] = []
        self._closing: list[list[int]] = []
        self._closed: list[list[Closed]] = []
        self._inertia: dict[tuple[int, int], Scalar] = {}  # D, first index not above the second
        self._momentum: dict[int, Scalar] = {}  # s
        self._rates: dict[int, Scalar] = {}
        self._links: list[Link] = []

    def leads(self, body: int) -> bool:
        """Return whether the joint of a body follows no other."""
        return body in self._leads

    def meet(self, links: list[Link]) -> None:
        """Learn which links there are."""
        self._links = links
        self._open = [{} for _ in links]
        self._shares = [{} for _ in links]
        self._closed = [[] for _ in links]
        at = {body: i for i, link in enumerate(links) for body in link.lanes}
        self._closing = [[] for _ in links]
        for k, home in self._homes.items():
            self._closing[at[home]].append(k)

    # Inward.

    def close(self, i: int, a: Articulated, pi: list[Scalar]) -> None:
        """Eliminate the groups whose members all hang on link i, of inertia a in its frame."""
        for k in self._closing[i]:
            own = self._open[i].pop(k)
            inverse = 1.0 / self._inertia[k, k]
            gain = Column([mul(c, inverse) for c in own.lin], [mul(c, inverse) for c in own.ang])
            drive = mul(sub(pi[k], self._momentum[k]), inverse)
            shared = {g: self._between(k, g) for g in self._open[i]}
            self._give(i, shared, own, inverse, drive)
            shares = {g: mul(share, inverse) for g, share in shared.items()}
            self._closed[i].append(Closed(k, gain, drive, shares))
            for p in range(3):
                for q in range(p, 3):
                    j = INDEX[p][q]
                    a.M[j] = sub(a.M[j], mul(own.lin[p], gain.lin[q]))
                    a.I[j] = sub(a.I[j], mul(own.ang[p], gain.ang[q]))
                a.B[p] = [sub(a.B[p][q], mul(gain.ang[p], own.lin[q])) for q in range(3)]
            a.lin = plus(a.lin, [mul(c, drive) for c in own.lin])
            a.ang = plus(a.ang, [mul(c, drive) for c in own.ang])

    def carry(self, i: int, step: Step) -> None:
        """Take the columns that are open at link i to the frame before a step."""
        self._open[i] = {k: Column(*step.inward(c.lin, c.ang)) for k, c in self._open[i].items()}

    def drive(self, i: int, body: Body, rate: Scalar) -> None:
        """Pass a joint whose rate is known."""
        for k, column in self._open[i].items():
            own = mul(along_joint(body, column.lin, column.ang), rate)
            self._momentum[k] = add(self._momentum[k], own)

    def join(self, i: int, body: Body, a: Articulated) -> None:
        """Let a member join its group, which it opens if it is the first on its way."""
        number = self._links[i].lanes[0]
        k, ratio, columns = self.members[number], self.ratio[number], self._open[i]
        U, Ua = momentum_of_rate(body, a)
        zero: Vec = [0.0, 0.0, 0.0]
        own = columns.get(k, Column(zero, zero))
        along = {g: along_joint(body, c.lin, c.ang) for g, c in columns.items()}
        for g, share in along.items():
            twice = 2.0 if g == k else 1.0
            self._add_between(k, g, mul(twice * ratio, share))
        inertia = add(along_joint(body, U, Ua), body.armature)
        self._add_between(k, k, mul(ratio * ratio, inertia))
        momentum = mul(ratio, along_joint(body, a.lin, a.ang))
        self._momentum[k] = add(self._momentum.get(k, 0.0), momentum)
        columns[k] = Column(
            plus(own.lin, [mul(ratio, c) for c in U]), plus(own.ang, [mul(ratio, c) for c in Ua])
        )

    def eliminate(self, i: int, body: Body, a: Articulated, drive: Scalar) -> None:
        """Pass a joint that is eliminated; a: the inertia with its velocity still in it."""
        columns = self._open[i]
        if not columns:
            return
        U, Ua = momentum_of_rate(body, a)
        inverse = 1.0 / add(along_joint(body, U, Ua), body.armature)
        along = {g: along_joint(body, c.lin, c.ang) for g, c in columns.items()}
        self._give(i, along, Column(U, Ua), inverse, drive)
        self._shares[i] = {g: mul(share, inverse) for g, share in along.items()}
        if isinstance(body.armature, float) and body.armature == 0.0:
            for column in columns.values():  # what the joint moves along is left without momentum
                (column.lin if body.prismatic else column.ang)[2] = 0.0

    def hand_on(self, i: int, parent: int, step: Step) -> None:
        """Add the columns of link i to those of its parent, at whose origin the step begins."""
        onto = self._open[parent]
        for k, column in self._open[i].items():
            lin, ang = step.inward(column.lin, column.ang)
            there = onto.get(k)
            onto[k] = (
                Column(lin, ang)
                if there is None
                else Column(plus(there.lin, lin), plus(there.ang, ang))
            )

    # Outward.

    def find_rates(self, i: int, v: Vec, w: Vec) -> None:
        """Find the rates of the groups that were eliminated at link i, from its twist."""
        for closed in reversed(self._closed[i]):
            gain = closed.gain
            rate = sub(closed.drive, add(dot(gain.lin, v), dot(gain.ang, w)))
            for g, share in closed.shares.items():
                rate = sub(rate, mul(share, self._rates[g]))
            self._rates[closed.group] = rate

    def rate(self, i: int, alone: Scalar) -> Scalar:
        """Return the rate of the joint of link i, which would be `alone` without groups."""
        number = self._links[i].lanes[0]
        if number in self.members:
            return mul(self.ratio[number], self._rates[self.members[number]])
        for g, share in self._shares[i].items():
            alone = sub(alone, mul(share, self._rates[g]))
        return alone

    def momentum(self, i: int, k: int, *, angular: bool = False) -> Scalar:
        """Return entry k of the momentum that open groups give the subtree of link i."""
        out: Scalar = 0.0
        for g, column in self._open[i].items():
            out = add(out, mul((column.ang if angular else column.lin)[k], self._rates[g]))
        return out

    def _give(
        self, i: int, shared: dict[int, Scalar], own: Column, inverse: Scalar, drive: Scalar
    ) -> None:
        """Take an eliminated rate, with momentum `own`, out of the groups open at link i.

        shared: the inertia that it has in common with each of them.
        """
        numbers = sorted(shared)
        for g in numbers:
            gone, column = mul(shared[g], inverse), self._open[i][g]
            self._open[i][g] = Column(
                [sub(c, mul(u, gone)) for c, u in zip(column.lin, own.lin, strict=True)],
                [sub(c, mul(u, gone)) for c, u in zip(column.ang, own.ang, strict=True)],
            )
            self._momentum[g] = add(self._momentum[g], mul(shared[g], drive))
            for other in numbers:
                if other >= g:
                    self._add_between(g, other, mul(-1.0, mul(gone, shared[other])))

    def _between(self, g: int, k: int) -> Scalar:
        return self._inertia.get((min(g, k), max(g, k)), 0.0)

    def _add_between(self, g: int, k: int, value: Scalar) -> None:
        self._inertia[min(g, k), max(g, k)] = add(self._between(g, k), value)


def _home(bodies: Sequence[Body], members: Sequence[int]) -> int:
    """Return the deepest body that carries all members."""
    ways: list[list[int]] = []
    for i in members:
        way, at = [], bodies[i].parent
        while at >= 0:
            way.append(at)
            at = bodies[at].parent
        ways.append(way)
    return max(i for i in ways[0] if all(i in way for way in ways))
