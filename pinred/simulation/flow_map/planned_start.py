"""Prescribed joints at the start of a flow, as functions of the force parameters."""

from __future__ import annotations

import casadi as ca
import numpy as np

from ...common.arrays import Array
from ...common.memo import once
from ...forces.force_model import ForceModel
from ...system.system import System


class PlannedStart:
    """Positions and rates of prescribed joints at time zero.

    Attributes:
        joints: Indices of the rates of the prescribed joints.
    """

    def __init__(self, system: System, model: ForceModel | None) -> None:
        """Differentiate the motions of the prescribed joints; there may be none."""
        self._system, self._model = system, model
        self.joints: tuple[int, ...] = () if model is None else model.joints
        self._coordinates = list(system.space.coordinates_of_joints(list(self.joints)))

    def put(self, x: Array, xdot: Array, numbers: Array) -> None:
        """Write the planned values into a shape (nx,) and its rates (m,), for numbers (p,)."""
        if self._model is not None and self.joints:
            planned = self._model.prescribed(0.0, numbers)
            x[self._coordinates], xdot[list(self.joints)] = planned.x, planned.xdot

    def slopes(self, x: Array, numbers: Array) -> tuple[Array, Array]:
        """Return the derivatives of displacements and of rates by the numbers, (m, p) each.

        Args:
            x: Shape with the planned values, (nx,).
            numbers: Force parameters, (p,).
        """
        model, m = self._model, self._system.m
        displacements, rates = np.zeros((2, m, len(numbers)))
        if model is None or not self.joints:
            return displacements, rates

        def make() -> ca.Function:
            p = ca.SX.sym("p", len(numbers))
            position, rate, _ = model.prescribed_function(0.0, p)
            slopes = [ca.densify(ca.jacobian(value, p)) for value in (position, rate)]
            return ca.Function("planned_slopes", [p], slopes)

        by_position, by_rate = (np.array(a) for a in once(model, PlannedStart, make)(numbers))
        joints = list(self.joints)
        E = self._system.space.rate_map(x)[np.ix_(self._coordinates, joints)]
        displacements[joints], rates[joints] = np.linalg.pinv(E) @ by_position, by_rate
        return displacements, rates
