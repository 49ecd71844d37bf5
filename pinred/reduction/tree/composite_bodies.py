"""Mass matrix and its derivatives at many shapes at once, by composite bodies in closed form.

Every scalar of the recursion is an array over the shapes, or a float where it is the same at
all of them, so NumPy runs through thousands of shapes in one go and nothing is compiled.
Everything is in the axes of the root body, each inertia about the origin of its own joint.
With S_k the axis of joint k, I_k the inertia of the composite body behind it, and F_k = I_k S_k
the momentum at unit rate,

    H_jk = S_j · F_k,           j from k to the root,
    ∂_j F_k = S_j ×* F_k,       j from k to the root: the joint carries all of it,
    ∂_k I_j = ∂_k I_k,          and so ∂_k F_j = (∂_k I_k) S_j for every j before k.

Joints of different branches do not see each other.  Source: R. Featherstone, "Rigid Body
Dynamics Algorithms", 2008, ch. 6; differentiated here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array
from ...system.system import System
from .body_frames import Body, bodies_of, cosine, sine
from .scalars import INDEX, Scalar, Sym, Turn, Vec, add, cross, dot, mul, plus, sub, times


@dataclass
class Composite:
    """The body behind a joint with all that hangs on it, in the axes of the root body.

    step: from the parent's origin to its own.  origin: its own, from the root's.  axis: of
    the joint.  mass, moment, inertia: about its own origin.
    """

    parent: int
    prismatic: bool
    step: Vec
    origin: Vec
    axis: Vec
    mass: float
    moment: Vec
    inertia: Sym


class CompositeBodies:
    """The composite bodies of one system; every method takes shapes x, (N, m).

    Where joints follow others, all joints are differentiated by, and what comes out is put
    together afterwards.
    """

    def __init__(self, system: System) -> None:
        """Prepare the frames of the bodies."""
        self._system, self._bodies = system, bodies_of(system)
        self._armature = np.array(system.model.armature)
        self._rows = system.group.axes

    def mass_matrix(self, x: Array, H: Array) -> None:
        """Write H into zeros (N, n, n); entries of joints on different branches stay zero."""
        if self._system.coupled is None:
            self._write_mass_matrix(x, H)
            return
        every = np.zeros((len(x), len(self._armature), len(self._armature)))
        self._write_mass_matrix(x, every)
        H[:] = self._system.coupled_matrix(every)

    def _write_mass_matrix(self, x: Array, H: Array) -> None:
        r = len(self._rows)
        bodies = self._composites(x)
        H[:, :r, :r] = self._inertia(len(x), bodies[0].mass, bodies[0].moment, bodies[0].inertia)
        for k in range(1, len(bodies)):
            column = r + k - 1
            for j, (lin, ang) in _momenta(bodies, k):
                if j:
                    along = dot(bodies[j].axis, lin if bodies[j].prismatic else ang)
                    H[:, r + j - 1, column] = H[:, column, r + j - 1] = along
                else:
                    self._put(H[:, :r, column], lin, ang)
        H[:, r:, :r] = np.swapaxes(H[:, :r, r:], 1, 2)
        diagonal = np.arange(H.shape[1])
        H[:, diagonal, diagonal] += self._armature

    def derivatives(self, x: Array, dIA: Array) -> Array:
        """Return dI, (N, m, r, r), and write d(IA) into zeros (N, r, m, m); ∂ is the first m."""
        coupled, r, count = self._system.coupled, len(self._rows), len(self._bodies) - 1
        if coupled is None:
            return self._write_derivatives(x, dIA)
        every = np.zeros((len(x), r, count, count))
        dI = self._write_derivatives(x, every)
        dIA[:] = coupled.matrix(every, 0)
        return np.moveaxis(coupled.forces(np.moveaxis(dI, 1, -1), 0), -1, 1)

    def _write_derivatives(self, x: Array, dIA: Array) -> Array:
        r, m = len(self._rows), len(self._bodies) - 1
        bodies = self._composites(x)
        dI = np.empty((len(x), m, r, r))
        for k in range(1, len(bodies)):
            own = bodies[k]
            for j, (lin, ang) in _momenta(bodies, k):
                if j:
                    moved = _carried(bodies[j], lin, ang)
                    self._put(dIA[:, :, j - 1, k - 1], *_to_root(bodies[j], *moved))
            moment, inertia = _growth(own)
            at_root = _shifted(0.0, moment, inertia, own.origin)
            dI[:, k - 1] = self._inertia(len(x), 0.0, *at_root)
            lever, j = own.step, own.parent
            while j:
                axis = bodies[j].axis
                if bodies[j].prismatic:
                    lin, ang = [0.0, 0.0, 0.0], cross(moment, axis)
                else:
                    lin = cross(axis, moment)
                    ang = plus(cross(moment, cross(axis, lever)), times(inertia, axis))
                self._put(dIA[:, :, k - 1, j - 1], *_to_root(own, lin, ang))
                lever, j = plus(lever, bodies[j].step), bodies[j].parent
        return dI

    def com(self, x: Array) -> Array:
        """Return the centre of mass in Pinocchio's root body frame, (N, 3)."""
        root = self._composites(x)[0]
        out = np.empty((len(x), 3))
        for k, entry in enumerate(root.moment):
            out[:, k] = entry / root.mass
        return np.asarray(out @ self._bodies[0].frame.rotation.T)

    def _composites(self, x: Array) -> list[Composite]:
        """Return the composite bodies, the root first."""
        columns = np.ascontiguousarray(self._system.joint_values(x).T)
        rows = [[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]]
        out: list[Composite] = []
        for i, body in enumerate(self._bodies):
            step, origin = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
            if i:
                turned, step = _outward(body, rows[body.parent], columns[i - 1])
                origin = plus(out[body.parent].origin, step)
                rows.append(turned)
            R = rows[i]
            moment: Vec = body.moment
            inertia = body.inertia
            half = [times(inertia, row) for row in R]
            out.append(
                Composite(
                    parent=body.parent,
                    prismatic=body.prismatic,
                    step=step,
                    origin=origin,
                    axis=[row[2] for row in R],
                    mass=float(body.mass),
                    moment=[dot(row, moment) for row in R],
                    inertia=[dot(R[a], half[b]) for a in range(3) for b in range(a, 3)],
                )
            )
        for i in range(len(out) - 1, 0, -1):
            own, parent = out[i], out[out[i].parent]
            moment, inertia = _shifted(own.mass, own.moment, own.inertia, own.step)
            parent.mass += own.mass
            parent.moment = plus(parent.moment, moment)
            parent.inertia = [add(p, q) for p, q in zip(parent.inertia, inertia, strict=True)]
        return out

    def _inertia(self, count: int, mass: float, moment: Vec, inertia: Sym) -> Array:
        """Return the group's rows and columns of an inertia, (N, r, r)."""
        x, y, z = moment
        skew = [[0.0, mul(-1.0, z), y], [z, 0.0, mul(-1.0, x)], [mul(-1.0, y), x, 0.0]]
        out = np.zeros((count, len(self._rows), len(self._rows)))
        for a, i in enumerate(self._rows):
            for b, j in enumerate(self._rows):
                if i < 3 and j < 3:
                    entry: Scalar = mass if i == j else 0.0
                elif i < 3:
                    entry = skew[j - 3][i]
                elif j < 3:
                    entry = skew[i - 3][j]
                else:
                    entry = inertia[INDEX[i - 3][j - 3]]
                out[:, a, b] = entry
        return out

    def _put(self, out: Array, lin: Vec, ang: Vec) -> None:
        """Write the group's entries of a momentum into (N, r)."""
        both = [*lin, *ang]
        for a, i in enumerate(self._rows):
            out[:, a] = both[i]


def _outward(body: Body, rows: list[Vec], x: Array) -> tuple[list[Vec], Vec]:
    """Return a body's rotation, by rows, and its step, from its parent's rotation."""
    step = [dot(row, body.r) for row in rows]
    if body.prismatic:
        own = Turn(2, cosine(body.offset), sine(body.offset))
    else:
        angle = x + body.offset
        own = Turn(2, np.cos(angle), np.sin(angle))
    for turn in (
        Turn(2, *body.beta),
        Turn(0, *body.alpha),
        Turn(1, *body.delta),
        own,
    ):
        rows = [turn.back(row) for row in rows]
    if body.prismatic:
        step = plus(step, [mul(x, row[2]) for row in rows])
    return rows, step


def _shifted(mass: float, moment: Vec, inertia: Sym, step: Vec) -> tuple[Vec, Sym]:
    """Return moment and inertia about a point at −step."""
    d, g = step, [add(mul(2.0, h), mul(mass, c)) for h, c in zip(moment, step, strict=True)]
    out = _sum_of_products(d, g, inertia)
    return [add(h, mul(mass, c)) for h, c in zip(moment, d, strict=True)], out


def _sum_of_products(d: Vec, g: Vec, inertia: Sym) -> Sym:
    """Return inertia + (d · g) 1 − ½ (d gᵀ + g dᵀ)."""
    products = [mul(a, b) for a, b in zip(d, g, strict=True)]
    out = list(inertia)
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        out[INDEX[a][a]] = add(inertia[INDEX[a][a]], add(products[b], products[c]))
        cross_term = mul(0.5, add(mul(d[a], g[b]), mul(g[a], d[b])))
        out[INDEX[a][b]] = sub(inertia[INDEX[a][b]], cross_term)
    return out


def _momenta(bodies: list[Composite], k: int) -> Iterator[tuple[int, tuple[Vec, Vec]]]:
    """Yield F_k about the origins of the bodies from k to the root, with their indices."""
    own = bodies[k]
    if own.prismatic:
        lin, ang = [mul(own.mass, c) for c in own.axis], cross(own.moment, own.axis)
    else:
        lin, ang = cross(own.axis, own.moment), times(own.inertia, own.axis)
    j = k
    while j:
        yield j, (lin, ang)
        ang, j = plus(ang, cross(bodies[j].step, lin)), bodies[j].parent
    yield 0, (lin, ang)


def _carried(body: Composite, lin: Vec, ang: Vec) -> tuple[Vec, Vec]:
    """Return S ×* (lin, ang) about the origin of the body whose axis is S."""
    if body.prismatic:
        return [0.0, 0.0, 0.0], cross(body.axis, lin)
    return cross(body.axis, lin), cross(body.axis, ang)


def _to_root(body: Composite, lin: Vec, ang: Vec) -> tuple[Vec, Vec]:
    """Return a momentum about the root's origin from one about the origin of a body."""
    return lin, plus(ang, cross(body.origin, lin))


def _growth(body: Composite) -> tuple[Vec, Sym]:
    """Return the derivative of moment and inertia by the joint, about where its origin is now."""
    z, h, J = body.axis, body.moment, body.inertia
    if body.prismatic:
        moment, twice = [mul(body.mass, c) for c in z], [mul(2.0, c) for c in h]
        return moment, _sum_of_products(z, twice, [0.0] * 6)
    turned = [cross(z, [J[INDEX[i][j]] for i in range(3)]) for j in range(3)]  # columns of ẑ J
    return cross(z, h), [add(turned[j][i], turned[i][j]) for i in range(3) for j in range(i, 3)]
