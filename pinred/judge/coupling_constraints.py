"""Accelerations of the full system with couplings between joints as constraints.

This is independent of the reduction, which eliminates follower (mimic) joints. In the full system
all joints move. Multipliers keep each follower coupled to its leaders, a_f − Σ k a_l = 0:

    a = a₀ − M⁻¹Jᵀ (J M⁻¹Jᵀ)⁻¹ J a₀,   a₀ and M⁻¹Jᵀ computed with Pinocchio's ABA.

Closed loops are further constraints, J(q) a + J̇ v = 0. Of redundant rows, those are used that the
system states as independent; `loop_errors` measures all of them. One linear system for
accelerations and multipliers is solved instead if the mass matrix of the uncoupled tree is
singular, or if accelerations are prescribed as well. Without couplings and loops ABA is used alone,
or the rows of Pinocchio's mass matrix without those of the joints with prescribed accelerations.
Source: R. Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 8.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..forces.force_values import FunctionBuffers
from ..system.loops.kinematics import LoopKinematics
from ..system.singular_mass_matrix import SingularShapes, singular_shapes
from ..system.system import System
from .loop_errors import RANK
from .scipy_files import dposv


class _FreeRows:
    """The linear equations of all accelerations when some of them are prescribed.

    The rows of prescribed accelerations are those of the identity matrix. Compiled code fills the
    equations, because numpy's selection of rows and columns takes longer than their solution.

    Attributes:
        inputs: Mass matrix H row by row, of which only the upper triangle is read, because CRBA
            computes no more, (nv²,); forces (nv,); and prescribed accelerations (k,).
        matrix: Lower triangle of the symmetric matrix, (nv, nv), which `run` computes.
        right: Right-hand side, (nv,), which `run` computes.
        run: Function without arguments that computes the equations.
    """

    def __init__(self, nv: int, driven: list[int]) -> None:
        """Compile the equations of a model with nv velocities; `driven`: prescribed velocities."""
        free = [k for k in range(nv) if k not in driven]
        columns, force = ca.SX.sym("H", nv, nv), ca.SX.sym("force", nv)  # CasADi reads columns
        known = ca.SX.sym("known", len(driven))
        H = ca.tril2symm(ca.tril(columns))
        matrix, right = ca.SX(nv, nv), ca.SX(nv, 1)
        matrix[free, free], matrix[driven, driven] = H[free, free], ca.SX.eye(len(driven))
        right[free], right[driven] = force[free] - H[free, driven] @ known, known
        outputs = [ca.densify(ca.tril(matrix)), ca.densify(right)]
        buffers = FunctionBuffers(ca.Function("free", [columns, force, known], outputs))
        self.inputs, (self.matrix, column) = buffers.inputs, buffers.outputs
        self.right, self.run = column[:, 0], buffers.run


class CouplingConstraints:
    """The couplings of a system, each between a follower and its leaders as named in the file.

    Attributes:
        J: Constraint Jacobian, (c, nv), with J v = 0.
        leads: Indices of the shape's rates among the rates of all joints, (m,).
        leads_x: Indices of the shape's coordinates among the coordinates of all joints, (nx,).
    """

    def __init__(self, system: System) -> None:
        """Collect the couplings of a system by joint names."""
        model, r = system.sorted_model, system.r
        at = {name: k for k, name in enumerate(system.tree.names)}
        at_x = {name: k for k, name in enumerate(system.tree.x_names)}
        pending, placed = list(system.couplings), {*system.shape_names}
        self._at_x = {at[name]: k for name, k in at_x.items() if name in at}
        self._couplings: list[tuple[int, dict[int, float], float]] = []
        while pending:  # process leaders before their followers
            coupling = next(c for c in pending if placed.issuperset(c.leaders))
            pending.remove(coupling)
            placed.add(coupling.follower)
            ratios = {at[leader]: ratio for leader, ratio in coupling.ratios.items()}
            self._couplings.append((at[coupling.follower], ratios, coupling.offset))
        self.J = np.zeros((len(self._couplings), model.nv))
        for row, (follower, ratios, _) in zip(self.J, self._couplings, strict=True):
            row[r + follower] = 1.0
            for leader, ratio in ratios.items():
                row[r + leader] -= ratio
        self.leads = np.array([at[name] for name in system.shape_names], dtype=np.intp)
        self.leads_x = np.array([at_x[name] for name in system.x_names], dtype=np.intp)
        self._count, self._count_x = len(at), len(at_x)
        self._model, self._data = model, model.createData()
        self._weightless = model.copy()
        self._weightless.gravity.setZero()
        self._rows, self._columns = np.tril_indices(model.nv, -1)
        self._borders: dict[tuple[int, ...], Array] = {}
        self._uses_aba = not self._couplings or singular_shapes(model) == SingularShapes()
        self._loops = LoopKinematics(model, system.loops) if system.loops else None
        self._independent = None if system.closure is None else system.closure.rows
        self._is_constrained = bool(self._couplings or system.loops)
        self._all_lead = np.array_equal(self.leads, np.arange(len(at)))
        self._all_lead_x = np.array_equal(self.leads_x, np.arange(len(at_x)))
        self._free_rows: dict[tuple[int, ...], _FreeRows] = {}

    def values(self, x: Array) -> Array:
        """Return the coordinates of all joints at shape x (..., nx)."""
        values, at = np.zeros((*x.shape[:-1], self._count_x), dtype=x.dtype), self._at_x
        values[..., self.leads_x] = x
        for follower, ratios, offset in self._couplings:
            values[..., at[follower]] = offset
            for leader, ratio in ratios.items():
                values[..., at[follower]] += ratio * values[..., at[leader]]
        return values

    def rates(self, xdot: Array) -> Array:
        """Return the rates of all joints at shape rate ẋ (..., m)."""
        rates = np.zeros((*xdot.shape[:-1], self._count), dtype=xdot.dtype)
        rates[..., self.leads] = xdot
        for follower, ratios, _ in self._couplings:
            for leader, ratio in ratios.items():
                rates[..., follower] += ratio * rates[..., leader]
        return rates

    def shape(self, joints: Array) -> Array:
        """Select the shape (..., nx) from the coordinates of all joints."""
        return joints if self._all_lead_x else joints[..., self.leads_x]

    def shape_rate(self, rates: Array) -> Array:
        """Select the shape rate (..., m) from the rates of all joints."""
        return rates if self._all_lead else rates[..., self.leads]

    def joint_torques(self, torque: Array) -> Array:
        """Expand torques on the shape (m,) to all joints; followers get zero."""
        if self._all_lead:
            return torque
        torques = np.zeros(self._count, dtype=torque.dtype)
        torques[self.leads] = torque
        return torques

    def acceleration(
        self,
        q: Array,
        v: Array,
        tau: Array,
        driven: Sequence[int] = (),
        prescribed: Array | Sequence[float] = (),
        axes: pin.Convention = pin.Convention.LOCAL,
    ) -> Array:
        """Compute the acceleration (nv,) of the coupled system.

        Args:
            q: Pinocchio's configuration, (nq,).
            v: Pinocchio's velocity, (nv,).
            tau: Generalised forces, (nv,) [N | N·m].
            driven: Indices, among the rates of all joints, with prescribed acceleration.
            prescribed: Accelerations of these joints [rad/s² | m/s²].
            axes: Frames in which ABA is evaluated. Comparing two choices measures its round-off.
        Returns:
            (nv,) acceleration.
        """
        if len(driven) and not self._is_constrained:
            return self._solve_free_rows(q, v, tau, tuple(driven), prescribed)
        if len(driven) or not (self._uses_aba or self._loops):
            return self._solve_with_multipliers(q, v, tau, tuple(driven), prescribed)
        model, data = self._model, self._data
        free: Array = pin.aba(model, data, q, v, tau, axes)
        if not self._is_constrained:
            return free
        J, bias = self.J, np.zeros(len(self.J))
        if self._loops is not None:
            J = np.vstack([J, self._loops.jacobian(q)[self._independent]])
            bias = np.append(bias, self._loops.bias(q, v)[self._independent])
        zero = np.zeros(len(v))
        responses = np.array([pin.aba(self._weightless, data, q, zero, row, axes) for row in J])
        if self._loops is None:
            return np.asarray(free - np.linalg.solve(J @ responses.T, J @ free) @ responses)
        # Light links in loops have responses that are 1e10 times those of others.  Without scales
        # and a second solution of the remaining equations, integrators take steps of round-off.
        A = J @ responses.T
        sizes = A.diagonal()
        scale = 1.0 / np.sqrt(np.maximum(sizes, RANK**3 * sizes.max()))
        inverse = np.linalg.pinv(scale[:, None] * A * scale, RANK**2, hermitian=True)
        # Without the second solution, the other axes show what one solution loses by round-off.
        for _ in range(2 if axes == pin.Convention.LOCAL else 1):
            free = free - (scale * (inverse @ (scale * (J @ free + bias)))) @ responses
        return np.asarray(free)

    def _solve_free_rows(
        self,
        q: Array,
        v: Array,
        tau: Array,
        driven: tuple[int, ...],
        prescribed: Array | Sequence[float],
    ) -> Array:
        """Return the acceleration (nv,) of `acceleration` without couplings and loops."""
        rows = self._free_rows.get(driven)
        if rows is None:
            rows = self._free_rows[driven] = _FreeRows(
                len(v), [len(v) - self._count + int(k) for k in driven]
            )
        H, force, known = rows.inputs
        H[:] = pin.crba(self._model, self._data, q).ravel()
        np.subtract(tau, pin.nonLinearEffects(self._model, self._data, q, v), out=force)
        known[:] = prescribed
        rows.run()
        _, a, failure = dposv(rows.matrix, rows.right, 1, 1)  # lower triangle, overwritten
        if failure:  # Cholesky's method needs a matrix that is positive despite round-off
            return self._solve_with_multipliers(q, v, tau, driven, prescribed)
        return np.asarray(a)

    def _solve_with_multipliers(
        self,
        q: Array,
        v: Array,
        tau: Array,
        driven: tuple[int, ...],
        prescribed: Array | Sequence[float],
    ) -> Array:
        """Return the acceleration (nv,) of `acceleration` from one linear system.

        The mass matrix need only be regular in the directions that the constraints allow.
        """
        if self._loops is not None:
            return self._solve_in_null_space(q, v, tau, driven, prescribed)
        n, rows, columns = len(v), self._rows, self._columns
        matrix = self._border(driven).copy()
        upper = pin.crba(self._model, self._data, q)
        matrix[:n, :n] = upper
        matrix[rows, columns] = upper[columns, rows]
        right = np.zeros(len(matrix))
        right[:n] = tau - pin.nonLinearEffects(self._model, self._data, q, v)
        right[n + len(self.J) :] = prescribed
        return np.asarray(np.linalg.solve(matrix, right)[:n])

    def _solve_in_null_space(
        self,
        q: Array,
        v: Array,
        tau: Array,
        driven: tuple[int, ...],
        prescribed: Array | Sequence[float],
    ) -> Array:
        """Return the acceleration (nv,) of `acceleration` with loops.

        Rows may be redundant at shapes where loops determine prescribed joints.

        With all constraints C a = c and the null space N of C, a = C⁺c + N z and
        NᵀM N z = Nᵀ(τ − b − M C⁺c).
        """
        assert self._loops is not None
        n, at = len(v), len(self.J)
        border = self._border(driven)
        C = np.vstack([border[n:, :n], self._loops.jacobian(q)[self._independent]])
        c = np.zeros(len(C))
        c[at : at + len(driven)] = prescribed
        c[at + len(driven) :] = -self._loops.bias(q, v)[self._independent]
        U, sizes, Vt = np.linalg.svd(C)
        rank = int((sizes > RANK * sizes[0]).sum())
        a = Vt[:rank].T @ ((U.T @ c)[:rank] / sizes[:rank])
        N = Vt[rank:].T
        upper = pin.crba(self._model, self._data, q)
        M = np.triu(upper) + np.triu(upper, 1).T
        force = tau - pin.nonLinearEffects(self._model, self._data, q, v) - M @ a
        return np.asarray(a + N @ np.linalg.solve(N.T @ M @ N, N.T @ force))

    def _border(self, driven: tuple[int, ...]) -> Array:
        """Return the matrix [[0, Cᵀ], [C, 0]] for the constraints C of couplings and driven joints.

        A run calls this at each evaluation of its vector field, so the matrix is kept.
        """
        if driven not in self._borders:
            n = self.J.shape[1]
            selection = np.eye(n)[[n - self._count + k for k in driven]]
            constraints = np.vstack([self.J, selection])
            matrix = np.zeros((n + len(constraints), n + len(constraints)))
            matrix[n:, :n], matrix[:n, n:] = constraints, constraints.T
            self._borders[driven] = matrix
        return self._borders[driven]
