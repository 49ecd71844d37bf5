"""Free-floating arms: kinematics of the hand while the base that carries the arm moves freely.

At zero momentum ξ = −A ẋ, so the twist of a frame is V = J_b ξ + J_s ẋ = J_g ẋ with the generalised
Jacobian J_g = J_s − J_b A. Sources: Y. Umetani, K. Yoshida, "Resolved motion rate control of space
manipulators with generalized Jacobian matrix", IEEE Trans. Robotics and Automation 5 (1989);
E. Papadopoulos, S. Dubowsky, "Dynamic singularities in free-floating space manipulators", J. Dyn.
Sys., Meas., Control 115 (1993); D. Nenchev, Y. Umetani, K. Yoshida, "Analysis of a redundant
free-flying spacecraft/manipulator system", IEEE Trans. Robotics and Automation 8 (1992).

Workspace of a free-floating arm: distances of the hand from the centre of mass.

At zero momentum the centre of mass is at rest, and the distance of the hand from it depends on the
shape alone. A distance is path-dependent if some shape with that distance is dynamically singular:
whether the hand can cross this distance depends on the path that the hand takes. Source: E.
Papadopoulos, S. Dubowsky, "Dynamic singularities in free-floating space manipulators", J. Dyn.
Sys., Meas., Control 115 (1993).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, FrozenArrays, positive, read_only, vector, vectors, whole
from ..common.errors import InputError
from ..common.names import joint_index, listed, nearest, quoted
from ..system.passive import limits_of
from ..system.system import System, checked_system
from .connections.rotation_chart import RotationChart
from .full_reduction import Reduction
from .reaction_free_path import ReactionFreePath, integrate_path

_SHAPES_PER_LINE = 41
_DESCENTS = 6  # number of samples from which each extreme distance is minimised
_GAP = 4.0  # largest gap within one range, in mean distances between samples


@checks_arguments
@dataclass(frozen=True)
class Workspace(FrozenArrays):
    """Distances of the hand from the centre of mass at zero momentum. Arrays are read-only.

    Attributes:
        reach: Least and greatest distance that the hand reaches, (2,) [m].
        dependent: Path-dependent ranges, (K, 2) [m], which contain singular shapes.
        independent: Path-independent ranges, (L, 2) [m].
    """

    reach: Array
    dependent: Array
    independent: Array


def workspace_of(
    radius: Callable[[Array], Array],
    slope: Callable[[Array], Array],
    determinants: Callable[[Array], Array],
    bounds: Array,
    samples: int,
    seed: int,
) -> Workspace:
    """Compute the workspace within joint limits.

    Args:
        radius: Distances (N,) [m] at shapes (N, m).
        slope: Derivative (m,) of the distance at a shape (m,).
        determinants: Determinants (N,) at shapes (N, m).
        bounds: Joint limits, (m, 2) [rad | m].
        samples: Grid values of each of one or two joints, or number of lines for more joints.
        seed: Seed of the random lines.
    Returns:
        The workspace.
    """
    from scipy.optimize import minimize

    paths = _grid(bounds, samples) if len(bounds) < 3 else _lines(bounds, samples, seed)
    shapes = paths.reshape(-1, len(bounds))
    r, det = (f(shapes).reshape(paths.shape[:-1]) for f in (radius, determinants))
    cross = np.sign(det[:, :-1]) != np.sign(det[:, 1:])
    det_a, det_b = det[:, :-1][cross], det[:, 1:][cross]
    r_a, r_b = r[:, :-1][cross], r[:, 1:][cross]
    singular = np.sort(r_a + det_a / (det_a - det_b) * (r_b - r_a))

    def extreme(sign: float, starts: Array) -> float:
        """Minimise sign · radius from each of the shapes; return the extreme distance."""
        minima = [
            minimize(
                lambda x: (sign * float(radius(x[None])[0]), sign * slope(x)), start, jac=True,
                method="L-BFGS-B", bounds=bounds,
            ).fun
            for start in starts
        ]  # fmt: skip
        return float(sign * min(minima))

    ordered = shapes[np.argsort(r.ravel())]
    reach = np.array([extreme(1.0, ordered[:_DESCENTS]), extreme(-1.0, ordered[-_DESCENTS:])])
    gap = _GAP * float(np.ptp(reach)) / samples
    dependent = _ranges(singular, gap)
    edges = [reach[0], *dependent.ravel(), reach[1]]
    independent = [
        (det_a, det_b)
        for det_a, det_b in zip(edges[::2], edges[1::2], strict=True)
        if det_b - det_a > gap
    ]
    return Workspace(reach, dependent, np.array(independent).reshape(-1, 2))


def _grid(bounds: Array, samples: int) -> Array:
    """Return the grid lines along every joint as P sampled paths, (P, samples, m)."""
    axes = [np.linspace(low, high, samples) for low, high in bounds]
    shapes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return shapes[None] if len(bounds) == 1 else np.concatenate([shapes, np.swapaxes(shapes, 0, 1)])


def _lines(bounds: Array, samples: int, seed: int) -> Array:
    """Return straight paths between random shapes in the box, (samples, 41, m)."""
    rng = np.random.default_rng(seed)
    low, high = bounds.T
    start, end = low + (high - low) * rng.uniform(size=(2, samples, len(bounds)))
    fraction = np.linspace(0.0, 1.0, _SHAPES_PER_LINE)[:, None]
    return np.asarray(start[:, None] + fraction * (end - start)[:, None])


def _ranges(values: Array, gap: float) -> Array:
    """Split sorted values into ranges, (K, 2), where neighbours differ by more than `gap`."""
    if not len(values):
        return np.zeros((0, 2))
    cuts = np.flatnonzero(np.diff(values) > gap)
    starts, ends = np.append(0, cuts + 1), np.append(cuts, len(values) - 1)
    return np.stack([values[starts], values[ends]], axis=1)


Axes = Literal["local", "world"]
_FRAMES = {"local": pin.LOCAL, "world": pin.LOCAL_WORLD_ALIGNED}
_WITH_LOOPS = (
    "At a closed shape x, the generalised Jacobian of independent joints is that of "
    "system.open_tree() times LoopReduction(system).at(x).G."
)
_NO_REACTION = 1e-10  # singular values of A below this fraction of the largest are zero
_ROOT_SAMPLES = 721  # number of samples of a path that bracket the roots


@checks_arguments
@dataclass(frozen=True)
class Singularity(FrozenArrays):
    """The distance of a free-floating arm from a dynamic singularity at a shape.

    Attributes:
        values: Singular values of the task rows of J_g, (k,), largest first.
        determinant: Determinant of these rows if they are square, else the product of the values.
        lost: Unit twist in the task rows that needs the largest joint rates, (k,).
        joints: Unit joint rates that move the hand least, (m,).
    """

    values: Array
    determinant: float
    lost: Array
    joints: Array

    @property
    def least(self) -> float:
        """The least singular value, which is 0 at a singularity."""
        return float(self.values[-1])

    @property
    def condition(self) -> float:
        """The ratio of the largest to the least singular value."""
        return float(self.values[0] / self.values[-1]) if self.values[-1] > 0.0 else np.inf


@checks_arguments
@dataclass(frozen=True, eq=False)
class FloatingArm:
    """The hand of a robot with a free base.

    Twists of the hand are (6,), [linear; angular]. They use the axes of the hand ("local"), or the
    fixed axes at the origin of the hand ("world").

    Attributes:
        system: The robot.
        frame: Name of the hand, a link or any other frame of the model.
        task: Controlled rows of the twist, as indices 0 to 5. By default all rows of the group if
            the joints can move them, else the translations.
    """

    system: System
    frame: str
    task: tuple[int, ...] = ()
    _reduction: Reduction = field(init=False, repr=False)
    _id: int = field(init=False, repr=False)

    def __post_init__(self) -> None:
        system = checked_system(self.system, "FloatingArm", remedy=_WITH_LOOPS)
        if self.frame not in [frame.name for frame in system.sorted_model.frames]:
            names = [frame.name for frame in system.sorted_model.frames if frame.parentJoint]
            raise InputError(
                f"no frame {quoted(str(self.frame))} on '{system.name}'; "
                f"{nearest(str(self.frame), names)}the frames are {listed(names)}"
            )
        group = system.group
        linear = tuple(axis for axis in group.axes if axis < 3)
        task = tuple(self.task) or (group.axes if system.m >= group.dim or not linear else linear)
        if not set(task) <= set(range(6)) or len(set(task)) != len(task):
            raise InputError(f"task must be distinct rows of a twist, from 0 to 5, got {self.task}")
        object.__setattr__(self, "task", tuple(int(row) for row in task))
        object.__setattr__(self, "_reduction", Reduction(system))
        object.__setattr__(self, "_id", system.model.getFrameId(self.frame))

    def generalized_jacobian(
        self, x: ArrayLike, *, axes: Axes = "local", pose: ArrayLike | None = None
    ) -> Array:
        """Compute the generalised Jacobian J_g = J_s − J_b A.

        Args:
            x: Shape, (nx,) [rad | m | 1].
            axes: "local" or "world".
            pose: Pose of the base; None: the identity. Only world axes depend on it.
        Returns:
            (6, m): twist of the hand per unit joint rate, at zero momentum.
        """
        x, g = self._at(x, pose)
        J = self._jacobian(x, g, axes)
        r = self.system.r
        return read_only(J[:, r:] - J[:, :r] @ self._reduction.local_connection(x))

    def rate(
        self, x: ArrayLike, xdot: ArrayLike, *, axes: Axes = "local", pose: ArrayLike | None = None
    ) -> Array:
        """Compute the rate J̇_g = J̇_s − J̇_b A − J_b Ȧ on the horizontal motion ξ = −A ẋ.

        The rate of the entries of the hand's twist is J_g ẍ + J̇_g ẋ.

        Args:
            x: Shape, (nx,) [rad | m | 1].
            xdot: Shape rate, (m,) [rad/s | m/s].
            axes: "local" or "world".
            pose: Pose of the base; None: the identity.
        Returns:
            Rate of the generalised Jacobian, (6, m).
        """
        x, g = self._at(x, pose)
        system, r = self.system, self.system.r
        rates = vector(xdot, system.m, "xdot", system.shape_names)
        reduced = self._reduction.at(x)
        A, dA = reduced.local_connection, np.einsum("rab,b->ra", reduced.dA, rates)
        J = self._jacobian(x, g, axes)
        model, data = system.sorted_model, system.sorted_data
        q, v = system.sorted_q(g, x), system.sorted_v(-A @ rates, rates)
        pin.computeJointJacobiansTimeVariation(model, data, q, v)
        pin.updateFramePlacements(model, data)
        Jdot = pin.getFrameJacobianTimeVariation(model, data, self._id, _FRAMES[axes])
        Jdot = system.on_shape(Jdot)
        return read_only(Jdot[:, r:] - Jdot[:, :r] @ A - J[:, :r] @ dA)

    def drift(
        self, x: ArrayLike, mu: ArrayLike, *, axes: Axes = "local", pose: ArrayLike | None = None
    ) -> Array:
        """Compute the twist J_b I⁻¹ μ of the hand with locked joints.

        Args:
            x: Shape, (nx,) [rad | m | 1].
            mu: Body momentum, (r,) [N s | N m s].
            axes: "local" or "world".
            pose: Pose of the base; None: the identity.
        Returns:
            (6,) [m/s; rad/s].
        """
        x, g = self._at(x, pose)
        mu = vector(mu, self.system.r, "mu", self.system.group.momentum_names)
        omega = np.linalg.solve(self._reduction.locked_inertia(x), mu)
        return read_only(self._jacobian(x, g, axes)[:, : self.system.r] @ omega)

    def hand_pose(self, x: ArrayLike, *, pose: ArrayLike | None = None) -> pin.SE3:
        """Compute the pose of the hand in the world frame.

        Args:
            x: Shape, (nx,) [rad | m | 1].
            pose: Pose of the base; None: the identity.
        Returns:
            The pose.
        """
        x, g = self._at(x, pose)
        model, data = self.system.sorted_model, self.system.sorted_data
        pin.framesForwardKinematics(model, data, self.system.sorted_q(g, x))
        return pin.SE3(data.oMf[self._id])

    def singularity(self, x: ArrayLike) -> Singularity:
        """Compute the singular values of the task rows of J_g, and the twist with the least value.

        Args:
            x: Shape, (nx,) [rad | m | 1].
        Returns:
            The values and directions.
        Raises:
            InputError: The system has no joints.
        """
        J = self.generalized_jacobian(x)[list(self.task)]
        k = min(J.shape)
        if not k:
            raise InputError(f"'{self.system.name}' has no joints to move the hand")
        left_vectors, values, right = np.linalg.svd(J)
        square = J.shape[0] == J.shape[1]
        determinant = float(np.linalg.det(J)) if square else float(np.prod(values))
        return Singularity(values, determinant, left_vectors[:, k - 1].copy(), right[k - 1].copy())

    def determinants(self, shapes: ArrayLike) -> Array:
        """Compute the determinant of `singularity` at many shapes.

        Args:
            shapes: Shapes, (..., nx) [rad | m | 1].
        Returns:
            (...,) determinants.
        """
        system = self.system
        x = vectors(shapes, system.nx, "shapes", system.x_names)
        flat = system.space.normalized(x, "shapes").reshape(-1, system.nx)
        r, g = system.r, system.group.identity()
        A = self._reduction.grid(flat).local_connection
        J = np.array([self._jacobian(shape, g, "local") for shape in flat]).reshape(-1, 6, system.n)
        task_rows = (J[..., r:] - J[..., :r] @ A)[:, list(self.task)]
        if task_rows.shape[1] == task_rows.shape[2]:
            determinants = np.linalg.det(task_rows)
        else:
            determinants = np.prod(np.linalg.svd(task_rows, compute_uv=False), axis=1)
        return read_only(np.asarray(determinants).reshape(x.shape[:-1]))

    def singular_values_of(
        self, joint: str, x: ArrayLike, *, limits: tuple[float, float] = (-np.pi, np.pi)
    ) -> Array:
        """Find the values of one joint at which the arm is singular (the determinant changes sign).

        The number of joint rates must equal the number of task rows. For an axis of a ball, such as
        "neck.x", the values are angles of a rotation about this axis after the attitude in `x`.

        Args:
            joint: Name of the joint, or of an axis of a ball.
            x: Shape with the values of the other joints, (nx,) [rad | m | 1].
            limits: Range of the joint (low, high) [rad | m].
        Returns:
            (K,) values of the joint [rad | m].
        Raises:
            InputError: The joint is unknown, or the limits are not in order.
        """
        system = self.system
        k = joint_index(joint, system.shape_names, "singular_values_of")
        start, space = self._at(x, None)[0], system.space
        low, high = float(limits[0]), float(limits[1])
        if not low < high:
            raise InputError(f"limits must be (low, high), got {limits}")

        def shape_at(fraction: float) -> Array:
            value = low + fraction * (high - low)
            if k in space.ball_v:
                return space.integrate(start, value * np.eye(space.m)[k])
            shape = start.copy()
            shape[space.coordinates_of([k])] = value
            return shape

        return read_only(low + (high - low) * self._roots(shape_at))

    def singular_along(self, start: ArrayLike, end: ArrayLike) -> Array:
        """Find the singular points on a straight path, by sign changes of the determinant.

        A ball rotates about one axis.

        Args:
            start: First shape, (nx,) [rad | m | 1].
            end: Last shape, (nx,) [rad | m | 1].
        Returns:
            (K,) fractions of the path, in [0, 1].
        """
        system = self.system
        a, b = (
            system.space.normalized(vector(shape, system.nx, name, system.x_names), name)
            for shape, name in ((start, "start"), (end, "end"))
        )
        step = system.space.difference(a, b)
        return read_only(self._roots(lambda fraction: system.space.integrate(a, fraction * step)))

    def null_space(self, x: ArrayLike, *, of: Literal["base", "attitude"] = "base") -> Array:
        """Return joint rates that do not move the base: the kernel of A.

        Args:
            x: Shape, (nx,) [rad | m | 1].
            of: "base" for position and attitude of the base, "attitude" for its rotation only.
        Returns:
            (m, k): orthonormal joint rates, one per column.
        Raises:
            InputError: `of` is neither "base" nor "attitude".
        """
        _checked_part(of)
        A = self._reduction.local_connection(self._at(x, None)[0])
        if of == "attitude":
            A = A[self.system.group.linear :]
        if not A.size:
            return read_only(np.eye(self.system.m))
        _, values, right = np.linalg.svd(A)
        rank = int((values > _NO_REACTION * max(float(values[0]), 1e-300)).sum())
        return read_only(right[rank:].T.copy())

    def reaction_free_path(
        self,
        x0: ArrayLike,
        direction: ArrayLike | None = None,
        *,
        length: float = 2.0 * np.pi,
        of: Literal["base", "attitude"] = "attitude",
        limits: Sequence[tuple[float, float]] | None = None,
    ) -> ReactionFreePath:
        """Integrate a path of shapes along which the base does not turn, at zero momentum.

        The path is the straightest one in the null space. It ends at its length, at a limit of a
        joint or at a singular shape, where the null space changes its dimension.

        Args:
            x0: First shape, (m,) [rad | m].
            direction: Joint rates, (m,), whose part in `null_space` starts the path. None if the
                null space has one dimension: the largest joint rate is then positive.
            length: Largest length of the path in joint space [rad | m].
            of: "attitude" for paths on which the base does not turn, "base" for paths on which it
                does not move either.
            limits: (low, high) of each joint [rad | m]; None: the limits of the robot's file.
        Returns:
            The path, with signals for `prescribed` of a Scene.
        Raises:
            InputError: The robot has balls, x0 is singular or outside the limits, no direction is
                free of reactions, or an argument is invalid.
        """
        system = self.system
        if system.space.balls:
            raise InputError(
                f"reaction_free_path: expected hinges and slides, got ball joint "
                f"'{system.space.balls[0].name}'. Lock it, or state it as three hinges"
            )
        rows = slice(0 if _checked_part(of) == "base" else system.group.linear, None)
        if limits is None:
            bounds = np.tile([-np.inf, np.inf], (system.m, 1))
            for limit in limits_of(system):
                if limit.kind == "position" and limit.joint in system.shape_names:
                    bounds[system.shape_names.index(limit.joint)] = limit.lower, limit.upper
        else:
            bounds = vectors(limits, 2, "limits")
        if bounds.shape != (system.m, 2) or not (bounds[:, 0] < bounds[:, 1]).all():
            raise InputError(f"limits must be (low, high) for each of {system.m} joints")

        def connection_rate(x: Array, xdot: Array) -> Array:
            return np.asarray(np.einsum("rab,b->ra", self._reduction.at(x).dA, xdot)[rows])

        start_direction = direction
        if start_direction is not None:
            start_direction = vector(start_direction, system.m, "direction", system.shape_names)
        return integrate_path(
            system, lambda x: self._reduction.local_connection(x)[rows], connection_rate,
            self._at(x0, None)[0], start_direction, positive(length, "length"), bounds,
        )  # fmt: skip

    def workspace(
        self,
        *,
        limits: Sequence[tuple[float, float]] | None = None,
        samples: int = 121,
        seed: int = 0,
    ) -> Workspace:
        """Compute the distances from the centre of mass that the hand reaches.

        Descent finds the extreme distances. Sign changes of the determinant between samples find
        the singular shapes, so the ranges are as accurate as the samples are dense. The number of
        joints must equal the number of task rows.

        Args:
            limits: (low, high) of each joint [rad | m], for balls of each component of the rotation
                vector; None: a full turn.
            samples: For one or two joints, the number of grid values of each; for more joints, the
                number of straight lines in random directions through their box.
            seed: Seed of the random directions.
        Returns:
            The workspace.
        Raises:
            InputError: The numbers of joints and task rows differ, or the limits are invalid.
        """
        system = self.system
        if not system.m or len(self.task) != system.m:
            raise InputError(
                f"workspace: expected as many joints as task rows, got {system.m} joints and "
                f"{len(self.task)} rows. Choose other rows with FloatingArm(task=…)."
            )
        joint_limits = [(-np.pi, np.pi)] * system.m if limits is None else limits
        bounds = vectors(joint_limits, 2, "limits")
        if bounds.shape != (system.m, 2) or not (bounds[:, 0] < bounds[:, 1]).all():
            raise InputError(f"limits must be (low, high) for each of {system.m} joints")
        chart = RotationChart(system.space, system.space.neutral)
        return workspace_of(
            lambda w: self._radius(chart.shapes(w)),
            lambda w: chart.rate_maps(w).T @ self._radius_gradient(chart.shapes(w)),
            lambda w: self.determinants(chart.shapes(w)), bounds,
            whole(samples, "samples", 2), whole(seed, "seed", 0),
        )  # fmt: skip

    def _radius(self, shapes: Array) -> Array:
        """Return the distances (...,) [m] between hand and centre of mass at shapes (..., nx)."""
        system, model, data = self.system, self.system.sorted_model, self.system.sorted_data
        flat, g = shapes.reshape(-1, system.nx), system.group.identity()
        distances = np.empty(len(flat))
        for k, x in enumerate(flat):
            q = system.sorted_q(g, x)
            com = pin.centerOfMass(model, data, q)
            pin.updateFramePlacements(model, data)
            distances[k] = np.linalg.norm(data.oMf[self._id].translation - com)
        return distances.reshape(shapes.shape[:-1])

    def _radius_gradient(self, x: Array) -> Array:
        """Return the gradient (m,) of the hand's distance from the centre of mass, base at rest."""
        system, model, data = self.system, self.system.sorted_model, self.system.sorted_data
        q = system.sorted_q(system.group.identity(), x)
        com_jacobian = pin.jacobianCenterOfMass(model, data, q)
        hand_jacobian = pin.computeFrameJacobian(model, data, q, self._id, _FRAMES["world"])[:3]
        pin.updateFramePlacements(model, data)
        offset = data.oMf[self._id].translation - data.com[0]
        direction = offset / max(float(np.linalg.norm(offset)), 1e-300)
        return np.asarray(direction @ system.on_shape(hand_jacobian - com_jacobian))[system.r :]

    def _roots(self, shape_at: Callable[[float], Array]) -> Array:
        """Return the fractions in [0, 1] at which the determinant changes sign along a path."""
        from scipy.optimize import brentq

        if len(self.task) != self.system.m:
            raise InputError(
                f"singular shapes: expected as many joints as task rows, got {self.system.m} "
                f"joints and {len(self.task)} rows. Choose other rows with FloatingArm(task=…)."
            )

        def det(fraction: float) -> float:
            return float(self.determinants(shape_at(fraction)))

        fractions = np.linspace(0.0, 1.0, _ROOT_SAMPLES)
        values = self.determinants(np.array([shape_at(fraction) for fraction in fractions]))
        roots = [float(fraction) for fraction in fractions[values == 0.0]]
        brackets = np.flatnonzero(values[:-1] * values[1:] < 0.0)
        roots += [float(brentq(det, fractions[k], fractions[k + 1], xtol=1e-15)) for k in brackets]
        return np.array(sorted(roots))

    def _at(self, x: ArrayLike, pose: ArrayLike | None) -> tuple[Array, Array]:
        """Validate a shape and a pose."""
        system = self.system
        shape = system.space.normalized(vector(x, system.nx, "x", system.x_names), "x")
        return shape, system.group.identity() if pose is None else system.group.pose(pose)

    def _jacobian(self, x: Array, g: Array, axes: str) -> Array:
        """Return the Jacobian (J_b, J_s) of the hand, (6, n), at a shape x and pose g."""
        if axes not in _FRAMES:
            raise InputError(f"axes must be {' or '.join(_FRAMES)}, got {axes!r}")
        model, data = self.system.sorted_model, self.system.sorted_data
        q = self.system.sorted_q(g, x)
        J = pin.computeFrameJacobian(model, data, q, self._id, _FRAMES[axes])
        return np.asarray(self.system.on_shape(J))


def _checked_part(of: str) -> str:
    """Return the part of the motion of the base that a null space excludes, if it is valid."""
    if of not in ("base", "attitude"):
        raise InputError(f"of: expected 'base' or 'attitude', got {of!r}")
    return of
