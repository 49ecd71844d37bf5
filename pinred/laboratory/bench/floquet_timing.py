"""Floquet multipliers of steady motions by three routes, against their closed form e^{λT}.

A relative equilibrium is periodic with any period, and its multipliers are known from the
eigenvalues λ of its linearised flow.  The routes: `pinred.floquet`, whose linearised flow is
integrated along with the motion in machine code; differences of `pinred.simulate`; and SciPy's
DOP853 over the same rates and Jacobian, called from Python.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from ...analysis.equilibria.find import relative_equilibria
from ...analysis.equilibria.relative_equilibrium import RelativeEquilibrium
from ...analysis.stability.along_motions import floquet, linearise
from ...analysis.stability.variational import without_base
from ...common.arrays import Array, freeze
from ...common.progress import Progress, one_by_one
from ...kernels.tangent import jacobian_of
from ...reduction.at_a_shape import Reduction
from ...scene.scene import Scene
from ...simulation.compiled.compiled_flow import CompiledFlow
from ...simulation.plan import plan_of
from ...simulation.simulate import simulate
from ...system.load import load
from .timing import alternating, repeated

PROBLEMS = {"double_spherical_pendulum": 2.0, "planar_chain5": 1.0}  # robots with one axis: J
ROUTES = ("pinred.floquet", "differences of pinred.simulate", "SciPy's DOP853 over the kernel")
_ROUNDS = 5
_STEP = 1e-4  # rad and its momentum, of the differences


@dataclass(frozen=True)
class FloquetTiming:
    """Routes to the multipliers of one steady motion; arrays are read-only.

    period: [s].  wall: (3,) medians [s], error: (3,) largest of |μ|, relative, as ROUTES.
    """

    robot: str
    period: float
    wall: Array
    error: Array

    def __post_init__(self) -> None:
        freeze(self)

    def __str__(self) -> str:
        rows = [
            f"  {name:<32} {1e3 * wall:9.2f} ms   error {error:.1e}"
            for name, wall, error in zip(ROUTES, self.wall, self.error, strict=True)
        ]
        return "\n".join([f"{self.robot}: multipliers over {self.period:.3f} s", *rows])


def bench_floquet(
    *, rounds: int = _ROUNDS, progress: Progress | bool | None = None
) -> list[FloquetTiming]:
    """Measure the routes on the least steady motion of each robot in PROBLEMS."""
    timing = partial(_timing, rounds=rounds)
    return one_by_one(list(PROBLEMS), timing, progress, "floquet")


def _timing(name: str, rounds: int) -> FloquetTiming:
    least = relative_equilibria(load(name), momentum=PROBLEMS[name], starts=50)[0]
    T = 2.0 * np.pi / float(least.frequencies[0])
    traj = simulate(least.scene(duration=T))
    values = linearise(traj).eigenvalues
    exact = _sorted(np.exp(values * T))
    routes: list[Callable[[], Array]] = [
        lambda: floquet(traj).monodromy,
        lambda: _differences(least, T),
        lambda: _by_scipy(traj.scene, T),
    ]
    found = [_sorted(np.linalg.eigvals(route()).astype(complex)) for route in routes]
    error = [float(np.abs(each - exact).max() / np.abs(exact).max()) for each in found]
    wall = np.median(alternating([repeated(route) for route in routes], rounds=rounds), axis=0)
    return FloquetTiming(name, T, np.asarray(wall), np.array(error))


def _sorted(values: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return multipliers in an order that round-off does not change: by their angle."""
    values = np.asarray(values, dtype=complex)
    return values[np.argsort(np.round(np.angle(values), 5), kind="stable")]


def _differences(least: RelativeEquilibrium, T: float) -> Array:
    """Return the monodromy (2m, 2m) by central differences of simulations."""
    system, red = least.system, Reduction(least.system)
    r, m = system.r, system.m
    start = red.mass_matrix(least.x) @ np.concatenate([least.xi, least.xdot])
    scene = least.scene(duration=T)
    mu = np.zeros(r)  # no linear momentum: the same about every point
    mu[-1] = least.momentum

    def after(change: Array) -> Array:
        x, pi = least.x + change[:m], start[r:] + change[m:]
        v = np.linalg.solve(red.mass_matrix(x), np.concatenate([mu, pi]))
        end = simulate(replace(scene, x0=x, xdot0=v[r:], xi0=v[:r], times=[T], duration=None))
        velocity = np.concatenate([end.xi[-1], end.xdot[-1]])
        return np.concatenate([end.x[-1], (red.mass_matrix(end.x[-1]) @ velocity)[r:]])

    columns = [(after(h) - after(-h)) / (2.0 * _STEP) for h in _STEP * np.eye(2 * m)]
    return np.array(columns).T


def _by_scipy(scene: Scene, T: float) -> Array:
    """Return the monodromy (k, k) by SciPy's DOP853 over the kernel and its Jacobian."""
    flow = CompiledFlow.of_plan(plan_of(without_base(scene)))
    n = len(flow.y0)

    def rate(_t: float, z: Array) -> Array:
        y, Y = z[:n], z[n:].reshape(n, n)
        J = jacobian_of(flow.kernel, y, flow.parameters)
        return np.concatenate([flow.kernel.evaluate_rate(y, flow.parameters), (J @ Y).ravel()])

    z0 = np.concatenate([flow.y0, np.eye(n).ravel()])
    found = solve_ivp(rate, (0.0, T), z0, method="DOP853", rtol=1e-11, atol=1e-13)
    return np.asarray(found.y[n:, -1].reshape(n, n), dtype=float)
