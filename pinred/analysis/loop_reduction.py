"""The reduction of robots with closed loops, in independent joint rates u̇ with ẋ = G u̇.

The loops are functions of the shape, so symmetry and locked inertia are unchanged, and the other
quantities are pulled back: A G, Gᵀ M G and Gᵀ B G, without further terms.  Derivatives ∂_c are
taken along column c of G.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, FrozenArrays, vector
from ..common.errors import InputError
from ..common.names import quoted
from ..reduction.inertia_split import InertiaSplit
from ..reduction.pointwise_reduction import PointwiseReduction, ReducedShape
from ..reduction.potential import Springs
from ..system.loops.loop_assembly import CLOSED, describe_gap, loop_gaps
from ..system.loops.loop_chart import loop_chart
from ..system.system import System, checked_system


@checks_arguments
@dataclass(frozen=True, eq=False)
class ClosedShape(FrozenArrays):
    """The reduction at one closed shape of a robot with loops; arrays are read-only.

    Attributes:
        x: Shape, (nx,) [rad | m | 1].
        independent: Labels of the independent rates, (d,).
        G: Map from independent rates to all shape rates, ẋ = G u̇, (m, d).
        locked_inertia: Locked inertia I, (r, r).
        local_connection: Local connection A G, (r, d).
        reduced_metric: Reduced metric Gᵀ M G, (d, d).
        curvature: Curvature Gᵀ B G, (r, d, d), with [:, a, b] = B_ab.
        com: Centre of mass in the root body's frame, (3,) [m].
        dG: Derivative ∂G, (m, d, d), with the derivative index last.
        dI: Derivative ∂I, (r, r, d), with the derivative index last.
        dA: Derivative ∂(A G), (r, d, d), with the derivative index last.
        dM: Derivative ∂(Gᵀ M G), (d, d, d), with the derivative index last.
        tree: Reduction of the open tree at this shape, in all rates.
    """

    x: Array
    independent: tuple[str, ...]
    G: Array
    locked_inertia: Array
    local_connection: Array
    reduced_metric: Array
    curvature: Array
    com: Array
    dG: Array
    dI: Array
    dA: Array
    dM: Array
    tree: ReducedShape

    @property
    def potential(self) -> float:
        """Potential V [J].  Raises SymmetryError if gravity breaks the symmetry."""
        return self.tree.potential

    def amended_potential(self, mu: ArrayLike) -> float:
        """Compute the amended potential V + ½ μᵀ I⁻¹ μ.

        Args:
            mu: Body momentum, (r,) [N s | N m s].
        Returns:
            The amended potential [J].
        """
        mu = vector(mu, len(self.locked_inertia), "mu")
        return self.potential + 0.5 * float(mu @ np.linalg.solve(self.locked_inertia, mu))


@checks_arguments
class LoopReduction:
    """The reduction of a robot with closed loops, in independent joint rates.

    An instance owns Pinocchio work space, so use one per thread.
    """

    def __init__(
        self,
        system: System,
        *,
        independent: Sequence[str] | None = None,
        springs: Springs | None = None,
    ) -> None:
        """Choose the independent joints.

        Args:
            system: System with closed loops.
            independent: Names of the independent joints, as many as `System.shape_dim`.  None:
                they are chosen where the loops were assembled.  `at` replaces them at their dead
                points.
            springs: Springs that are added to V(x), {joint: (stiffness [N·m/rad | N/m],
                rest [rad | m])}.
        Raises:
            InputError: The system has no loops, or the independent joints are not valid.
            SingularInertiaError: The independent joints do not determine the others.
        """
        self.system = checked_system(system, "LoopReduction", loops=True)
        if not system.loops:
            raise InputError("LoopReduction: expected a robot with loops. Use Reduction.")
        self._chart = loop_chart(system, independent)
        self._tree = PointwiseReduction(system.open_tree(), springs=springs)

    def __repr__(self) -> str:
        return f"LoopReduction({self.system!r}, independent={self.independent})"

    @property
    def independent(self) -> tuple[str, ...]:
        """Labels of the independent rates, (d,)."""
        return self._chart.names

    def shape(self, u: ArrayLike) -> Array:
        """Return the closed shape with given independent coordinates.

        Args:
            u: Independent coordinates, (d,) [rad | m].
        Returns:
            Shape, (nx,) [rad | m | 1], connected with the assembled shape.
        Raises:
            SingularInertiaError: The loops do not close there.
            InputError: An independent rate is an axis of a ball.
        """
        u = vector(u, self.system.shape_dim, "u", self.independent)
        return np.asarray(self._chart.shapes(u[None])[0])

    def at(self, x: ArrayLike) -> ClosedShape:
        """Compute all quantities at one closed shape.

        At a dead point, where the independent joints do not determine the others, other independent
        joints replace them; `ClosedShape.independent` names them.

        Args:
            x: Closed shape, (nx,) [rad | m | 1].
        Returns:
            The quantities.
        Raises:
            InputError: A loop is open at x; the message names it and its gap.
            SingularInertiaError: The equations of the loops are dependent at x.
        """
        tree = self._tree.at(x)
        self._refuse_open(tree.x)
        chart = self._chart.regular_at(tree.x)
        G = chart.tangent(tree.x)
        dG = np.stack([chart.tangent_rate(tree.x, column, G) for column in G.T], axis=-1)
        A, M = tree.local_connection, tree.reduced_metric
        dM = np.einsum("mnp,ma,nb,pc->abc", tree.dM, G, G, G)
        turned = np.einsum("mac,mn,nb->abc", dG, M, G)
        return ClosedShape(
            x=tree.x,
            independent=chart.names,
            G=G,
            locked_inertia=tree.locked_inertia,
            local_connection=A @ G,
            reduced_metric=G.T @ M @ G,
            curvature=np.einsum("imn,ma,nb->iab", tree.curvature, G, G),
            com=tree.com,
            dG=dG,
            dI=tree.dI @ G,
            dA=np.einsum("imp,ma,pc->iac", tree.dA, G, G) + np.einsum("im,mac->iac", A, dG),
            dM=dM + turned + turned.transpose(1, 0, 2),
            tree=tree,
        )

    def split(self, x: ArrayLike) -> InertiaSplit:
        """Compute I, A G, GᵀMG, the mass matrix and the centre of mass at one closed shape.

        Args:
            x: Closed shape, (nx,) [rad | m | 1].
        Returns:
            The quantities without derivatives, in the rates of `independent`.
        Raises:
            InputError: A loop is open at x; the message names it and its gap.
            SingularInertiaError: The independent joints do not determine the others at x.
        """
        tree = self._tree.split(x)
        self._refuse_open(tree.x)
        G = self._chart.tangent(tree.x)
        (m, d), r = G.shape, tree.r
        T = np.zeros((r + m, r + d))
        T[:r, :r], T[r:, r:] = np.eye(r), G
        return InertiaSplit(
            x=tree.x,
            mass_matrix=T.T @ tree.mass_matrix @ T,
            locked_inertia=tree.locked_inertia,
            local_connection=tree.local_connection @ G,
            reduced_metric=G.T @ tree.reduced_metric @ G,
            com=tree.com,
        )

    def _refuse_open(self, x: Array) -> None:
        """Raise InputError if a loop is open at shape x (nx,)."""
        system, closure = self.system, self.system.closure
        assert closure is not None
        gaps = loop_gaps(system, x, closure.length)
        if gaps.max() > 1e3 * CLOSED:
            raise InputError(
                f"x: expected a closed shape of {quoted(system.name)}, but "
                f"{describe_gap(system, gaps, closure.length)}. LoopReduction.shape returns one."
            )
