"""Impacts at joint stops: times, impulses, the rates after them, and the table of a motion.

The first root of a gap is found in Bernstein form, whose coefficients can exclude roots.

An impulse λ_i on joint i is internal, so the spatial momentum J, the body momentum μ and the locked
velocity Ω do not change. The canonical momenta change by λ_i alone, and ẋ⁺ = ẋ⁻ + M⁻¹λ with the
reduced metric M.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import chain, pairwise
from math import comb
from typing import Any

import numpy as np

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, FrozenArrays
from ..system.coordinates import Indices

_NEWTON = 0.6  # Largest part of a step in which a single root is polished.
_MOST_NEWTON, _SAME = 100, 4e-16  # Steps for a root, and the change at which it is found.


@cache
def bernstein(degree: int) -> tuple[Array, Array]:
    """Return nodes in [0, 1] and the matrix from values there to Bernstein coefficients.

    Args:
        degree: Degree of the polynomials.
    Returns:
        Nodes, (degree + 1,), and the matrix, (degree + 1, degree + 1).
    """
    nodes = 0.5 - 0.5 * np.cos(np.pi * np.arange(degree + 1) / degree)
    basis = [comb(degree, k) * nodes**k * (1.0 - nodes) ** (degree - k) for k in range(degree + 1)]
    return nodes, np.asarray(np.linalg.inv(np.array(basis).T))


def first_root(coefficients: Array) -> float | None:
    """Return the first point of [0, 1] where a polynomial falls to zero, or None.

    The polynomial is divided by de Casteljau's algorithm until one part has a single change of
    sign. Bernstein coefficients of one sign exclude a root.

    Args:
        coefficients: Bernstein coefficients, (degree + 1,); the first one is positive.
    Returns:
        The root, or None.
    """
    intervals = [(0.0, 1.0, coefficients)]
    while intervals:
        a, b, c = intervals.pop()
        if (c > 0.0).all():
            continue
        middle = 0.5 * (a + b)
        if not a < middle < b:
            return a
        changes = np.count_nonzero(np.diff(np.signbit(c)))
        if changes == 1 and c[0] > 0.0 and c[-1] < 0.0 and b - a < _NEWTON:
            return a + (b - a) * _polish(c)
        lower_half, upper_half = _halves(c)
        intervals += [(middle, b, upper_half), (a, middle, lower_half)]
    return None


def _halves(c: Array) -> tuple[Array, Array]:
    """Return the Bernstein coefficients of a polynomial on both halves of its interval."""
    levels = [c]
    while len(levels[-1]) > 1:
        levels.append(0.5 * (levels[-1][:-1] + levels[-1][1:]))
    return np.array([b[0] for b in levels]), np.array([b[-1] for b in levels[::-1]])


def _polish(c: Array) -> float:
    """Return the only root of a polynomial in [0, 1] by Newton's method with bisection.

    Args:
        c: Bernstein coefficients; the first one is positive, the last one negative.
    """
    values, degree = c.tolist(), len(c) - 1
    low, high, s = 0.0, 1.0, float(c[0] / (c[0] - c[-1]))
    for _ in range(_MOST_NEWTON):
        value, slope = _at(values, s, degree)
        low, high = (s, high) if value > 0.0 else (low, s)
        new = s - value / slope if slope < 0.0 else np.inf
        if abs(new - s) <= _SAME:
            return new
        if not low < new < high:
            new = 0.5 * (low + high)
        s = new
    return s


def _at(coefficients: list[float], s: float, degree: int) -> tuple[float, float]:
    """Evaluate a polynomial and its derivative at s from its Bernstein coefficients."""
    points, r = coefficients, 1.0 - s
    for _ in range(degree - 1):
        points = [r * a + s * b for a, b in pairwise(points)]
    first, last = points
    return r * first + s * last, degree * (last - first)


_TEXTS = ("joint", "side")  # columns of texts
_PIVOTS = 1e-13  # Impulses below this fraction of the largest count as zero when sets are chosen.


@checks_arguments
@dataclass(frozen=True)
class ImpactTable(FrozenArrays):
    """The impacts of a motion, one row for each joint; arrays are read-only.

    Joints that reach their stops together have rows of the same time. The energies of their rows
    add up to the energy that the impact loses.

    Attributes:
        t: Times, (K,) [s].
        joint: Names of the joints, (K,).
        side: The stop that each joint hits, "lower" or "upper", (K,).
        impulse: Impulses of the stops on the joints, (K,) [N·m·s | N·s].
        rate_before: Rates of the joints before the impacts, (K,) [rad/s | m/s].
        rate_after: Rates of the joints after the impacts, (K,) [rad/s | m/s].
        energy_lost: Kinetic energy that each impulse removes, (K,) [J].
        momentum_before: Spatial momenta before the impacts, (K, r) [N·s | N·m·s]; NaN if the scene
            leaves out the base.
        momentum_after: Spatial momenta after the impacts, (K, r) [N·s | N·m·s], likewise.
    """

    t: Array
    joint: tuple[str, ...]
    side: tuple[str, ...]
    impulse: Array
    rate_before: Array
    rate_after: Array
    energy_lost: Array
    momentum_before: Array
    momentum_after: Array

    def __len__(self) -> int:
        return len(self.t)

    @property
    def times(self) -> Array:
        """The distinct times, (I,) [s]."""
        return np.unique(self.t)

    @property
    def rows(self) -> list[tuple[float, str, str, float, float]]:
        """Time [s], joint, side, impulse and lost energy [J] of each row."""
        columns = (self.t.tolist(), self.joint, self.side, self.impulse.tolist())
        return list(zip(*columns, self.energy_lost.tolist(), strict=True))

    def __str__(self) -> str:
        if not len(self):
            return "no impacts"
        width = max(5, *map(len, self.joint))
        head = f"{'t [s]':>14}  {'joint':<{width}}  stop   {'impulse':>12}  {'lost [J]':>12}"
        lines = [
            f"{t:14.9f}  {joint:<{width}}  {side:<5}  {impulse:12.5g}  {lost:12.5g}"
            for t, joint, side, impulse, lost in self.rows
        ]
        return "\n".join([head, *lines])

    def _repr_html_(self) -> str:
        from ..common.html import card, table

        about = f"{len(self.times)} impacts, {self.energy_lost.sum():.4g} J lost"
        return card(
            "impacts",
            about,
            table("", ["t [s]", "joint", "stop", "impulse", "lost [J]"], self.rows),
        )


@dataclass(frozen=True)
class Impact:
    """The rows of one impact; see ImpactTable.

    Attributes:
        t: Time [s].
        joint: Names of the joints.
        side: Their stops.
        impulse: Impulses on the joints, (K,).
        rates: Rates before and after, (2, K).
        energy_lost: Energy that each impulse removes, (K,) [J].
        work_of_drives: Work of the drives of prescribed joints during the impact [J].
    """

    t: float
    joint: tuple[str, ...]
    side: tuple[str, ...]
    impulse: Array
    rates: Array
    energy_lost: Array
    work_of_drives: float


@checks_arguments
@dataclass(frozen=True)
class MemberImpacts(ImpactTable):
    """The impacts of all members of simulate_many; rows are sorted by member, then by time.

    Members that failed have no rows.

    Attributes:
        member: Indices of the members, (K,).
        count: Number of members N.
    """

    member: Indices
    count: int

    @classmethod
    def of(cls, tables: Mapping[int, ImpactTable], count: int, r: int) -> MemberImpacts:
        """Return the table of some members.

        Args:
            tables: Tables by member.
            count: Number of members.
            r: Number of momentum components.
        Returns:
            The table.
        """
        ordered = {member: tables[member] for member in sorted(tables)}
        columns: dict[str, Any] = {}
        for name in ImpactTable.__dataclass_fields__:
            parts = [getattr(table, name) for table in (no_impacts(r), *ordered.values())]
            texts = name in _TEXTS
            columns[name] = tuple(chain.from_iterable(parts)) if texts else np.concatenate(parts)
        members = np.array([*ordered], dtype=np.int64)
        columns["member"] = np.repeat(members, [len(table) for table in ordered.values()])
        return cls(**columns, count=count)

    @cached_property
    def counts(self) -> Indices:
        """Number of impacts of each member, (N,)."""
        distinct = np.append(True, (np.diff(self.member) > 0) | (np.diff(self.t) > 0.0))
        return np.bincount(self.member[distinct[: len(self)]], minlength=self.count)

    def of_member(self, member: int) -> ImpactTable:
        """Return the impacts of one member.

        Args:
            member: Index of the member.
        Returns:
            The table.
        """
        member = range(self.count)[member]
        first, last = np.searchsorted(self.member, [member, member + 1]).tolist()
        names = ImpactTable.__dataclass_fields__
        return ImpactTable(**{name: getattr(self, name)[first:last] for name in names})

    def __str__(self) -> str:
        if not len(self):
            return super().__str__()
        head, *lines = super().__str__().splitlines()
        rows = zip(self.member.tolist(), lines, strict=True)
        return "\n".join([f"{'member':>8}{head}", *(f"{k:>8}{line}" for k, line in rows)])

    def _repr_html_(self) -> str:
        from ..common.html import card, table

        about = f"{self.counts.sum()} impacts, {self.energy_lost.sum():.4g} J lost"
        entries = [(k, *entry) for k, entry in zip(self.member.tolist(), self.rows, strict=True)]
        names = ["member", "t [s]", "joint", "stop", "impulse", "lost [J]"]
        return card(f"impacts of {self.count} members", about, table("", names, entries))


def table_of(impacts: Sequence[Impact], momenta: Array) -> ImpactTable:
    """Return the table of impacts, with spatial momenta before and after each, (I, 2, r)."""
    counts = [len(impact.joint) for impact in impacts]
    rates = np.hstack([np.empty((2, 0)), *(impact.rates for impact in impacts)])
    momenta = np.repeat(momenta, counts, axis=0)
    return ImpactTable(
        t=np.repeat([impact.t for impact in impacts], counts),
        joint=tuple(name for impact in impacts for name in impact.joint),
        side=tuple(side for impact in impacts for side in impact.side),
        impulse=np.concatenate([np.empty(0), *(impact.impulse for impact in impacts)]),
        rate_before=rates[0],
        rate_after=rates[1],
        energy_lost=np.concatenate([np.empty(0), *(impact.energy_lost for impact in impacts)]),
        momentum_before=momenta[:, 0],
        momentum_after=momenta[:, 1],
    )


_IN_FILES = "impact_"  # beginning of the names of a table's arrays in files


def impact_arrays(table: ImpactTable | None) -> dict[str, Any]:
    """Return the arrays of a table for a file, {name: array}; empty without impacts."""
    if table is None or not len(table):
        return {}
    columns = (*ImpactTable.__dataclass_fields__, *(["member"] * hasattr(table, "member")))
    return {f"{_IN_FILES}{name}": np.array(getattr(table, name)) for name in columns}


def member_table_in(content: Mapping[str, Any], r: int, count: int) -> MemberImpacts:
    """Return the table of impacts in the arrays of a file of members.

    Args:
        content: Arrays of a file by name.
        r: Number of momentum components.
        count: Number of members.
    Returns:
        The table; without rows if the file has no impacts.
    Raises:
        ValueError: An array is missing, or has the wrong shape or type.
    """
    table = table_in(content, r)
    member = np.asarray(content.get(f"{_IN_FILES}member", np.zeros(0, int)))
    is_sorted = member.dtype.kind == "i" and member.shape == (len(table),)
    if not is_sorted or (np.diff(member, prepend=0, append=count - 1) < 0).any():
        raise ValueError("its impacts have no sorted members")
    columns = {name: getattr(table, name) for name in ImpactTable.__dataclass_fields__}
    return MemberImpacts(**columns, member=member, count=count)


def table_in(content: Mapping[str, Any], r: int) -> ImpactTable:
    """Return the table of impacts in the arrays of a file.

    Args:
        content: Arrays of a file by name.
        r: Number of momentum components.
    Returns:
        The table; without rows if the file has no impacts.
    Raises:
        ValueError: An array is missing, or has the wrong shape or type.
    """
    if f"{_IN_FILES}t" not in content:
        return no_impacts(r)
    count, columns = np.size(content[f"{_IN_FILES}t"]), dict[str, Any]()
    for name in ImpactTable.__dataclass_fields__:
        values = np.asarray(content.get(f"{_IN_FILES}{name}"))
        if name in _TEXTS:
            if values.shape != (count,) or values.dtype.kind != "U":
                raise ValueError(f"its impacts have no {name} of each")
            columns[name] = tuple(map(str, values))
            continue
        shape = (count, r) if name.startswith("momentum") else (count,)
        if values.shape != shape or values.dtype.kind != "f":
            raise ValueError(f"its impacts have '{name}' of shape {values.shape}, not {shape}")
        if not name.startswith("momentum") and not np.isfinite(values).all():
            raise ValueError(f"its impacts have '{name}' that is not finite")
        columns[name] = np.array(values)
    return ImpactTable(**columns)


def joined_tables(tables: Sequence[ImpactTable]) -> ImpactTable:
    """Return the rows of tables with equal momentum components together, in order of time."""
    order = np.argsort(np.concatenate([table.t for table in tables]), kind="stable")
    columns = dict[str, Any]()
    for name in ImpactTable.__dataclass_fields__:
        values = np.concatenate([np.asarray(getattr(table, name)) for table in tables])[order]
        columns[name] = tuple(values.tolist()) if name in ("joint", "side") else values
    return ImpactTable(**columns)


def no_impacts(r: int) -> ImpactTable:
    """Return an empty table for a system with r momentum components."""
    return table_of([], np.empty((0, 2, r)))


def solve_complementarity(G: Array, q: Array) -> Array:
    """Solve w = G z + q ≥ 0, z ≥ 0, z · w = 0 for a positive definite matrix G.

    The solution is unique. It minimises ½ zᵀGz + qᵀz over z ≥ 0, which is a problem of nonnegative
    least squares; the positive entries then solve their linear equations.

    Args:
        G: Matrix, (K, K).
        q: Right side, (K,).
    Returns:
        z, (K,).
    """
    if (q >= 0.0).all():
        return np.zeros(len(q))
    z = np.linalg.solve(G, -q)
    if (z >= 0.0).all():
        return np.asarray(z)
    from scipy.optimize import nnls

    # Entries of unit size: joints may differ in unit and inertia.
    scale = 1.0 / np.sqrt(np.diag(G))
    L = np.linalg.cholesky(scale[:, None] * G * scale)
    scaled, _ = nnls(L.T, np.linalg.solve(L, -scale * q))
    positive = scaled > _PIVOTS * scaled.max(initial=0.0)
    z = np.zeros(len(q))
    z[positive] = np.linalg.solve(G[np.ix_(positive, positive)], -q[positive])
    return z


def impulses(G: Array, u: Array, restitution: Array) -> Array:
    """Compute the impulses at stops that several joints touch at once.

    Newton's law holds at each stop with an impulse: u⁺ = −e u⁻. Joints that would leave their stop
    faster get none. So u⁺ + e u⁻ ≥ 0, λ ≥ 0, and one of the two is zero. The energy changes by
    ½ Σ λ (u⁺ + u⁻) = ½ Σ λ (1 − e) u⁻ ≤ 0.

    Args:
        G: Block (M⁻¹)_SS of the inverse reduced metric, with the signs of the stops, (K, K).
        u: Rates away from the stops before the impact, (K,); none is positive.
        restitution: Coefficients of restitution e, (K,).
    Returns:
        Impulses λ away from the stops, (K,).
    """
    return solve_complementarity(G, (1.0 + restitution) * u)
