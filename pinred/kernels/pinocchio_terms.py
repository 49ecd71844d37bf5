"""Loads and closed loops by Pinocchio, for the validation of kernels and for the judge.

The generalised forces τ = Jᵀ (F, N) of wrenches on links validate
forces/force_model.py, with which they share no formula.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..reduction.tree.loop_constraints import GAUGE_RATE
from ..system.loops.kinematics import loop_jacobian, loop_jacobian_rate
from ..system.system import System

if TYPE_CHECKING:
    pass


class LoadsByPinocchio:
    """The generalised forces of wrenches on the links of one system."""

    def __init__(
        self, system: System, axes: Array, places: Sequence[tuple[str | None, str]]
    ) -> None:
        """Find the frames of the links.

        Args:
            system: The system.
            axes: Motion axes of the root joint in its fixed frame, (6, r).
            places: For each wrench, the name of the link (None for the base) and the frame of its
                components ("world" or "body").
        """
        self._model, self._data = system.sorted_model, system.sorted_model.createData()
        self._axes, self._places = axes, tuple(places)
        self._to_world = system.model.jointPlacements[1].rotation
        self._frames = [None if link is None else self._frame(link) for link, _ in places]

    def _frame(self, link: str) -> int:
        """Return the index of the body with this name, or else of the frame with this name."""
        model = self._model
        if model.existBodyName(link):
            return int(model.getBodyId(link))
        return int(model.getFrameId(link))

    def generalised(self, q: Array, loads: Array) -> Array:
        """Compute the generalised forces of wrenches.

        Args:
            q: Pinocchio's configuration, (nq,).
            loads: Force, moment and point of each wrench, (9, L) [N, N·m, m].
        Returns:
            (nv,): the generalised forces.
        """
        model, data = self._model, self._data
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        tau = np.zeros(model.nv)
        reference = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        for (_, axes), frame, load in zip(self._places, self._frames, loads.T, strict=True):
            force, moment, point = load[:3], load[3:6], load[6:]
            if frame is None:  # along the group's axes in the root joint's fixed frame
                force, moment = np.split(self._axes @ load[: self._axes.shape[1]], 2)
                to_world, arm = self._to_world, np.zeros(3)
                jacobian = pin.getJointJacobian(model, data, 1, reference)
            else:
                orientation = data.oMf[frame].rotation
                to_world = self._to_world if axes == "world" else orientation
                arm = orientation @ point
                jacobian = pin.getFrameJacobian(model, data, frame, reference)
            F = to_world @ force
            tau += jacobian.T @ np.concatenate([F, to_world @ moment + pin.skew(arm) @ F])
        return tau


def with_closed_loops(
    system: System,
    x: Array,
    H: Array,
    v: Array,
    rng: np.random.Generator,
    prescribed: Sequence[int] = (),
) -> tuple[Array, Array, Array]:
    """Project v on velocities that keep loops closed, with the same body momentum.

    Rates of prescribed joints do not change.

    Returns:
        The velocity (n,), the impetus (m,) for random multipliers, and the multipliers (k,).
    """
    r = system.r
    if system.closure is None:
        return v, H[r:] @ v, np.empty(0)
    J = np.zeros((system.closure.rank, len(v)))
    J[:, r:] = loop_jacobian(system, x)[system.closure.rows]
    free = np.setdiff1d(np.arange(len(v)), r + np.array(prescribed, dtype=int))
    response = np.linalg.solve(H[np.ix_(free, free)], J[:, free].T)
    # Multipliers of this size have impulses of the size of the momenta, in every unit.
    mobility = J[:, free] @ response
    nu: Array = np.asarray(np.linalg.solve(mobility, J @ v))
    v = v.copy()
    v[free] -= response @ nu
    v[free] -= response @ np.linalg.solve(mobility, J @ v)  # Round-off moves light links.
    nu = nu * rng.uniform(0.5, 2.0, len(nu))
    return v, (H @ v + J.T @ nu)[r:], nu


def impetus_terms(system: System, x: Array, xdot: Array, nu: Array) -> Array:
    """Return ṗ less the rates of the canonical momenta and less Jᵀν̇, (m,); see LoopTerms."""
    if system.closure is None:
        return np.zeros(system.m)
    rows = system.closure.rows
    rate = loop_jacobian_rate(system, x, xdot)[rows]
    return np.asarray((rate - GAUGE_RATE * loop_jacobian(system, x)[rows]).T @ nu)


def closed_solver(
    system: System, x: Array, xdot: Array, inertia: Array, prescribed: Sequence[int], a: Array
) -> Callable[[Array], Array]:
    """Return the map from generalised forces to accelerations that keep loops closed.

    Args:
        system: The system.
        x: Shape, (nx,).
        xdot: Shape rate, (m,).
        inertia: Mass matrix without the rows and columns of prescribed joints.
        prescribed: Indices of the prescribed joints.
        a: Accelerations of the prescribed joints.
    """
    if system.closure is None:
        return lambda force: np.asarray(np.linalg.solve(inertia, force))
    r, rows = system.r, system.closure.rows
    on_shape = loop_jacobian(system, x)[rows]
    bias = loop_jacobian_rate(system, x, xdot)[rows] @ xdot + on_shape[:, list(prescribed)] @ a
    J = np.zeros((len(rows), len(inertia)))
    J[:, r:] = np.delete(on_shape, list(prescribed), axis=1)
    response = np.linalg.solve(inertia, J.T)

    def solve(force: Array) -> Array:
        free = np.linalg.solve(inertia, force)
        return np.asarray(free - response @ np.linalg.solve(J @ response, J @ free + bias))

    return solve
