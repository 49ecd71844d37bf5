"""Groups of joints that follow a common coordinate; the sweep eliminates each group at once.

The joints j of a group move at rates k_j ẏ.  A joint that follows several coordinates is a member
of several groups, and its rate is the sum.  In the inward pass, a group is open from its first
member until it is eliminated.  In addition to its articulated inertia and momentum, a subtree then
has the momentum u per unit of ẏ, and the group has an inertia D and a momentum s.  The subtree's
part of π = ∂L/∂ẏ is u · v + D ẏ + s, with the twist v of its root body.  At a member with axis S,

    D += 2 k S·u + k² (S·I S + armature),   s += k S·p,   u += k I S,

and every other joint that is eliminated on the way removes its share from u, D and s.  At the
deepest body that carries all members the group is eliminated like a joint: I −= u uᵀ/D.  If
several groups are open, D is a matrix, to which a member of two groups adds
k k′ (S·I S + armature).  In the outward sweep, π̇ = Σ k_j (v_j × S_j) · h_j, where h_j includes u ẏ.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ...system.coupling import Coupled
from .body_frames import Articulated, Body, Freedom, Step, momentum_of_rate
from .identical_branches import Link
from .scalars import INDEX, Scalar, Vec, add, dot, mul, plus, sub


@dataclass
class Column:
    """Momentum of a subtree per unit rate of a group, in the frame of its root body.

    Attributes:
        lin: Linear momentum, (3,).
        ang: Angular momentum, (3,).
    """

    lin: Vec
    ang: Vec


@dataclass
class Closed:
    """An eliminated group: ẏ = drive − gain · v − Σ shares · ẏ, summed over open groups.

    Attributes:
        group: Index of the group's coordinate.
        gain: Coefficient u/D of the body's twist v.
        drive: Rate ẏ at zero twist and zero rates of the open groups.
        shares: Coefficient of the rate ẏ of each open group.
    """

    group: int
    gain: Column
    drive: Scalar
    shares: dict[int, Scalar]


class Groups:
    """The groups of one sweep.

    Attributes:
        terms: Shape coordinates that the joint of each body follows, with the rate of the joint
            per unit rate of the coordinate; empty at the root and at balls.
        balls: Index of the first shape rate of each ball, by body.
        driven: Rates of joints whose rates are prescribed, by body.
        driven_balls: Rates (3,) of balls whose rates are prescribed, by body.
        pushed: Prescribed parts of the rates of members, by body.
        members: Groups of the bodies whose joints share a free coordinate with others, with the
            ratios.
    """

    def __init__(
        self, bodies: Sequence[Body], rates: Mapping[int, Scalar], coupled: Coupled | None
    ) -> None:
        """Assign the joints to groups.

        Args:
            bodies: Bodies of the tree, root first.
            rates: Rates of the prescribed coordinates, by index.
            coupled: Coupling of joints that follow others; None if no joint follows another.
        """
        count = range(1, len(bodies))
        self.terms: list[list[tuple[int, float]]] = [[] for _ in bodies]
        self.balls: dict[int, int] = {}
        for i in count:
            rate_at = bodies[i].v_at
            terms = [(rate_at, 1.0)] if coupled is None else coupled.terms(rate_at)
            if bodies[i].is_ball:
                self.balls[i] = terms[0][0]
            else:
                self.terms[i] = terms
        leads = set(coupled.leads.tolist()) if coupled else None
        self._leads = {i for i in count if leads is None or bodies[i].v_at in leads}
        self.driven: dict[int, Scalar] = {}
        self.driven_balls: dict[int, list[Scalar]] = {}
        self.pushed: dict[int, Scalar] = {}
        followers: dict[int, list[int]] = {}
        for i in count:
            if i in self.balls:
                if self.balls[i] in rates:
                    self.driven_balls[i] = [rates[self.balls[i] + k] for k in range(3)]
                continue
            rate: Scalar = 0.0
            for k, ratio in self.terms[i]:
                if k in rates:
                    rate = add(rate, mul(ratio, rates[k]))
                else:
                    followers.setdefault(k, []).append(i)
            free = [k for k, _ in self.terms[i] if k not in rates]
            if not free:
                self.driven[i] = rate
            elif len(free) < len(self.terms[i]):
                self.pushed[i] = rate
        together = {k: group for k, group in followers.items() if len(group) > 1}
        self.members = {
            i: [(k, ratio) for k, ratio in self.terms[i] if k in together]
            for i in sorted({i for group in together.values() for i in group})
        }
        self._homes = {k: _home(bodies, group) for k, group in together.items()}
        self._open: list[dict[int, Column]] = []
        self._shares: list[dict[int, dict[int, Scalar]]] = []  # by link and axis of the rate
        self._closing: list[list[int]] = []
        self._closed: list[list[Closed]] = []
        self._inertia: dict[tuple[int, int], Scalar] = {}  # inertia D, ordered group indices
        self._momentum: dict[int, Scalar] = {}  # momentum s of each group
        self._rates: dict[int, Scalar] = {}
        self._links: list[Link] = []

    def leads(self, body: int) -> bool:
        """Return whether the joint of a body follows no other joint."""
        return body in self._leads

    def is_driven(self, body: int) -> bool:
        """Return whether the rate of a joint, or a part of it, is prescribed."""
        return body in self.driven or body in self.pushed

    def number(self, i: int) -> int:
        """Return the index of the first body of link i."""
        return self._links[i].lanes[0]

    def meet(self, links: list[Link]) -> None:
        """Store the links of the sweep, and where each group is eliminated."""
        self._links = links
        self._open = [{} for _ in links]
        self._shares = [{} for _ in links]
        self._closed = [[] for _ in links]
        at = {body: i for i, link in enumerate(links) for body in link.lanes}
        self._closing = [[] for _ in links]
        for k, home in self._homes.items():
            self._closing[at[home]].append(k)

    # Inward pass: from the leaves to the root.

    def close(self, i: int, a: Articulated, pi: list[Scalar]) -> None:
        """Eliminate the groups whose members are all in the subtree of link i.

        Args:
            i: Index of the link.
            a: Inertia of the link's subtree in the link's frame; changed in place.
            pi: Canonical momenta of the shape coordinates.
        """
        for k in self._closing[i]:
            u = self._open[i].pop(k)
            inverse = 1.0 / self._inertia[k, k]
            gain = Column([mul(c, inverse) for c in u.lin], [mul(c, inverse) for c in u.ang])
            drive = mul(sub(pi[k], self._momentum[k]), inverse)
            shared = {g: self._between(k, g) for g in self._open[i]}
            self._eliminate_rate(i, shared, u, inverse, drive)
            shares = {g: mul(share, inverse) for g, share in shared.items()}
            self._closed[i].append(Closed(k, gain, drive, shares))
            for p in range(3):
                for q in range(p, 3):
                    j = INDEX[p][q]
                    a.M[j] = sub(a.M[j], mul(u.lin[p], gain.lin[q]))
                    a.I[j] = sub(a.I[j], mul(u.ang[p], gain.ang[q]))
                a.B[p] = [sub(a.B[p][q], mul(gain.ang[p], u.lin[q])) for q in range(3)]
            a.lin = plus(a.lin, [mul(c, drive) for c in u.lin])
            a.ang = plus(a.ang, [mul(c, drive) for c in u.ang])

    def carry(self, i: int, step: Step) -> None:
        """Transform the columns that are open at link i to the frame before a step."""
        self._open[i] = {k: Column(*step.inward(c.lin, c.ang)) for k, c in self._open[i].items()}

    def drive(self, i: int, freedom: Freedom, rate: Scalar) -> None:
        """Add the momentum of a joint with a prescribed rate to the open groups at link i."""
        for k, column in self._open[i].items():
            momentum = mul(freedom.along(column.lin, column.ang), rate)
            self._momentum[k] = add(self._momentum[k], momentum)

    def join(self, i: int, freedom: Freedom, a: Articulated) -> None:
        """Add a member to its groups; the first member opens a group.

        Args:
            i: Index of the link.
            freedom: Rate of the joint.
            a: Inertia of the subtree, with the momentum of the prescribed part of the rate.
        """
        number = self.number(i)
        terms, columns = self.members[number], self._open[i]
        U, Ua = momentum_of_rate(freedom, a)
        shares = {g: freedom.along(c.lin, c.ang) for g, c in columns.items()}
        inertia = add(freedom.along(U, Ua), freedom.armature)
        momentum = freedom.along(a.lin, a.ang)
        if number in self.pushed:
            momentum = add(momentum, mul(freedom.armature, self.pushed[number]))
        for n, (k, ratio) in enumerate(terms):
            for g, share in shares.items():
                twice = 2.0 if g == k else 1.0
                self._add_between(k, g, mul(twice * ratio, share))
            for g, other in terms[n:]:
                self._add_between(k, g, mul(ratio * other, inertia))
            self._momentum[k] = add(self._momentum.get(k, 0.0), mul(ratio, momentum))
            zero: Vec = [0.0, 0.0, 0.0]
            column = columns.get(k, Column(zero, zero))
            columns[k] = Column(
                plus(column.lin, [mul(ratio, c) for c in U]),
                plus(column.ang, [mul(ratio, c) for c in Ua]),
            )

    def eliminate(self, i: int, freedom: Freedom, a: Articulated, drive: Scalar) -> None:
        """Remove the share of an eliminated rate from the open groups at link i.

        Args:
            i: Index of the link.
            freedom: The rate.
            a: Inertia of the subtree before the elimination.
            drive: The rate at zero twist.
        """
        columns = self._open[i]
        if not columns:
            return
        U, Ua = momentum_of_rate(freedom, a)
        inverse = 1.0 / add(freedom.along(U, Ua), freedom.armature)
        shares = {g: freedom.along(c.lin, c.ang) for g, c in columns.items()}
        self._eliminate_rate(i, shares, Column(U, Ua), inverse, drive)
        self._shares[i][freedom.axis] = {g: mul(share, inverse) for g, share in shares.items()}
        if isinstance(freedom.armature, float) and freedom.armature == 0.0:
            for column in columns.values():  # the remainder is exactly zero along the joint axis
                (column.lin if freedom.slides else column.ang)[freedom.axis] = 0.0

    def add_to_parent(self, i: int, parent: int, step: Step) -> None:
        """Add the columns of link i to its parent's columns; step: step from parent to link."""
        columns = self._open[parent]
        for k, column in self._open[i].items():
            lin, ang = step.inward(column.lin, column.ang)
            if k in columns:
                lin, ang = plus(columns[k].lin, lin), plus(columns[k].ang, ang)
            columns[k] = Column(lin, ang)

    # Outward pass: from the root to the leaves.

    def find_rates(self, i: int, v: Vec, w: Vec) -> None:
        """Compute the rates of the groups that were eliminated at link i, from its twist."""
        for closed in reversed(self._closed[i]):
            gain = closed.gain
            rate = sub(closed.drive, add(dot(gain.lin, v), dot(gain.ang, w)))
            for g, share in closed.shares.items():
                rate = sub(rate, mul(share, self._rates[g]))
            self._rates[closed.group] = rate

    def rate(self, i: int, alone: Scalar, axis: int) -> Scalar:
        """Return a rate of link i.

        Args:
            i: Index of the link.
            alone: The rate at zero rates of the open groups.
            axis: Axis of the rate.
        Returns:
            The rate.
        """
        number = self.number(i)
        if number in self.members:
            rate = self.pushed.get(number, 0.0)
            for k, ratio in self.members[number]:
                rate = add(rate, mul(ratio, self._rates[k]))
            return rate
        for g, share in self._shares[i].get(axis, {}).items():
            alone = sub(alone, mul(share, self._rates[g]))
        return alone

    def momentum(self, i: int, k: int, *, angular: bool = False) -> Scalar:
        """Return entry k of the momentum of link i's subtree due to the rates of open groups."""
        sum_: Scalar = 0.0
        for g, column in self._open[i].items():
            sum_ = add(sum_, mul((column.ang if angular else column.lin)[k], self._rates[g]))
        return sum_

    def _eliminate_rate(
        self, i: int, shared: dict[int, Scalar], momentum: Column, inverse: Scalar, drive: Scalar
    ) -> None:
        """Eliminate a rate from the groups that are open at link i.

        Args:
            i: Index of the link.
            shared: Inertia that couples the rate to each open group.
            momentum: Momentum of the subtree per unit of the rate.
            inverse: Inverse of the rate's inertia.
            drive: The rate at zero twist and zero rates of the open groups.
        """
        groups = sorted(shared)
        for g in groups:
            ratio, column = mul(shared[g], inverse), self._open[i][g]
            self._open[i][g] = Column(
                [sub(c, mul(u, ratio)) for c, u in zip(column.lin, momentum.lin, strict=True)],
                [sub(c, mul(u, ratio)) for c, u in zip(column.ang, momentum.ang, strict=True)],
            )
            self._momentum[g] = add(self._momentum[g], mul(shared[g], drive))
            for k in groups:
                if k >= g:
                    self._add_between(g, k, mul(-1.0, mul(ratio, shared[k])))

    def _between(self, g: int, k: int) -> Scalar:
        return self._inertia.get((min(g, k), max(g, k)), 0.0)

    def _add_between(self, g: int, k: int, value: Scalar) -> None:
        self._inertia[min(g, k), max(g, k)] = add(self._between(g, k), value)


def _home(bodies: Sequence[Body], members: Sequence[int]) -> int:
    """Return the deepest body that carries all members."""
    paths: list[list[int]] = []
    for i in members:
        path, body = [], bodies[i].parent
        while body >= 0:
            path.append(body)
            body = bodies[body].parent
        paths.append(path)
    return max(i for i in paths[0] if all(i in path for path in paths))
