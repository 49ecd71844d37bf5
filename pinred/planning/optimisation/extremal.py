"""The extremal near an optimised gait: Wong's equations and their boundary value problem.

A path of least length for its displacement obeys ∇_ẋ ẋ = M⁻¹⟨μ, B(·, ẋ)⟩ with the curvature B and
the charge μ, the body momentum that the displacement costs.  Its spatial components J = Ad*_{g⁻¹} μ
are constant.  With the canonical momentum p = M u + Aᵀμ, u = ẋ, the equations need no curvature:

    ẋ = u = M⁻¹(p − Aᵀμ),   ṗ = ½ uᵀ∂M u + ⟨μ, ∂A u⟩,   ġ = −g A u,   μ = Ad_gᵀ J.

The speed |u|_M is constant.  Batches of motions are integrated together, with common steps.

The loop is divided into segments of equal length (multiple shooting), because over a whole loop
Wong's equations amplify errors by some 1e4.  The unknowns are shape, canonical momentum and body
charge at the start of each segment, and the multipliers of the displacement.  The segments must
join, shape and momentum must return, and the charge at the end must be a combination of the
gradients of the displacement (transversality).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial

from ...analysis.connections.connection import Connection
from ...analysis.phases.gait import Arc, Gait, PolynomialArc
from ...analysis.phases.lift import phase_slopes
from ...analysis.phases.phase import phase
from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays
from ...common.errors import InputError, IntegrationError, NoOptimum, SingularInertiaError
from ...lie.group import Group
from .gait_search import Task, merit_name
from .limits import active_limits, margins
from .objective import AxisAim, TargetAim

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


SEGMENTS = 16  # number of segments of the loop
_STEP = 1e-5  # step of the central differences, relative to the scale of the unknowns
_RELATIVE, _ABSOLUTE = 1e-13, 1e-14  # tolerances of the integrator
_SAMPLES = 256  # number of samples of the initial loop
_ROUND_OFF = 1e-15  # harmonics below this part of the largest one are omitted


@dataclass(frozen=True, eq=False)
class Motions:
    """N states of Wong's equations.

    Attributes:
        x: Shapes, (N, m).
        p: Canonical momenta p = M u + Aᵀμ, (N, m).
        pose: Poses of the base, (N, size).
        charge: Spatial charges J, (N, r).
    """

    x: Array
    p: Array
    pose: Array
    charge: Array


@dataclass(frozen=True, eq=False)
class WongEquations:
    """Wong's equations of a connection with a metric.

    Attributes:
        connection: The connection.
    """

    connection: Connection

    def body_charges(self, pose: Array, charge: Array) -> Array:
        """Return the body charges μ = Ad_gᵀ J, (N, r), for poses (N, size) and J (N, r)."""
        Ad = self.connection.group.Ad(pose)
        return np.asarray(np.einsum("nab,na->nb", Ad, charge))

    def rates(self, motions: Motions) -> tuple[Array, Array, Array]:
        """Compute the rates of states.

        Args:
            motions: The states.
        Returns:
            ẋ = u (N, m), ṗ (N, m) and ġ (N, size).
        """
        connection = self.connection
        r, m = connection.r, connection.m
        mu = self.body_charges(motions.pose, motions.charge)
        A, M, _ = connection.locals_at(motions.x)
        right = motions.p - np.einsum("nra,nr->na", A, mu)
        u = np.asarray(np.linalg.solve(np.asarray(M), right[..., None])[..., 0])
        slopes = connection.horizontal_slopes(motions.x, u)[:, :, :m]
        force = 0.5 * slopes[:, r] - np.einsum("nr,nra->na", mu, slopes[:, :r])
        twist = -np.einsum("nra,na->nr", A, u)
        return u, force, connection.group.rate(motions.pose, twist)

    def momenta(self, x: Array, u: Array, pose: Array, charge: Array) -> Array:
        """Return the canonical momenta p = M u + Aᵀμ, (N, m), of shape rates u (N, m)."""
        A, M, _ = self.connection.locals_at(x)
        mu = self.body_charges(pose, charge)
        return np.asarray(
            np.einsum("nab,nb->na", np.asarray(M), u) + np.einsum("nra,nr->na", A, mu)
        )

    def flow(self, start: Motions, duration: float) -> Motions:
        """Integrate a batch of motions with DOP853.

        Args:
            start: Initial states.
            duration: Duration.
        Returns:
            The final states.
        Raises:
            IntegrationError: The integration failed, or a motion meets a singular shape.
        """
        from scipy.integrate import solve_ivp

        m, count = self.connection.m, len(start.x)

        def states(y: Array) -> Motions:
            rows = y.reshape(count, -1)
            return Motions(rows[:, :m], rows[:, m : 2 * m], rows[:, 2 * m :], start.charge)

        def rate(_: float, y: Array) -> Array:
            return np.hstack(self.rates(states(y))).ravel()

        y = np.hstack([start.x, start.p, start.pose]).ravel()
        try:
            run = solve_ivp(
                rate, (0.0, duration), y, method="DOP853", rtol=_RELATIVE, atol=_ABSOLUTE,
                first_step=min(duration, 0.01),
            )  # fmt: skip
        except (SingularInertiaError, FloatingPointError, np.linalg.LinAlgError) as error:
            raise IntegrationError(f"an extremal meets a singular shape: {error}") from error
        if not run.success:
            raise IntegrationError(f"Wong's equations could not be integrated: {run.message}")
        end = states(run.y[:, -1])
        return Motions(end.x, end.p, self.connection.group.normalize(end.pose), end.charge)


@dataclass(frozen=True, eq=False)
class Displacement:
    """The gradients of the displacement at a pose, with respect to g⁻¹δg.

    Attributes:
        value: Rotation or displacement along the axis [rad | m]; 0 for a target.
        gradient: Gradient of the value, (1, r); (0, r) for a target.
        errors: Constraint values, (k,).
        normals: Gradients of the constraints, (k, r).
    """

    value: float
    gradient: Array
    errors: Array
    normals: Array

    @classmethod
    def of(cls, aim: AxisAim | TargetAim, pose: Array) -> Displacement:
        """Return the displacement of an objective at a pose, (size,)."""
        if isinstance(aim, TargetAim):
            return cls(0.0, np.zeros((0, aim.group.dim)), *aim.error(pose))
        value, gradient = aim.value(pose)
        return cls(value, gradient[None], *aim.constraint(pose))

    @property
    def allowed(self) -> Array:
        """Basis of the body charges that the displacement allows at the end of a loop."""
        return np.vstack([self.gradient, self.normals])


@dataclass(frozen=True, eq=False)
class ExtremalProblem:
    """The boundary value problem of a task.

    The unknowns are z = (states, multipliers), (n,).  The multipliers are that of the value, which
    a target has not, and those of the constraints.

    Attributes:
        task: The task, with cost "length".
    """

    task: Task

    @cached_property
    def equations(self) -> WongEquations:
        """Wong's equations of the connection."""
        return WongEquations(self.task.connection)

    @property
    def group(self) -> Group:
        """The symmetry group."""
        return self.task.connection.group

    @property
    def width(self) -> int:
        """Number of entries 2m + r of a state (x, p, μ)."""
        return 2 * self.task.connection.m + self.group.dim

    def split(self, z: Array) -> tuple[Array, Array]:
        """Return the states at the starts of the segments, (segments, 2m + r), and multipliers."""
        size = SEGMENTS * self.width
        return z[:size].reshape(SEGMENTS, -1), z[size:]

    def motions(self, states: Array) -> Motions:
        """Return Wong's motions from states (N, 2m + r), with the base at the identity."""
        m = self.task.connection.m
        poses = np.tile(self.group.identity(), (len(states), 1))
        return Motions(states[:, :m], states[:, m : 2 * m], poses, states[:, 2 * m :])

    def lengths(self, states: Array) -> Array:
        """Return the speeds of states, (N,): the length of a loop in unit time."""
        start = self.motions(states)
        u, *_ = self.equations.rates(start)
        return np.sqrt(self.task.connection.horizontal(start.x, u)[1])

    def advance(self, states: Array, duration: float) -> tuple[Array, Array]:
        """Integrate states (N, 2m + r); return the final states, and the poses, (N, size)."""
        end = self.equations.flow(self.motions(states), duration)
        mu = self.equations.body_charges(end.pose, end.charge)
        return np.hstack([end.x, end.p, mu]), end.pose

    def pose(self, poses: Array) -> Array:
        """Return the pose after all segments, (size,), from the pose of each, (segments, size)."""
        before, last = self._before(poses), poses[-1]
        return self.group.compose(before[-1], last)

    def residuals(self, z: Array) -> Array:
        """Evaluate the equations in their own units.

        Args:
            z: Unknowns, (n,).
        Returns:
            (n,): jumps between the segments, returns of shape and momentum, transversality of the
            charge, deviations of the displacement, and the equation of the scale.
        Raises:
            IntegrationError: A segment meets a singular shape, or cannot be integrated.
        """
        states, multipliers = self.split(z)
        ends, poses = self.advance(states, 1.0 / SEGMENTS)
        jumps = (ends - np.roll(states, -1, axis=0)).ravel()[: -self.group.dim]
        mu, pose = ends[-1:, -self.group.dim :], self.pose(poses)[None]
        last = self._terminal(mu, pose, multipliers[None], self.lengths(states[:1]))
        return np.concatenate([jumps, last[0]])

    def jacobian(self, z: Array, scale: Array) -> Array:
        """Compute the derivatives of the equations by central differences of each segment.

        Args:
            z: Unknowns, (n,).
            scale: Scale of the unknowns, (n,).
        Returns:
            (n, n).
        """
        states, multipliers = self.split(z)
        width, r = self.width, self.group.dim
        steps = _STEP * scale[:width]
        signs = np.array([0.0, 1.0, -1.0])
        shifted = states + np.einsum("s,jw->sjw", signs, np.diag(steps))[:, :, None]
        ends, poses = self.advance(shifted.reshape(-1, width), 1.0 / SEGMENTS)
        ends, poses = ends.reshape(shifted.shape), poses.reshape(*shifted.shape[:3], -1)
        jacobian = np.zeros((len(z), len(z)))
        rates = (ends[1] - ends[2]) / (2.0 * steps[:, None, None])  # (width, segments, width)
        for k in range(SEGMENTS):
            block, joined = slice(k * width, (k + 1) * width), (k + 1) % SEGMENTS * width
            jacobian[block, block] += rates[:, k].T
            jacobian[block, joined : joined + width] -= np.eye(width)
        tail = slice(SEGMENTS * width - r, None)
        jacobian[tail] = 0.0
        # The end depends on the pose of each segment, on the last charge and on the first speed.
        mu = np.tile(ends[0, 0, -1, -r:], (*shifted.shape[:3], 1))
        mu[:, :, -1] = ends[:, :, -1, -r:]
        lengths = np.full(shifted.shape[:3], self.lengths(states[:1])[0])
        lengths[:, :, 0] = self.lengths(shifted[:, :, 0].reshape(-1, width)).reshape(3, width)
        end_poses = self._around(poses[0, 0], poses).reshape(-1, self.group.size)
        many = np.tile(multipliers, (len(end_poses), 1))
        last = self._terminal(mu.reshape(-1, r), end_poses, many, lengths.ravel())
        last = last.reshape(*shifted.shape[:3], -1)
        by_states = (last[1] - last[2]) / (2.0 * steps[:, None, None])
        jacobian[tail, : SEGMENTS * width] = by_states.transpose(2, 1, 0).reshape(last.shape[3], -1)
        units = np.vstack([np.zeros(len(multipliers)), np.eye(len(multipliers))])
        moved_multipliers = multipliers + scale[SEGMENTS * width :] * units
        count = len(units)
        lasts = self._terminal(
            np.tile(mu[0, 0, -1], (count, 1)), np.tile(end_poses[0], (count, 1)),
            moved_multipliers, np.full(count, lengths[0, 0, 0]),
        )  # fmt: skip
        jacobian[tail, SEGMENTS * width :] = (
            (lasts[1:] - lasts[0]) / scale[SEGMENTS * width :, None]
        ).T
        return jacobian

    def _terminal(self, mu: Array, poses: Array, multipliers: Array, lengths: Array) -> Array:
        """Return transversality, deviations and the equation of the scale, (N, r + multipliers)."""
        rows = []
        for charge, pose, factors, length in zip(mu, poses, multipliers, lengths, strict=True):
            displacement = Displacement.of(self.task.aim, pose)
            blocks = [charge - factors @ displacement.allowed, displacement.errors]
            if len(displacement.gradient):
                most = self.task.most
                merit = factors[0] * displacement.value
                scale = merit - length**2 if most is None else length - most
                blocks.append(np.array([scale]))
            rows.append(np.concatenate(blocks))
        return np.array(rows)

    def _before(self, poses: Array) -> Array:
        """Return the pose before each segment, (segments, size)."""
        before = [self.group.identity()]
        for pose in poses[:-1]:
            before.append(self.group.normalize(self.group.compose(before[-1], pose)))
        return np.array(before)

    def _around(self, poses: Array, replaced: Array) -> Array:
        """Return the final poses if the pose of one segment is replaced, (..., segments, size)."""
        before, inverse = self._before(poses), self.group.inverse
        last = self.group.compose(before[-1], poses[-1])
        through = self.group.compose(before, poses)
        after = self.group.compose(inverse(through), np.tile(last, (SEGMENTS, 1)))
        shape = replaced.shape
        before, after = (np.broadcast_to(value, shape) for value in (before, after))
        return self.group.compose(self.group.compose(before, replaced), after)


class Start(NamedTuple):
    """An initial point of the iteration.

    Attributes:
        z: Unknowns, (n,).
        scale: Scale of the unknowns, (n,).
        units: Scale of the residuals, (n,).
    """

    z: Array
    scale: Array
    units: Array


def start_of(problem: ExtremalProblem, gait: Gait) -> Start:
    """Return initial unknowns of an extremal.

    The multipliers balance the gradients of length and displacement in the coefficients.

    Args:
        problem: The boundary value problem.
        gait: A Fourier gait near the extremal.
    Returns:
        The unknowns with their scales.
    """
    connection, group = problem.task.connection, problem.group
    slopes = phase_slopes(connection, gait)
    displacement, L = Displacement.of(problem.task.aim, slopes.pose), slopes.length
    allowed = displacement.allowed
    by_c = np.tensordot(allowed, slopes.twist, 1).reshape(len(allowed), -1)
    multipliers = L * np.linalg.lstsq(by_c.T, slopes.length_slope.ravel(), rcond=None)[0]
    J = group.spatial_momentum(slopes.pose, multipliers @ allowed)
    even = at_constant_speed(problem, gait)
    nodes = np.arange(SEGMENTS) / SEGMENTS
    x, u = even.at(nodes)
    sampled = phase(connection, even)
    poses = sampled.path[np.abs(sampled.times - nodes[:, None]).argmin(axis=1)]
    mu = np.einsum("nab,a->nb", group.Ad(poses), J)
    base = np.tile(group.identity(), (SEGMENTS, 1))
    p = problem.equations.momenta(x, u, base, mu)
    z = np.concatenate([np.hstack([x, p, mu]).ravel(), multipliers])
    return Start(z, *_scales(problem, even, L, displacement))


def at_constant_speed(problem: ExtremalProblem, gait: Gait) -> Gait:
    """Return the gait with constant speed in the metric and period 1, by interpolation."""
    t = np.arange(4 * _SAMPLES + 1) * (gait.period / (4 * _SAMPLES))
    speed = np.sqrt(problem.task.connection.horizontal(*gait.at(t))[1])
    travelled = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))])
    even = np.arange(_SAMPLES) * (travelled[-1] / _SAMPLES)
    return interpolated(gait.at(np.interp(even, travelled, t))[0], 1.0)


def interpolated(x: Array, period: float) -> Gait:
    """Return the Fourier gait through samples (N, m) at equidistant times from 0."""
    count = len(x)
    modes = np.fft.rfft(x, axis=0)[: (count + 1) // 2] / count
    sizes = np.abs(modes[1:]).max(axis=1)
    modes = modes[: 2 + int(np.flatnonzero(sizes > _ROUND_OFF * sizes.max())[-1])]
    return Gait.fourier(modes[0].real, 2.0 * modes[1:].real, -2.0 * modes[1:].imag, period=period)


def _scales(
    problem: ExtremalProblem, gait: Gait, length: float, moved: Displacement
) -> tuple[Array, Array]:
    """Return scales of unknowns and residuals, so that products have the unit of an action."""
    group, action = problem.group, length**2
    x, xdot = gait.samples(_SAMPLES)
    size = 0.5 * np.ptp(x, axis=0)
    size = np.maximum(size, 1e-3 * size.max())
    twists = np.abs(problem.task.connection.horizontal(x, xdot)[0]).mean(axis=0)
    travel = np.maximum(twists, 1e-3 * twists.max())
    k = group.linear
    paths = [travel[k:].max(initial=0.0), travel[:k].max(initial=0.0)]
    errors = np.array([paths[j >= group.turns] for j in range(len(moved.errors))])
    value = len(moved.gradient)
    states = np.tile(np.concatenate([size, action / size, action / travel]), SEGMENTS)
    scale = action if problem.task.most is None else length
    multipliers = np.full(value, action / abs(moved.value)) if value else np.zeros(0)
    return (
        np.concatenate([states, multipliers, action / errors]),
        np.concatenate([states, errors, np.full(value, scale)]),
    )
