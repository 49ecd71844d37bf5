"""The extremal near an optimised gait, as a loop with its charge and its residual."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial

from ...analysis.gaits.arcs import Arc, PolynomialArc
from ...analysis.gaits.gait import Gait
from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays
from ...common.errors import InputError, IntegrationError, NoOptimum
from .extremal_problem import (
    SEGMENTS,
    Displacement,
    ExtremalProblem,
    interpolated,
    start_of,
)
from .limits import active_limits, margins
from .objective import TargetAim
from .transcription import Task, merit_name

RESIDUAL = 1e-10  # largest residual of an accepted extremal
_GAIT_ERROR = 1e-12  # error of the interpolation at which sampling ends, relative to the loop
_MOST_SAMPLES = 64  # largest number of samples of a segment
_CORNER = 1e-6  # relative jump of the shape rate at the start above which a loop has a corner
_DEGREE = 16  # degree of the polynomials of a loop with a corner, one for each segment
_WORSE = 1e-7  # relative loss of merit by which an extremal is another one than the optimum
_DAMPING = 1e-4  # initial damping, relative to the largest singular value
_LEAST, _LARGEST = 1e-9, 1e3  # range of the damping


@checks_arguments
@dataclass(frozen=True, eq=False, repr=False)
class Extremal(FrozenArrays):
    """A loop that is stationary among all loops, not only among Fourier series.

    It obeys Wong's equations. An extremal satisfies the first-order conditions of an optimum. That
    does not prove a minimum of length: neither second-order conditions nor other loops are checked.

    Attributes:
        gait: The loop at constant speed in the metric, as a Fourier series; as polynomial arcs if
            it has a corner.
        error: Largest distance of the gait from the extremal, at samples not used by a coarser
            series or by polynomials of half the degree [rad | m].
        corner: Jump of the shape rate at the start, relative to the rate; 0 for a smooth loop. A
            corner is optimal if the displacement depends on where a cycle starts.
        length: Length of the extremal.
        pose: Pose of the base after one cycle, (size,).
        value: Objective of one cycle [rad | m]; for a target, the deviation from the target.
        merit: The maximised quantity; see `Task.merit`.
        charge: Spatial components of the constant charge, (r,): the change of the length per
            displacement δg g⁻¹ of the end, if the loop remains an extremal.
        residual: Norm of the residual of the boundary value problem, relative to the sizes of loop
            and displacement.
        iterations: Number of Levenberg–Marquardt iterations.
        merit_name: Name and unit of the merit.
    """

    gait: Gait
    error: float
    corner: float
    length: float
    pose: Array
    value: float
    merit: float
    charge: Array
    residual: float
    iterations: int
    merit_name: str

    def __repr__(self) -> str:
        return f"<Extremal: merit {self.merit:.12g}, residual {self.residual:.1e}>"

    def __str__(self) -> str:
        return "\n".join(
            [
                "extremal of the isoholonomic problem",
                f"  merit                 {self.merit:.12g}, {self.merit_name}",
                f"  value                 {self.value:.12g}",
                f"  length                {self.length:.12g}",
                f"  charge                {np.array2string(self.charge, precision=6)}",
                f"  residual              {self.residual:.1e}, relative, of Wong's equations",
                f"  error of the gait     {self.error:.1e}",
                f"  corner at the start   {self.corner:.2g}, relative jump of the shape rate",
                "  not proven: that no other loop is better. An extremal satisfies the first-order",
                "  conditions only.",
            ]
        )


def refuse_extremal(task: Task, gait: Gait, cost: float) -> None:
    """Refuse an optimum that is no extremal of the isoholonomic problem.

    Args:
        task: The task.
        gait: Its optimum.
        cost: Cost of the optimum.
    Raises:
        InputError: The cost is not the length, the gait is a polygon, or a limit is active.
    """
    if task.cost != "length":
        raise InputError(
            f"best: expected an optimum with cost 'length', got cost {task.cost!r}; only loops of "
            "extremal length obey Wong's equations"
        )
    if not gait.is_smooth:
        raise InputError(
            "best: expected a Fourier gait, got a polygon. Optimise without vertices=."
        )
    if task.most is not None and cost < task.most * (1.0 - 1e-6):
        raise InputError(
            f"best: expected a length at its bound {task.most:g}, got {cost:g}. Pass a smaller "
            "most=, or none."
        )
    active = active_limits(task.limits, margins(task.connection, gait, task.limits))
    if active:
        raise InputError(
            f"best: expected an optimum within its limits, got one at its {', '.join(active)}; "
            "limits bend a loop away from Wong's equations. Widen them."
        )


def polish(task: Task, gait: Gait, merit: float) -> Extremal:
    """Compute the extremal near an optimum.

    Args:
        task: The task, with cost "length".
        gait: Its optimum, a Fourier gait within its limits.
        merit: Merit of the optimum.
    Returns:
        The extremal.
    Raises:
        NoOptimum: The iteration found no extremal, or none within the limits that is as good.
    """
    problem = ExtremalProblem(task)
    start = start_of(problem, gait)
    root = levenberg_marquardt(
        lambda z: problem.residuals(z * start.scale) / start.units,
        lambda z: (
            problem.jacobian(z * start.scale, start.scale) * (start.scale / start.units[:, None])
        ),
        start.z / start.scale,
        tolerance=RESIDUAL,
    )
    if not root.residual <= RESIDUAL:
        raise NoOptimum(
            f"no extremal was found near the optimum: residual {root.residual:.1e} after "
            f"{root.iterations} iterations. Increase the harmonics of the optimum; a loop with a "
            "corner at its start needs many"
        )
    z = root.z * start.scale
    result = _extremal(problem, z, gait.period, root.residual, root.iterations)
    if not result.merit >= merit - _WORSE * abs(merit):
        raise NoOptimum(
            f"the extremal near the optimum has merit {result.merit:.9g}, below {merit:.9g}; "
            "increase the harmonics of the optimum"
        )
    if min(margins(task.connection, result.gait, task.limits).values()) < 0.0:
        raise NoOptimum("the extremal near the optimum exceeds the limits; widen them")
    return result


def _extremal(
    problem: ExtremalProblem, z: Array, period: float, residual: float, iterations: int
) -> Extremal:
    """Create the result from unknowns z."""
    task, (states, _) = problem.task, problem.split(z)
    _, poses = problem.advance(states, 1.0 / SEGMENTS)
    pose, length = problem.pose(poses), float(problem.lengths(states[:1])[0])
    displacement = Displacement.of(task.aim, pose)
    deviation = float(np.linalg.norm(displacement.errors))
    value = deviation if isinstance(task.aim, TargetAim) else displacement.value
    corner = _corner(problem, states)
    gait, error = (_with_corner if corner else _smooth)(problem, states, period)
    charge = states[0, -problem.group.dim :] / length
    return Extremal(
        gait=gait, error=error, corner=corner, length=length, pose=pose, value=value,
        merit=task.merit(value, length), charge=charge, residual=residual, iterations=iterations,
        merit_name="{} [{}]".format(*merit_name(task)),
    )  # fmt: skip


def _corner(problem: ExtremalProblem, states: Array) -> float:
    """Return the relative jump of the shape rate at the start; 0 for a smooth loop."""
    ends, _ = problem.advance(states, 1.0 / SEGMENTS)
    both = problem.motions(np.stack([states[0], ends[-1]]))
    first, last = problem.equations.rates(both)[0]
    jump = float(np.abs(last - first).max() / np.abs(first).max())
    return jump if jump > _CORNER else 0.0


def _with_corner(problem: ExtremalProblem, states: Array, period: float) -> tuple[Gait, float]:
    """Return the loop as polynomial arcs, one for each segment, and its error."""
    s = 0.5 * (1.0 - np.cos(np.pi * np.arange(_DEGREE + 1) / _DEGREE))
    m, shapes = problem.task.connection.m, [states[:, : problem.task.connection.m]]
    for step in np.diff(s):
        states, _ = problem.advance(states, step / SEGMENTS)
        shapes.append(states[:, :m])
    arcs: list[Arc] = []
    error = 0.0
    for x in np.stack(shapes, axis=1):  # (degree + 1, m) of each segment
        coarse = _through(s[::2], x[::2], period)
        error = max(error, float(np.abs(coarse.at(s[1::2])[0] - x[1::2]).max()))
        arcs.append(_through(s, x, period))
    return Gait(tuple(arcs)), error


def _through(s: Array, x: Array, period: float) -> PolynomialArc:
    """Return the polynomial through shapes (N, m) at parameters s (N,), for one segment."""
    columns = [Chebyshev.fit(s, column, len(s) - 1, domain=[0.0, 1.0]) for column in x.T]
    powers = np.zeros((len(s), x.shape[1]))
    for k, column in enumerate(columns):
        coefficients = column.convert(kind=Polynomial).coef
        powers[: len(coefficients), k] = coefficients
    return PolynomialArc(period / SEGMENTS, powers)


def _smooth(problem: ExtremalProblem, states: Array, period: float) -> tuple[Gait, float]:
    """Return the loop as a Fourier gait, and its error."""
    count, m = 8, problem.task.connection.m
    while True:
        x = _samples(problem, states, 2 * count)
        coarse = interpolated(x[::2], period)
        odd = (np.arange(len(x) // 2) + 0.5) * (2.0 * period / len(x))
        error = float(np.abs(coarse.at(odd)[0] - x[1::2]).max())
        if error <= _GAIT_ERROR * float(np.ptp(x, axis=0).max()) or 2 * count >= _MOST_SAMPLES:
            return interpolated(x[:, :m], period), error
        count *= 2


def _samples(problem: ExtremalProblem, states: Array, count: int) -> Array:
    """Return the shapes of a loop at `count` equidistant times per segment, (N, m)."""
    m, shapes = problem.task.connection.m, []
    for _ in range(count):
        shapes.append(states[:, :m])
        states, _ = problem.advance(states, 1.0 / (SEGMENTS * count))
    return np.stack(shapes, axis=1).reshape(-1, m)


@dataclass(frozen=True, eq=False)
class Root:
    """The end of an iteration.

    Attributes:
        z: Unknowns, (n,).
        residual: Norm of the residual.
        iterations: Number of iterations.
    """

    z: Array
    residual: float
    iterations: int


def levenberg_marquardt(
    residuals: Callable[[Array], Array],
    jacobian: Callable[[Array], Array],
    start: Array,
    *,
    tolerance: float,
    most: int = 30,
) -> Root:
    """Solve R(z) = 0 near an initial point.

    Steps have least norm, so that directions along which R is constant remain at rest.

    Args:
        residuals: The function R: (n,) → (k,), which may raise IntegrationError.
        jacobian: Its derivatives, (n,) → (k, n).
        start: Initial point, (n,).
        tolerance: Norm of the residual of a solution, which is refined while steps succeed at once.
        most: Maximum number of iterations.
    Returns:
        The last point; check its residual.
    """
    z, damping, value = start, _DAMPING, residuals(start)
    for done in range(most):
        size = float(np.linalg.norm(value))
        U, s, V = np.linalg.svd(jacobian(z), full_matrices=False)
        components = U.T @ value
        trial, trial_value = z, value
        while damping <= _LARGEST:
            trial = z - V.T @ (s / (s**2 + (damping * s[0]) ** 2) * components)
            trial_value = _value(residuals, trial)
            if float(np.linalg.norm(trial_value)) < size or size <= tolerance:
                break
            damping *= 10.0
        if not float(np.linalg.norm(trial_value)) < size:
            return Root(z, size, done)
        z, value, damping = trial, trial_value, max(0.1 * damping, _LEAST)
    return Root(z, float(np.linalg.norm(value)), most)


def _value(residuals: Callable[[Array], Array], z: Array) -> Array:
    """Return the residual, or infinity where it is not defined."""
    try:
        return residuals(z)
    except IntegrationError:
        return np.array([np.inf])
