"""Scalar arithmetic of the sweep: small vectors, symmetric matrices, rotations about an axis.

Entries are floats or CasADi SX scalars.  Products with 0 and 1 are simplified, so that constants 0
and 1 of a robot, and the zeros of a planar robot, cost no operations.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import casadi as ca

Scalar: TypeAlias = Any  # float or casadi.SX
Vec: TypeAlias = list[Scalar]  # vector, (3,)
Sym: TypeAlias = list[Scalar]  # symmetric 3 × 3 matrix: xx, xy, xz, yy, yz, zz
Mat: TypeAlias = list[list[Scalar]]  # 3 × 3 matrix, by rows

INDEX = ((0, 1, 2), (1, 3, 4), (2, 4, 5))  # index of entry (i, j) in Sym

_OPERATORS: dict[int, Callable[[Any, Any], Any]] = {
    ca.OP_ADD: operator.add, ca.OP_SUB: operator.sub, ca.OP_MUL: operator.mul,
}  # fmt: skip


def mul(a: Scalar, b: Scalar) -> Scalar:
    """Return a b, without an operation if one factor is exactly 0 or ±1."""
    if isinstance(a, float) and isinstance(b, float):
        return a * b
    for x, y in ((a, b), (b, a)):
        if isinstance(x, float):
            if x == 0.0:
                return 0.0
            if x == 1.0:
                return y
            if x == -1.0:
                return -y
    return _operate(ca.OP_MUL, a, b)


def add(a: Scalar, b: Scalar) -> Scalar:
    """Return a + b, without an operation if one summand is exactly zero."""
    if isinstance(a, float) and a == 0.0:
        return b
    if isinstance(b, float) and b == 0.0:
        return a
    return _operate(ca.OP_ADD, a, b)


def sub(a: Scalar, b: Scalar) -> Scalar:
    """Return a − b; if one operand is exactly zero, return a or −b."""
    if isinstance(b, float) and b == 0.0:
        return a
    if isinstance(a, float) and a == 0.0:
        return -b
    return _operate(ca.OP_SUB, a, b)


def _operate(operation: int, a: Scalar, b: Scalar) -> Scalar:
    """Apply a CasADi operation; this takes 3 µs, but CasADi's own +, − and * take 20 µs."""
    if isinstance(a, ca.SX) or isinstance(b, ca.SX):
        return ca.SX.binary(operation, a, b)
    return _OPERATORS[operation](a, b)


def total(terms: list[Scalar]) -> Scalar:
    """Return the sum of terms."""
    result: Scalar = 0.0
    for term in terms:
        result = add(result, term)
    return result


def dot(a: Vec, b: Vec) -> Scalar:
    """Return a · b."""
    return total([mul(x, y) for x, y in zip(a, b, strict=True)])


def cross(a: Vec, b: Vec) -> Vec:
    """Return a × b."""
    return [
        sub(mul(a[1], b[2]), mul(a[2], b[1])),
        sub(mul(a[2], b[0]), mul(a[0], b[2])),
        sub(mul(a[0], b[1]), mul(a[1], b[0])),
    ]


def plus(a: Vec, b: Vec) -> Vec:
    """Return a + b."""
    return [add(x, y) for x, y in zip(a, b, strict=True)]


class Turn:
    """A rotation R about a coordinate axis, stored as the cosine and sine of its angle."""

    def __init__(self, axis: int, c: Scalar, s: Scalar) -> None:
        """Store the axis (0, 1, 2) and cosine and sine of the angle."""
        self.c, self.s = c, s
        self.z = axis
        self.x, self.y = (axis + 1) % 3, (axis + 2) % 3

    @property
    def is_none(self) -> bool:
        """Whether the rotation is the constant identity."""
        constant = isinstance(self.c, float) and isinstance(self.s, float)
        return constant and self.s == 0.0 and self.c == 1.0

    def vector(self, v: Vec) -> Vec:
        """Return R v, which transforms v from the rotated frame to the fixed frame."""
        rotated = list(v)
        rotated[self.x] = sub(mul(self.c, v[self.x]), mul(self.s, v[self.y]))
        rotated[self.y] = add(mul(self.s, v[self.x]), mul(self.c, v[self.y]))
        return rotated

    def back(self, v: Vec) -> Vec:
        """Return Rᵀ v, which transforms v from the fixed frame to the rotated frame."""
        return Turn(self.z, self.c, mul(-1.0, self.s)).vector(v)

    def _block(self, xx: Scalar, xy: Scalar, yy: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """Rotate a symmetric 2 × 2 block in 11 operations, instead of 17 for the product."""
        d = sub(yy, xx)
        k = sub(mul(self.s, d), mul(mul(2.0, self.c), xy))
        sk = mul(self.s, k)
        return add(xx, sk), mul(-1.0, add(mul(self.c, k), xy)), sub(yy, sk)

    def symmetric(self, m: Sym) -> Sym:
        """Return R m Rᵀ for a symmetric matrix m."""
        x, y, z = self.x, self.y, self.z
        rotated = list(m)
        xx, xy, yy = self._block(m[INDEX[x][x]], m[INDEX[x][y]], m[INDEX[y][y]])
        rotated[INDEX[x][x]], rotated[INDEX[x][y]], rotated[INDEX[y][y]] = xx, xy, yy
        a, b = m[INDEX[x][z]], m[INDEX[y][z]]
        rotated[INDEX[x][z]] = sub(mul(self.c, a), mul(self.s, b))
        rotated[INDEX[y][z]] = add(mul(self.s, a), mul(self.c, b))
        return rotated

    def matrix(self, m: Mat) -> Mat:
        """Return R m Rᵀ for a general matrix m."""
        x, y, z = self.x, self.y, self.z
        rotated = [list(row) for row in m]
        # As in _block: a rotation keeps the difference of the two off-diagonal entries.
        k = sub(mul(self.s, sub(m[y][y], m[x][x])), mul(self.c, add(m[x][y], m[y][x])))
        sk, ck = mul(self.s, k), mul(self.c, k)
        rotated[x][x], rotated[y][y] = add(m[x][x], sk), sub(m[y][y], sk)
        rotated[x][y], rotated[y][x] = mul(-1.0, add(ck, m[y][x])), mul(-1.0, add(ck, m[x][y]))
        rotated[x][z] = sub(mul(self.c, m[x][z]), mul(self.s, m[y][z]))
        rotated[y][z] = add(mul(self.s, m[x][z]), mul(self.c, m[y][z]))
        rotated[z][x] = sub(mul(self.c, m[z][x]), mul(self.s, m[z][y]))
        rotated[z][y] = add(mul(self.s, m[z][x]), mul(self.c, m[z][y]))
        return rotated


class Rotation:
    """A rotation R as a matrix, with the operations of Turn."""

    is_none = False

    def __init__(self, rows: Mat) -> None:
        """Store the matrix by rows."""
        self._rows = rows
        self._columns = [list(column) for column in zip(*rows, strict=True)]

    def vector(self, v: Vec) -> Vec:
        """Return R v, which transforms v from the rotated frame to the fixed frame."""
        return [dot(row, v) for row in self._rows]

    def back(self, v: Vec) -> Vec:
        """Return Rᵀ v, which transforms v from the fixed frame to the rotated frame."""
        return [dot(column, v) for column in self._columns]

    def symmetric(self, m: Sym) -> Sym:
        """Return R m Rᵀ for a symmetric matrix m."""
        if all(isinstance(entry, float) and entry == 0.0 for entry in m):
            return list(m)
        products = [times(m, row) for row in self._rows]  # row i of R m
        return [dot(products[i], self._rows[j]) for i in range(3) for j in range(i, 3)]

    def matrix(self, m: Mat) -> Mat:
        """Return R m Rᵀ for a general matrix m."""
        columns = [list(column) for column in zip(*m, strict=True)]
        products = [[dot(row, column) for column in columns] for row in self._rows]
        return [[dot(row, other) for other in self._rows] for row in products]


def quaternion_matrix(q: Sequence[Scalar]) -> Mat:
    """Return the rotation matrix, by rows, of a quaternion (x, y, z, w) of any norm."""
    x, y, z, w = q
    s = 2.0 / (x * x + y * y + z * z + w * w)
    a, b, c = s * x, s * y, s * z
    xx, xy, xz, yy, yz, zz = a * x, a * y, a * z, b * y, b * z, c * z
    wx, wy, wz = a * w, b * w, c * w
    return [
        [1.0 - yy - zz, xy - wz, xz + wy],
        [xy + wz, 1.0 - xx - zz, yz - wx],
        [xz - wy, yz + wx, 1.0 - xx - yy],
    ]


def quaternion_rate(q: Sequence[Scalar], omega: Sequence[Scalar]) -> list[Scalar]:
    """Return the quaternion rate ½ q ω."""
    x, y, z, w = q
    a, b, c = omega
    return [
        0.5 * (w * a + y * c - z * b),
        0.5 * (w * b + z * a - x * c),
        0.5 * (w * c + x * b - y * a),
        -0.5 * (x * a + y * b + z * c),
    ]


def quaternion_rate_in_parent(q: Sequence[Scalar], omega: Sequence[Scalar]) -> list[Scalar]:
    """Return the quaternion rate ½ ω q for an angular velocity in the axes of the parent."""
    x, y, z, w = q
    a, b, c = omega
    return [
        0.5 * (w * a + b * z - c * y),
        0.5 * (w * b + c * x - a * z),
        0.5 * (w * c + a * y - b * x),
        -0.5 * (x * a + y * b + z * c),
    ]


def times(m: Sym, v: Vec) -> Vec:
    """Return m v for a symmetric matrix m."""
    return [dot([m[INDEX[i][j]] for j in range(3)], v) for i in range(3)]


def factor_ldl(A: list[list[Scalar]]) -> tuple[list[list[Scalar]], list[Scalar], list[Scalar]]:
    """Factor a symmetric positive definite A = L D Lᵀ; return L below the diagonal, D, and 1/D."""
    n = len(A)
    L = [[0.0 for _ in range(n)] for _ in range(n)]
    inverse: list[Scalar] = []
    scaled = [[A[i][j] for j in range(n)] for i in range(n)]
    for j in range(n):
        inverse.append(1.0 / scaled[j][j])
        for i in range(j + 1, n):
            L[i][j] = mul(scaled[i][j], inverse[j])
        for i in range(j + 1, n):
            for k in range(j + 1, i + 1):
                scaled[i][k] = sub(scaled[i][k], mul(L[i][j], scaled[k][j]))
                scaled[k][i] = scaled[i][k]
    return L, [scaled[j][j] for j in range(n)], inverse


def solve_ldl(A: list[list[Scalar]], b: list[Scalar]) -> list[Scalar]:
    """Solve A x = b for a symmetric positive definite A with an LDLᵀ factorisation."""
    L, _, inverse = factor_ldl(A)
    return solve_factored(L, inverse, b)


def solve_spd(A: ca.SX, B: ca.SX) -> ca.SX:
    """Solve A X = B for a symmetric positive definite A, with the same accuracy in all units.

    The QR factorisation of `ca.solve` loses digits where the entries of A have different units.

    Args:
        A: The matrix, (n, n).
        B: Right sides, (n, k).
    Returns:
        X, (n, k).
    """
    if not B.numel():
        return ca.SX(*B.shape)
    L, _, inverse = factor_ldl([as_scalars(row.T) for row in ca.vertsplit(A)])
    columns = [solve_factored(L, inverse, as_scalars(column)) for column in ca.horzsplit(B)]
    return as_column(*columns).reshape(B.shape)


def solve_lower(L: list[list[Scalar]], b: list[Scalar]) -> list[Scalar]:
    """Return L⁻¹ b for a unit lower triangular L, given its entries below the diagonal."""
    y = list(b)
    for i in range(len(b)):
        y[i] = sub(y[i], total([mul(L[i][j], y[j]) for j in range(i)]))
    return y


def solve_factored(L: list[list[Scalar]], inverse: list[Scalar], b: list[Scalar]) -> list[Scalar]:
    """Return A⁻¹ b for A = L D Lᵀ.  L: entries below the unit diagonal; inverse: 1/D."""
    n, y = len(b), solve_lower(L, b)
    x = [mul(y[i], inverse[i]) for i in range(n)]
    for i in range(n - 1, -1, -1):
        x[i] = sub(x[i], total([mul(L[j][i], x[j]) for j in range(i + 1, n)]))
    return x


def as_column(*blocks: list[Scalar]) -> ca.SX:
    """Return lists of entries as one column."""
    entries = [entry for block in blocks for entry in block]
    return ca.vertcat(*entries) if entries else ca.SX(0, 1)


def as_scalars(column: ca.SX) -> list[Scalar]:
    """Return the entries of a column, constants as floats, so that products with 0 vanish."""
    entries = [column[k] for k in range(column.numel())]
    return [float(entry) if entry.is_constant() else entry for entry in entries]
