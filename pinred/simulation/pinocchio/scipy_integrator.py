"""The integrator of the Pinocchio route: SciPy's DOP853 over a flow called from Python."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.integrate import DOP853, DenseOutput, OdeSolution

from ...common.arrays import Array
from ...common.errors import IntegrationError
from ...integrators.methods import DOP853_LEAST
from ...reduction.inertia_split import lost_inertia
from ..piece import Integrate, Piece
from ..plan import Plan
from .readable_flow import ReducedFlow

MOST_STEPS = 1_000_000


def integrator(
    flow: ReducedFlow, plan: Plan, progress: Callable[[float], None] | None
) -> Integrate:
    """Return what integrates a flow from one time of its plan to another.

    That raises IntegrationError, with the time and the entry at fault, if the flow cannot be
    followed.
    """
    scene = plan.scene
    rtol, atol = scene.tolerance
    rtol = max(rtol, DOP853_LEAST)

    def run(
        start: float, end: float, y0: Array, watch: Callable[[Piece], bool] | None = None
    ) -> Piece:
        if y0.size == 0:  # one body that only translates: all of its motion is known
            empty = np.array([start, end])
            return Piece(empty, lambda t: np.empty((len(t), 0)), flow.numbers.copy(), 0, 0)
        solver = DOP853(flow.rate, start, y0, end, rtol=rtol, atol=atol)
        knots: list[float] = [start]

        def lost() -> str:
            y = solver.y if np.isfinite(solver.y).all() else solver.y_old
            return lost_inertia(scene.system, flow.shape(solver.t, y, flow.numbers))

        pieces: list[DenseOutput] = []

        def so_far() -> Piece:
            dense = OdeSolution(knots, pieces)
            return Piece(
                knots=np.array(knots),
                at=lambda t: np.asarray(dense(t)).T,
                numbers=flow.numbers.copy(),
                steps=len(pieces),
                evaluations=solver.nfev,
            )

        while solver.status == "running":
            if watch is not None and pieces and watch(so_far()):
                return so_far()
            if len(pieces) >= MOST_STEPS:
                raise IntegrationError(
                    f"'{scene.system.name}' took {MOST_STEPS} steps to t = {solver.t:g} s of "
                    f"{scene.end:g} s; shorten the scene or loosen the tolerance{lost()}"
                )
            with np.errstate(over="ignore", invalid="ignore"):  # what overflows is caught below
                message = solver.step()
                piece = solver.dense_output() if solver.status != "failed" else None
            if not np.isfinite(solver.y).all():
                entry = int(np.argmin(np.isfinite(solver.y)))
                raise IntegrationError(
                    f"{flow.entry_name(entry)} of '{scene.system.name}' is not finite after "
                    f"t = {knots[-1]:g} s{lost()}"
                )
            if solver.status == "failed":
                raise IntegrationError(
                    f"'{scene.system.name}' cannot be followed beyond t = {solver.t:g} s of "
                    f"{scene.end:g} s at rtol = {scene.rtol:g}: {message}{lost()}"
                )
            knots.append(solver.t)
            pieces.append(piece)
            if progress is not None:
                progress(solver.t / scene.end)
        return so_far()

    return run
