"""Reaction-free paths: joint motions along which a free base does not turn, or does not move.

At zero momentum ξ = −A ẋ, so the base keeps its attitude where the angular rows N of A satisfy
N ẋ = 0. The path is the straightest curve with unit speed in this distribution:

    dx/ds = u,    du/ds = −N⁺ (dN/ds) u.

It has |u| = 1 and N u = 0 exactly, and for a single free direction it is the only path. It turns
sharply where N is almost singular, so its parameter λ slows down there: ds/dλ = 1/|N⁺|. The
solution of DOP853 is replaced by a Chebyshev series in λ that satisfies N dx/dλ = 0 to round-off,
because the base turns by the error of this product. Source: D. Nenchev, Y. Umetani, K. Yoshida,
"Analysis of a redundant free-flying spacecraft/manipulator system", IEEE Trans. Robotics and
Automation 8 (1992).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, FrozenArrays, as_floats, positive, read_only
from ..common.errors import InputError
from ..forces.signals.signal import Fourier
from ..system.system import System

_SINGULAR = 1e-3  # singular value, in units of the largest one at x0, below which a path ends
_ROUND_OFF = 1e-13  # rotation of the base that counts as round-off, per unit of length and of N
_DEGREES = (12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512)  # degrees that are tried
_SWEEPS = 12  # largest number of projections of the series onto N u = 0
_RTOL, _ATOL = 1e-12, 1e-13  # tolerances of DOP853; the series corrects its solution


@checks_arguments
@dataclass(frozen=True, eq=False)
class ReactionFreePath(FrozenArrays):
    """A path of joint shapes along which a free base does not turn, or does not move.

    Attributes:
        system: The robot.
        length: Length of the path in joint space [rad | m].
        stop: Where the path ends: "length", "singularity", or "limit of" and a joint.
        reaction: Bound on the rotation (or motion) of the base along the path [rad | m].
        coefficients: Chebyshev coefficients of the shape in 2·fraction − 1, (K, m).
    """

    system: System = field(repr=False)
    length: float
    stop: str
    reaction: float
    coefficients: Array = field(repr=False)

    def at(self, fraction: ArrayLike) -> tuple[Array, Array]:
        """Evaluate the path.

        Args:
            fraction: Parameter of the path from 0 to 1, (...,). It grows slowly in sharp turns.
        Returns:
            Shapes, (..., m) [rad | m], and their derivatives with respect to it, (..., m).
        Raises:
            InputError: A fraction is outside the path.
        """
        values = as_floats(fraction, "fraction")
        if not ((values >= 0.0) & (values <= 1.0)).all():
            raise InputError(f"fraction: expected numbers from 0 to 1, got {values}")
        series = self.coefficients, 2.0 * chebyshev.chebder(self.coefficients)
        x, slopes = (
            read_only(np.moveaxis(np.asarray(chebyshev.chebval(2.0 * values - 1.0, c)), 0, -1))
            for c in series
        )
        return x, slopes

    def prescribed(self, duration: float) -> dict[str, Fourier]:
        """Return the motion along the path as signals for `prescribed` of a Scene.

        The motion is at rest at time 0 and at the end: fraction = (1 − cos πt/duration)/2.
        Afterwards it returns along the path.

        Args:
            duration: Time from the start of the path to its end [s].
        Returns:
            A Fourier series per joint.
        """
        period = 2.0 * positive(duration, "duration")
        # The argument of the series is z = −cos θ, and T_k(−cos θ) = (−1)^k cos kθ.
        cosines = self.coefficients * (-1.0) ** np.arange(len(self.coefficients))[:, None]
        columns = zip(self.system.shape_names, cosines.T, strict=True)
        return {name: Fourier(float(c[0]), c[1:], [], period) for name, c in columns}


def integrate_path(
    system: System,
    rows: Callable[[Array], Array],
    rates: Callable[[Array, Array], Array],
    start: Array,
    direction: Array | None,
    length: float,
    limits: Array,
) -> ReactionFreePath:
    """Integrate a reaction-free path.

    Args:
        system: The robot, without balls.
        rows: Function that returns the rows N(x) of the connection, (k, m).
        rates: Function that returns their rate at a shape and a shape rate, (k, m).
        start: First shape, (m,).
        direction: Joint rates near the first direction, (m,); None for a single free direction.
        length: Largest length of the path.
        limits: Lower and upper limits of the joints, (m, 2).
    Returns:
        The path.
    Raises:
        InputError: No direction is free, x0 is singular or outside the limits, or no series of
            the allowed degrees is accurate.
    """
    if not ((start > limits[:, 0]) & (start < limits[:, 1])).all():
        k = int(np.argmin(np.minimum(start - limits[:, 0], limits[:, 1] - start)))
        low, high = limits[k]
        raise InputError(
            f"x0: joint '{system.shape_names[k]}' must lie between {low:g} and {high:g}, got "
            f"{start[k]:g}"
        )
    space = _Distribution(rows, rates, start)
    u = space.first_direction(direction)
    rates_at, end, arc, stop = space.solve(u, length, limits, system.shape_names)
    coefficients, reaction = space.fit(rates_at, end)
    return ReactionFreePath(system, arc, stop, reaction, coefficients)


class _Distribution:
    """The joint rates u with N(x) u = 0, at constant rank of N.

    Attributes:
        start: First shape, (m,).
        rank: Rank of N at the first shape.
        scale: Largest singular value of N at the first shape.
    """

    def __init__(
        self,
        rows: Callable[[Array], Array],
        rates: Callable[[Array, Array], Array],
        start: Array,
    ) -> None:
        """Compute the rank at the first shape.  Raises InputError if it is singular."""
        self._rows, self._rates, self.start = rows, rates, start
        values = np.linalg.svd(rows(start), compute_uv=False)
        self.scale = float(values[0]) if values.size else 0.0
        self.rank = int((values > 1e-10 * max(self.scale, 1e-300)).sum())
        if self.rank and values[self.rank - 1] < _SINGULAR * self.scale:
            raise InputError("x0 is a singular shape; start at another one")

    def first_direction(self, direction: Array | None) -> Array:
        """Return the unit rates in the null space next to a direction, (m,)."""
        free = self._inverse(self.start)[2]
        count = free.shape[1]
        if not count:
            raise InputError(
                f"no joint motion is free of reactions: {len(self.start)} joints have {self.rank} "
                "conditions. Use of='attitude' or more joints"
            )
        if direction is None:
            if count > 1:
                raise InputError(
                    f"direction: {count} directions are free of reactions at x0; state joint rates"
                )
            u = free[:, 0]
            return np.asarray(u * np.sign(u[np.argmax(np.abs(u))]))
        u = free @ (free.T @ direction)
        size = float(np.linalg.norm(u))
        if not size > 1e-8 * np.linalg.norm(direction):
            raise InputError(
                "direction: it has no part that is free of reactions; see FloatingArm.null_space"
            )
        return np.asarray(u / size)

    def solve(
        self, u: Array, length: float, limits: Array, names: tuple[str, ...]
    ) -> tuple[Callable[[Array], Array], float, float, str]:
        """Integrate to the length, a limit or a singularity.

        Args:
            u: First direction, (m,).
            length: Largest length.
            limits: Limits of the joints, (m, 2).
            names: Names of the joints.
        Returns:
            The rates dx/dλ as a function of λ, the last λ, the length, and why the path ends.
        """
        from scipy.integrate import solve_ivp

        m = len(u)

        def slope(_: float, y: Array) -> Array:
            x, u = y[:m], y[m:-1]
            speed, inverse = self._speed(x), self._inverse(x)[1]
            return speed * np.concatenate([u, -inverse @ (self._rates(x, u) @ u), [1.0]])

        def margin(_: float, y: Array) -> float:
            values = self._inverse(y[:m])[0]
            return float(values[self.rank - 1] - _SINGULAR * self.scale) if self.rank else 1.0

        def remaining(_: float, y: Array) -> float:
            return float(length - y[-1])

        def lower(_: float, y: Array) -> float:
            return float((y[:m] - limits[:, 0]).min())

        def upper(_: float, y: Array) -> float:
            return float((limits[:, 1] - y[:m]).min())

        events = (remaining, margin, lower, upper)
        for event in events:
            vars(event)["terminal"] = True
        done = solve_ivp(
            slope, (0.0, np.inf), np.concatenate([self.start, u, [0.0]]), method="DOP853",
            rtol=_RTOL, atol=_ATOL, events=events, dense_output=True,
        )  # fmt: skip
        x, end, stop = done.y[:m, -1], float(done.t[-1]), "length"
        if done.t_events[1].size:
            stop = "singularity"
        elif not done.t_events[0].size:
            near = np.minimum(x - limits[:, 0], limits[:, 1] - x)
            stop = f"limit of {names[int(np.argmin(near))]}"

        def rates(parameters: Array) -> Array:
            states = done.sol(parameters).T
            speeds = np.array([self._speed(state[:m]) for state in states])
            return np.asarray(speeds[:, None] * states[:, m:-1])

        return rates, end, float(done.y[-1, -1]), stop

    def fit(self, solution: Callable[[Array], Array], end: float) -> tuple[Array, float]:
        """Compute the Chebyshev series of the path.

        Args:
            solution: Rates dx/dλ (N, m) at parameters λ (N,).
            end: Last parameter λ.
        Returns:
            Coefficients, (K, m), and the bound on the motion of the base.
        Raises:
            InputError: No degree suffices.
        """
        half, reaction = 0.5 * end, np.inf
        for degree in _DEGREES:
            z = chebyshev.chebpts1(degree + 1)
            slopes, largest = solution(half * (z + 1.0)), np.inf
            for _ in range(_SWEEPS):
                rates = _interpolate(z, slopes)
                coefficients = np.asarray(chebyshev.chebint(rates, scl=half, lbnd=-1), dtype=float)
                coefficients[0] += self.start
                shapes = chebyshev.chebval(z, coefficients).T
                errors = np.array(
                    [self._rows(x) @ u for x, u in zip(shapes, slopes, strict=True)]
                ).reshape(len(z), -1)
                previous, largest = largest, float(np.abs(errors).max(initial=0.0))
                if not largest < 0.5 * previous:
                    break
                inverses = np.array([self._inverse(x)[1] for x in shapes])
                slopes = slopes - np.einsum("smk,sk->sm", inverses, errors)
            # Measure between the nodes, where the series is not projected.
            between = np.linspace(-1.0, 1.0, 4 * degree + 1)
            series = (chebyshev.chebval(between, c).T for c in (coefficients, rates))
            pairs = zip(*series, strict=True)
            reaction = end * float(np.mean([np.linalg.norm(self._rows(x) @ u) for x, u in pairs]))
            if reaction <= _ROUND_OFF * max(1.0, self.scale, end * self.scale):
                return coefficients, reaction
        raise InputError(
            f"length: a series of degree {_DEGREES[-1]} still moves the base by {reaction:.1e}; "
            "state a shorter length"
        )

    def _speed(self, x: Array) -> float:
        """Return ds/dλ, relative to its largest possible value at the first shape."""
        if not self.rank:
            return 1.0
        return float(1.0 / (self.scale * np.linalg.norm(self._inverse(x)[1])))

    def _inverse(self, x: Array) -> tuple[Array, Array, Array]:
        """Return singular values, pseudoinverse (m, k) and null space (m, free) of N(x)."""
        rows = self._rows(x)
        if not rows.size:
            return np.zeros(0), rows.T, np.eye(rows.shape[1])
        left_vectors, values, right = np.linalg.svd(rows)
        k = self.rank
        inverse = (right[:k].T / values[:k]) @ left_vectors[:, :k].T
        return values, inverse, right[k:].T


def _interpolate(z: Array, values: Array) -> Array:
    """Return the Chebyshev coefficients of values at the roots z, (N, m)."""
    basis = chebyshev.chebvander(z, len(z) - 1)
    coefficients = basis.T @ values * (2.0 / len(z))
    coefficients[0] *= 0.5
    return np.asarray(coefficients)
