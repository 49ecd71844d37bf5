"""A tri-axial free body with a spherical rotor, integrated with 30 digits by Taylor series.

With the angular momentum L about the centre of mass and the rotor's ℓ = R π, both in the axes of
the body, the motion needs no attitude:

    L̇ = L × ω,   ℓ̇ = s × ℓ,   ω = J⁻¹ (L − κ ℓ),   s = (ℓ − i ω)/(i + a),   κ = i/(i + a)

for the rotor's moment of inertia i, its armature a and J = I + μ (d² 1 − d dᵀ) + i (1 − κ), with
the reduced mass μ of both bodies and the distance d from the body's centre of mass to the rotor.
The attitudes follow from q̇ = ½ q ∘ ω and q̇_R = ½ s ∘ q_R.  Nothing here comes from pinred.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal, localcontext
from typing import Any

import numpy as np
import pinocchio as pin
from taylor_series import DIGITS, ORDER, Series, cross, decimals, dot, half_product, sum_at


@dataclass(frozen=True)
class Gyrostat:
    """A body with a spherical rotor.

    Attributes:
        moments: Principal moments of the body about its centre of mass, (3,) [kg m²].
        masses: Masses of body and rotor [kg].
        distance: Position of the rotor relative to the centre of mass of the body, (3,) [m].
        rotor: Moment of inertia of the rotor [kg m²].
        armature: Armature of the ball [kg m²].
    """

    moments: tuple[float, float, float] = (0.4, 0.5, 0.7)
    masses: tuple[float, float] = (2.0, 1.0)
    distance: tuple[float, float, float] = (0.1, -0.2, 0.3)
    rotor: float = 0.2
    armature: float = 0.0

    def model(self) -> pin.Model:
        """Return Pinocchio's model, with a free root and the ball "rotor"."""
        model = pin.Model()
        model.name = "gyrostat"
        model.gravity.setZero()
        root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
        body = pin.Inertia(self.masses[0], np.zeros(3), np.diag(self.moments))
        model.appendBodyToJoint(root, body, pin.SE3.Identity())
        place = pin.SE3(np.eye(3), np.array(self.distance))
        ball = model.addJoint(root, pin.JointModelSpherical(), place, "rotor")
        sphere = pin.Inertia(self.masses[1], np.zeros(3), self.rotor * np.eye(3))
        model.appendBodyToJoint(ball, sphere, pin.SE3.Identity())
        model.armature = np.append(np.zeros(6), np.full(3, self.armature))
        return model

    def integrate(
        self, omega: Any, attitude: Any, rates: Any, duration: float, steps: int
    ) -> dict[str, np.ndarray]:
        """Integrate from an upright body.

        Args:
            omega: Initial angular velocity of the body in its axes, (3,) [rad/s].
            attitude: Initial quaternion of the rotor relative to the body, (4,).
            rates: Initial rates of the ball in the axes of the body, (3,) [rad/s].
            duration: Duration [s].
            steps: Number of steps.
        Returns:
            At the end: "omega" (3,), "attitude" of the body (4,), "rotor", its quaternion relative
            to the body (4,), and "rates" in the axes of the body (3,).
        """
        with localcontext() as context:
            context.prec = DIGITS
            i, a = Decimal(self.rotor), Decimal(self.armature)
            inverse = _inverse(self._inertia())
            w, s = decimals(omega), decimals(rates)
            ell = [i * (p + r) + a * r for p, r in zip(w, s, strict=True)]
            J = self._inertia()
            L = [dot(row, w) + i / (i + a) * e for row, e in zip(J, ell, strict=True)]
            unit = decimals(attitude)
            length = dot(unit, unit).sqrt()
            state = [*L, *ell, *decimals([0, 0, 0, 1]), *(c / length for c in unit)]
            for _ in range(steps):
                state = self._step(state, inverse, Decimal(duration) / steps)
            w, s = self._velocities(state[:3], state[3:6], inverse)
            columns = {"omega": w, "attitude": state[6:10], "rotor": state[10:], "rates": s}
            return {name: np.array(column, dtype=float) for name, column in columns.items()}

    def _inertia(self) -> list[list[Decimal]]:
        i, a = Decimal(self.rotor), Decimal(self.armature)
        m, n = decimals(self.masses)
        d, moments = decimals(self.distance), decimals(self.moments)
        reduced, own = m * n / (m + n), i * a / (i + a)
        return [
            [
                (moments[j] + own + reduced * dot(d, d)) * (j == k) - reduced * d[j] * d[k]
                for k in range(3)
            ]
            for j in range(3)
        ]

    def _velocities(
        self, L: list[Decimal], ell: list[Decimal], inverse: list[list[Decimal]]
    ) -> tuple[list[Decimal], list[Decimal]]:
        i, a = Decimal(self.rotor), Decimal(self.armature)
        rest = [p - i / (i + a) * e for p, e in zip(L, ell, strict=True)]
        w = [dot(row, rest) for row in inverse]
        return w, [(e - i * c) / (i + a) for e, c in zip(ell, w, strict=True)]

    def _step(
        self, state: list[Decimal], inverse: list[list[Decimal]], h: Decimal
    ) -> list[Decimal]:
        """Return the state after a step of the Taylor series."""
        y: Series = [[c] for c in state]
        w: Series = [[] for _ in range(3)]
        s: Series = [[] for _ in range(3)]
        for n in range(ORDER):
            now = [c[n] for c in y[:6]]
            for series, values in zip(
                (w, s), self._velocities(now[:3], now[3:], inverse), strict=True
            ):
                for column, value in zip(series, values, strict=True):
                    column.append(value)
            rates = [
                *cross(y[:3], w, n), *cross(s, y[3:6], n),
                *half_product(y[6:10], w, n, after=True),
                *half_product(y[10:], s, n, after=False),
            ]  # fmt: skip
            for column, rate in zip(y, rates, strict=True):
                column.append(rate / (n + 1))
        return sum_at(y, h)


def _inverse(A: list[list[Decimal]]) -> list[list[Decimal]]:
    rows = [[*row, *(Decimal(int(j == k)) for k in range(3))] for j, row in enumerate(A)]
    for k in range(3):
        rows[k] = [c / rows[k][k] for c in rows[k]]
        for j in range(3):
            if j != k:
                rows[j] = [p - rows[j][k] * q for p, q in zip(rows[j], rows[k], strict=True)]
    return [row[3:] for row in rows]
