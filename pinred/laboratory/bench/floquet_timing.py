"""Floquet multipliers of relative equilibria, computed in three ways and compared with e^{λT}.

A relative equilibrium is periodic with any period T. Its multipliers follow from the eigenvalues λ
of the linearised flow. The routes are `pinred.floquet`, which integrates the linearised flow in
machine code; finite differences of `pinred.simulate`; and SciPy's DOP853 over the same rates and
Jacobian, called from Python.
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
from ...analysis.stability.linearised_flow import without_base
from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays
from ...common.waiting import Progress, one_by_one
from ...kernels.state_jacobian import jacobian_of
from ...reduction.pointwise_reduction import PointwiseReduction
from ...scene.scene import Scene
from ...simulation.compiled.compiled_flow import CompiledFlow
from ...simulation.plan import plan_of
from ...simulation.simulate import simulate
from ...system.load import load
from .timing import Tables, alternating, repeated

# Robots with one rotation axis, and their angular momentum J [N·m·s].
PROBLEMS = {"double_spherical_pendulum": 2.0, "planar_chain5": 1.0}
ROUTES = ("pinred.floquet", "differences of pinred.simulate", "SciPy's DOP853 over the kernel")
_ROUNDS = 5
_STEP = 1e-4  # step of the finite differences of shape [rad] and momentum [kg m²/s]


@checks_arguments
@dataclass(frozen=True)
class FloquetTiming(FrozenArrays):
    """Times and errors of the three routes for one relative equilibrium; arrays are read-only.

    Attributes:
        robot: Name of the robot.
        period: Period T [s].
        wall: Median wall time of each of ROUTES, (3,) [s].
        error: Largest error of multipliers relative to the largest |μ|, (3,).
    """

    robot: str
    period: float
    wall: Array
    error: Array

    def tables(self) -> Tables:
        """Return a row of the csv file for each route."""
        rows: list[dict[str, object]] = [
            {"robot": self.robot, "route": name, "wall": wall, "error": error}
            for name, wall, error in zip(ROUTES, self.wall, self.error, strict=True)
        ]
        return {"floquet": rows}

    def __str__(self) -> str:
        rows = [
            f"  {name:<32} {1e3 * wall:9.2f} ms   error {error:.1e}"
            for name, wall, error in zip(ROUTES, self.wall, self.error, strict=True)
        ]
        return "\n".join([f"{self.robot}: multipliers over {self.period:.3f} s", *rows])


@checks_arguments
def bench_floquet(
    *, rounds: int = _ROUNDS, progress: Progress | bool | None = None
) -> list[FloquetTiming]:
    """Time the routes on the lowest-energy relative equilibrium of each robot in PROBLEMS.

    Args:
        rounds: Number of rounds, of which the median is reported.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        One result for each robot.
    """
    measure = partial(_measure, rounds=rounds)
    return one_by_one(list(PROBLEMS), measure, progress, "floquet")


def _measure(name: str, rounds: int) -> FloquetTiming:
    least = relative_equilibria(load(name), momentum=PROBLEMS[name], starts=50)[0]
    T = 2.0 * np.pi / float(least.frequencies[0])
    traj = simulate(least.scene(duration=T))
    values = linearise(traj).eigenvalues
    exact = _sort_by_angle(np.exp(values * T))
    routes: list[Callable[[], Array]] = [
        lambda: floquet(traj).monodromy,
        lambda: _differences(least, T),
        lambda: _by_scipy(traj.scene, T),
    ]
    computed = [_sort_by_angle(np.linalg.eigvals(route()).astype(complex)) for route in routes]
    error = [float(np.abs(mu - exact).max() / np.abs(exact).max()) for mu in computed]
    wall = np.median(alternating([repeated(route) for route in routes], rounds=rounds), axis=0)
    return FloquetTiming(name, T, np.asarray(wall), np.array(error))


def _sort_by_angle(values: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return multipliers sorted by their rounded angle, so that round-off keeps the order."""
    values = np.asarray(values, dtype=complex)
    return values[np.argsort(np.round(np.angle(values), 5), kind="stable")]


def _differences(least: RelativeEquilibrium, T: float) -> Array:
    """Compute the monodromy matrix, (2m, 2m), from central differences of simulations."""
    system, red = least.system, PointwiseReduction(least.system)
    r, m = system.r, system.m
    start = red.mass_matrix(least.x) @ np.concatenate([least.xi, least.xdot])
    scene = least.scene(duration=T)
    mu = np.zeros(r)  # with zero linear momentum, the angular momentum is the same about any point
    mu[-1] = least.momentum

    def final_state(change: Array) -> Array:
        x, pi = least.x + change[:m], start[r:] + change[m:]
        v = np.linalg.solve(red.mass_matrix(x), np.concatenate([mu, pi]))
        end = simulate(replace(scene, x0=x, xdot0=v[r:], xi0=v[:r], times=[T], duration=None))
        velocity = np.concatenate([end.xi[-1], end.xdot[-1]])
        return np.concatenate([end.x[-1], (red.mass_matrix(end.x[-1]) @ velocity)[r:]])

    columns = [(final_state(h) - final_state(-h)) / (2.0 * _STEP) for h in _STEP * np.eye(2 * m)]
    return np.array(columns).T


def _by_scipy(scene: Scene, T: float) -> Array:
    """Compute the monodromy matrix, (k, k), with SciPy's DOP853 applied to kernel and Jacobian."""
    flow = CompiledFlow.of_plan(plan_of(without_base(scene)))
    n = len(flow.y0)

    def rate(_t: float, z: Array) -> Array:
        y, Y = z[:n], z[n:].reshape(n, n)
        J = jacobian_of(flow.kernel, y, flow.parameters)
        return np.concatenate([flow.kernel.evaluate_rate(y, flow.parameters), (J @ Y).ravel()])

    z0 = np.concatenate([flow.y0, np.eye(n).ravel()])
    solution = solve_ivp(rate, (0.0, T), z0, method="DOP853", rtol=1e-11, atol=1e-13)
    return np.asarray(solution.y[n:, -1].reshape(n, n), dtype=float)
