"""Best Fourier loops by SLSQP or Ipopt over samples, independent of pinred's optimiser.

The connection gives twists ξ = −A ẋ and squared speeds ẋᵀMẋ at samples.  All else is computed here
by other means: means over equidistant samples in place of Gauss nodes, quaternions of a Magnus
expansion, torques by spectral derivatives of momenta, and all gradients by central differences.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import minimize, minimize_scalar

import pinred
from pinred.common.arrays import Array

COUNT = 128  # samples of a loop
_FINE = 8192  # samples at which limits are refined
_ROUNDS = 12  # largest number of solves with refined limits
_TURN = 0.05  # typical phase of loops with limits 1 [rad | m]
_NEW = 1e-8  # relative gain of a better loop
_SPREAD = 0.3  # size of the random coefficients, relative to the limits
_BEYOND = 2e-7  # relative violation of limits between samples of an accepted loop
_STEP = 1e-5  # step of central differences
_POWERS = {"length": 1, "torque": 2, "acceleration": 2, "power": 4, "time": 1}


@dataclass(frozen=True)
class Reference:
    """A gait problem with joints in [−limit, limit].

    Attributes:
        connection: The connection.
        options: Options of `optimise_gait`, of which limits and harmonics are required.
    """

    connection: pinred.Connection
    options: dict[str, Any]

    @property
    def m(self) -> int:
        """Number of joints."""
        return self.connection.m

    @property
    def harmonics(self) -> int:
        """Number of harmonics."""
        return int(self.options["harmonics"])

    def rows(self, s: Array, order: int = 0) -> Array:
        """Return a derivative of 1, cos 2πks, sin 2πks at times s, (N, K)."""
        k = 2.0 * np.pi * np.arange(1, self.harmonics + 1)
        quarter = 0.5 * np.pi * order
        angle = np.multiply.outer(s, k) + quarter
        constant = np.full((len(s), 1), float(order == 0))
        return np.hstack([constant, k**order * np.cos(angle), k**order * np.sin(angle)])

    def effect(self, c: Array, count: int = COUNT) -> tuple[Array, Array]:
        """Return the poses, (B, size), and the costs, (B,), of loops (B, K, m) for period 1."""
        s = np.arange(count) / count
        x, v = self.rows(s) @ c, self.rows(s, 1) @ c  # (B, N, m)
        twist, square = self.horizontal(x, v)
        pose = self.transport(twist)
        cost = self.options.get("cost", "length")
        if cost == "time":
            return pose, np.ones(len(c))
        if cost == "length":
            return pose, np.sqrt(square).mean(axis=1)
        p = self.momenta(x, v)
        if self.connection.form.momentum:
            frequency = 2j * np.pi * np.fft.fftfreq(count, 1.0 / count)
            rate = np.fft.ifft(frequency[:, None] * np.fft.fft(p, axis=1), axis=1).real
            force = np.empty_like(p)
            for j, e in enumerate(_STEP * np.eye(self.m)):
                ahead, behind = self.horizontal(x + e, v)[1], self.horizontal(x - e, v)[1]
                force[..., j] = 0.25 * (ahead - behind) / _STEP
            tau = rate - force
        else:
            tau = p
        if cost == "power":
            return pose, ((tau * v) ** 2).sum(axis=2).mean(axis=1)
        if cost == "torque":
            return pose, (tau**2).sum(axis=2).mean(axis=1)
        M = np.stack(
            [self.momenta(x, np.broadcast_to(e, x.shape)) for e in np.eye(self.m)], axis=-1
        )
        return pose, (tau * np.linalg.solve(M, tau[..., None])[..., 0]).sum(axis=2).mean(axis=1)

    def horizontal(self, x: Array, v: Array) -> tuple[Array, Array]:
        """Return twists (B, N, r) and squared speeds (B, N)."""
        shapes = (
            x.reshape(-1, self.m),
            np.ascontiguousarray(np.broadcast_to(v, x.shape)).reshape(-1, self.m),
        )
        twist, square = self.connection.horizontal(*shapes)
        return (
            np.asarray(twist).reshape(*x.shape[:2], -1),
            np.asarray(square).reshape(x.shape[:2]),
        )

    def momenta(self, x: Array, v: Array) -> Array:
        """Return M v, (B, N, m), by polarisation of the squared speed."""
        columns = [
            0.25 * (self.horizontal(x, v + e)[1] - self.horizontal(x, v - e)[1])
            for e in np.eye(self.m)
        ]
        return np.stack(columns, axis=-1)

    def transport(self, twist: Array) -> Array:
        """Return the poses after one period, (B, size), from twists (B, N, r)."""
        N = twist.shape[1]
        if self.connection.group.turns == 1:
            w = twist[..., 2]
            mean = w.mean(axis=1, keepdims=True)
            k = np.fft.fftfreq(N, 1.0 / N)
            k[0] = 1.0
            waves = np.fft.fft(w - mean, axis=1) / (2j * np.pi * k)
            angle = np.fft.ifft(waves, axis=1).real
            angle = angle - angle[:, :1] + mean * np.arange(N) / N
            z = (twist[..., 0] + 1j * twist[..., 1]) * np.exp(1j * angle)
            end = z.mean(axis=1)
            return np.stack([end.real, end.imag, mean[:, 0]], axis=1)
        w, h = twist[..., 3:], 2.0 / N
        first, middle, last = w[:, ::2], w[:, 1::2], np.roll(w, -2, axis=1)[:, ::2]
        turns = h / 6.0 * (first + 4.0 * middle + last) - h**2 / 12.0 * np.cross(last, first)
        size = np.linalg.norm(turns, axis=2, keepdims=True)
        q = np.concatenate(
            [np.cos(0.5 * size), 0.5 * np.sinc(size / (2.0 * np.pi)) * turns], axis=2
        )
        while q.shape[1] > 1:  # multiply neighbours; the count is a power of two
            a, b = q[:, ::2], q[:, 1::2]
            scalar = a[..., :1] * b[..., :1] - (a[..., 1:] * b[..., 1:]).sum(axis=2, keepdims=True)
            vector = (
                a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + np.cross(a[..., 1:], b[..., 1:])
            )
            q = np.concatenate([scalar, vector], axis=2)
        q = q[:, 0] * np.where(q[:, 0, :1] < 0.0, -1.0, 1.0)
        sine = np.linalg.norm(q[:, 1:], axis=1, keepdims=True)
        factors = 2.0 * np.arctan2(sine, q[:, :1]) / np.maximum(sine, 1e-300)
        return np.asarray(factors * q[:, 1:])

    def numbers(self, z: Array, count: int = COUNT) -> Array:
        """Return the objective to minimise and the equations, (B, 1 + k), for unknowns (B, n)."""
        options, c = self.options, z[:, : self.size].reshape(len(z), -1, self.m)
        pose, cost = self.effect(c, count)
        kind = options.get("cost", "length")
        root = z[:, -1] if kind == "time" else cost ** (1.0 / _POWERS[kind])
        target, objective = options.get("target"), options.get("objective", "rotation")
        planar = self.connection.group.turns == 1
        turn = pose[:, 2:] if planar else pose
        if target is not None:
            cost = z[:, -1] if kind == "time" else cost
            return np.hstack([cost[:, None], turn - np.atleast_1d(target)])
        if objective == "displacement":
            return np.hstack([-(pose[:, :1] / root[:, None]), turn])
        axis = 0 if planar else "xyz".index(options["axis"])
        return -(turn[:, axis] / root)[:, None]

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return (1 + 2 * self.harmonics) * self.m

    def merit(self, gait: pinred.Gait, count: int = 4096) -> float:
        """Return the merit of a gait at `count` samples."""
        z = np.append(gait.series.coefficients(self.harmonics).ravel(), gait.period)
        return -float(self.numbers(z[None, : self.size + self.free], count)[0, 0])

    @property
    def free(self) -> int:
        """Number of unknowns besides the coefficients: the period, if it is the cost."""
        return int(self.options.get("cost") == "time")

    def limits(self, s: Array) -> tuple[Array, Array]:
        """Return G and d of the limits G z ≤ d at times s."""
        limit = self.options["limits"]
        values = np.kron(self.rows(s), np.eye(self.m))
        G = np.hstack([values, np.zeros((len(values), self.free))])
        blocks, d = [G, -G], [np.full(2 * len(G), limit)]
        if self.free:
            slopes = np.kron(self.rows(s, 1), np.eye(self.m))
            period = np.full((len(slopes), 1), -self.options["speeds"])
            blocks += [np.hstack([slopes, period]), np.hstack([-slopes, period])]
            d.append(np.zeros(2 * len(slopes)))
        return np.vstack(blocks), np.concatenate(d)

    def best_of(
        self, starts: int, seed: int = 0, near: pinred.Gait | None = None
    ) -> tuple[float, Array]:
        """Return the largest merit reached from random loops, and its unknowns.

        A loop whose merit with limits at samples is not above the best one is not refined.

        Args:
            starts: Number of starts.
            seed: Seed of the random numbers.
            near: A gait; if given, half of the starts are random changes of it by a tenth.
        """
        best = (-np.inf, np.zeros(0))
        for k in range(starts):
            rng, z = np.random.default_rng([seed, k]), None
            if near is not None and k % 2:
                c = near.series.coefficients(self.harmonics)
                c = c + 0.1 * np.abs(c).max() * rng.uniform(-1.0, 1.0, c.shape)
                z = np.append(c.ravel(), np.full(self.free, near.period))
            found = self.optimum(rng, above=best[0], z=z)
            best = max(best, found, key=lambda pair: pair[0])
        return best

    def optimum(
        self, rng: np.random.Generator, above: float = -np.inf, z: Array | None = None
    ) -> tuple[float, Array]:
        """Return merit and unknowns of a local optimum near z; −∞ if none was found."""
        z = self.random(rng) if z is None else z
        count = 16 * (self.harmonics + 1)
        times, fine, fixed = (
            np.arange(count) / count,
            np.arange(_FINE) / _FINE,
            np.zeros((0, len(z))),
        )
        near = np.multiply.outer([-1.0, 1.0], 4.0 ** np.arange(5)).ravel() / _FINE
        G, d = self.limits(fine)
        for _ in range(_ROUNDS):
            z = self.solve(z, *self.limits(times), fixed)
            if not -self.numbers(z[None], 4096)[0, 0] > (
                above + _NEW * abs(above) if np.isfinite(above) else above
            ):
                return -np.inf, z
            beyond = G @ z - d
            if not beyond.max() > _BEYOND * self.options["limits"]:
                break
            beyond = beyond.reshape(-1, _FINE, self.m)
            top = (
                (beyond >= np.roll(beyond, 1, 1))
                & (beyond >= np.roll(beyond, -1, 1))
                & (beyond > 0.0)
            )
            peaks = fine[top.any(axis=(0, 2))]
            times = np.union1d(times, np.add.outer(peaks, np.append(near, 0.0)).ravel() % 1.0)
            if self.m > 2:
                z = self.shifted(z, self.best_shift(z))
            fixed = self.shifted(z, 0.25, derivative=True)[None]
        return self.checked(z, beyond.max() / self.options["limits"])

    def random(self, rng: np.random.Generator) -> Array:
        """Return the unknowns of a random loop, traversed in the direction of the objective."""
        limit, planar = self.options["limits"], self.m == 2
        decay = np.concatenate([[0.3], *[1.0 / np.arange(1.0, self.harmonics + 1) ** 2] * 2])
        c = _SPREAD * limit * decay[:, None] * rng.uniform(-1.0, 1.0, (len(decay), self.m))
        if planar:
            c[1], c[1 + self.harmonics] = 0.6 * limit * np.eye(2)
        z, target = np.append(c.ravel(), np.ones(self.free)), self.options.get("target")
        numbers = self.numbers(z[None])[0]
        backwards = numbers[0] > 0.0
        if target is not None:
            backwards = float((numbers[1:] + target) @ np.atleast_1d(target)) < 0.0
        if backwards:
            c[1 + self.harmonics :] *= -1.0
        return np.append(c.ravel(), np.full(self.free, 10.0))

    def shifted(self, z: Array, shift: float, *, derivative: bool = False) -> Array:
        """Return the unknowns of the loop x(s + shift), or their derivative at shift 0."""
        c = z[: self.size].reshape(-1, self.m)
        k = 2.0 * np.pi * np.arange(1, self.harmonics + 1)[:, None]
        cos, sin = np.split(c[1:], 2)
        if derivative:
            moved = np.vstack([0.0 * c[:1], k * sin, -k * cos])
            return np.append(moved.ravel(), np.zeros(self.free))
        C, S = np.cos(k * shift), np.sin(k * shift)
        return np.append(
            np.vstack([c[:1], C * cos + S * sin, C * sin - S * cos]).ravel(), z[self.size :]
        )

    def best_shift(self, z: Array) -> float:
        """Return the shift of a loop along itself with the largest merit."""

        def loss(shift: float) -> float:
            return float(self.numbers(self.shifted(z, shift)[None])[0, 0])

        return float(minimize_scalar(loss, (-1e-3, 1e-3), tol=1e-10).x)

    def checked(self, z: Array, beyond: float) -> tuple[float, Array]:
        """Return merit and unknowns of a loop that obeys all constraints; −∞ for others."""
        values = self.numbers(z[None], 4096)[0]
        if (
            beyond > _BEYOND
            or np.abs(values[1:]).max(initial=0.0) > 1e-7
            or not np.isfinite(values).all()
        ):
            return -np.inf, z
        if self.m == 2:
            x = self.rows(np.arange(1025) / 1024) @ z[: self.size].reshape(-1, 2)
            x = x - x[:-1].mean(axis=0)
            if (
                round(abs(np.ptp(np.unwrap(np.arctan2(x[:, 1], x[:, 0]))[[0, -1]])) / (2.0 * np.pi))
                != 1
            ):
                return -np.inf, z
        return -float(values[0]), z

    def solve(self, z: Array, G: Array, d: Array, fixed: Array) -> Array:
        """Return a minimum within limits G z ≤ d near z, with constant products of z and rows."""
        steps = _STEP * np.eye(len(z))
        size = abs(float(self.numbers(z[None])[0, 0])) or 1.0
        units = np.append(size, np.full(9, _TURN * self.options["limits"] ** 3))

        targeted = self.options.get("target") is not None

        def scaled(z: Array) -> Array:
            """Return numbers of order 1; costs may differ by powers of ten, hence their log."""
            found = self.numbers(z)
            found = found / units[: found.shape[1]]
            if targeted:
                found[:, 0] = np.log(np.maximum(found[:, 0], 1e-30))
            return np.asarray(found)

        def values(z: Array) -> Array:
            return np.asarray(scaled(z[None])[0])

        def slopes(z: Array) -> Array:
            found = scaled(np.vstack([z + steps, z - steps]))
            return np.asarray((found[: len(z)] - found[len(z) :]).T / (2.0 * _STEP))

        start = z
        constraints: list[dict[str, Any]] = [
            {"type": "ineq", "fun": lambda z: d - G @ z, "jac": lambda _: -G}
        ]
        if len(fixed):
            constraints.append(
                {"type": "eq", "fun": lambda z: fixed @ (z - start), "jac": lambda _: fixed}
            )
        if len(values(z)) > 1:
            constraints.append(
                {"type": "eq", "fun": lambda z: values(z)[1:], "jac": lambda z: slopes(z)[1:]}
            )
        if targeted:  # SLSQP makes no progress along curved equations
            return _by_ipopt(values, slopes, z, (G, d, fixed))
        run = minimize(
            lambda z: values(z)[0], z, jac=lambda z: slopes(z)[0], method="SLSQP",
            constraints=constraints, options={"maxiter": 300, "ftol": 1e-12},
        )  # fmt: skip
        return np.asarray(run.x)


class _Rates(ca.Callback):
    """The derivatives, (k, n), of a function of z, (n,); the second input is its value."""

    def __init__(self, rates: Callable[[Array], Array], shape: tuple[int, int]) -> None:
        ca.Callback.__init__(self)
        self.rates, self.shape = rates, shape
        self.construct("rates", {})

    def get_n_in(self) -> int:
        return 2

    def get_sparsity_in(self, index: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self.shape[1 - index], 1)

    def get_sparsity_out(self, _: int) -> ca.Sparsity:
        return ca.Sparsity.dense(*self.shape)

    def eval(self, arguments: Sequence[ca.DM]) -> Sequence[ca.DM]:
        return [ca.DM(self.rates(np.array(arguments[0]).ravel()))]


class _Values(ca.Callback):
    """A function of z, (n,), with k values."""

    def __init__(self, values: Callable[[Array], Array], rates: _Rates) -> None:
        ca.Callback.__init__(self)
        self.values, self.rates = values, rates
        self.construct("values", {})

    def get_sparsity_in(self, _: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self.rates.shape[1], 1)

    def get_sparsity_out(self, _: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self.rates.shape[0], 1)

    def eval(self, arguments: Sequence[ca.DM]) -> Sequence[ca.DM]:
        return [ca.DM(self.values(np.array(arguments[0]).ravel()))]

    def has_jacobian(self) -> bool:
        return True

    def get_jacobian(self, *_: Any) -> ca.Function:
        return self.rates


def _by_ipopt(
    values: Callable[[Array], Array],
    slopes: Callable[[Array], Array],
    z: Array,
    linear: tuple[Array, Array, Array],
) -> Array:
    """Return a minimum near z of values[0] with values[1:] = 0.

    Args:
        values: Objective and equations, (k,).
        slopes: Their derivatives, (k, n).
        z: Initial point, (n,).
        linear: G, d and F of the linear constraints G z ≤ d and F z = constant.
    Returns:
        The last point, (n,).
    """
    G, d, fixed = linear
    x, shape = ca.MX.sym("x", len(z)), slopes(z).shape
    f = _Values(values, _Rates(slopes, shape))
    value, rows = f(x), np.vstack([fixed, G])
    options: Any = {
        "hessian_approximation": "limited-memory", "limited_memory_max_history": 30,
        "mu_strategy": "adaptive", "tol": 1e-8, "constr_viol_tol": 1e-9, "max_iter": 300,
        "bound_relax_factor": 0.0, "print_level": 0, "sb": "yes",
    }  # fmt: skip
    program: Any = {"x": x, "f": value[0], "g": ca.vertcat(value[1:], ca.DM(rows) @ x)}
    solve = ca.nlpsol("solve", "ipopt", program, {"ipopt": options, "print_time": False})
    equal = np.concatenate([np.zeros(shape[0] - 1), fixed @ z])
    run = solve(x0=z, lbg=np.append(equal, np.full(len(d), -np.inf)), ubg=np.append(equal, d))
    return np.asarray(run["x"], dtype=float).ravel()
