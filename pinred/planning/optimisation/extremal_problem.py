"""The periodic boundary value problem of an extremal of the isoholonomic problem.

The loop is divided into segments of equal length (multiple shooting), because over a whole loop
Wong's equations amplify errors by some 1e4.  The unknowns are shape, canonical momentum and body
charge at the start of each segment, and the multipliers of the displacement.  The segments must
join, shape and momentum must return, and the charge at the end must be a combination of the
gradients of the displacement (transversality).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...common.arrays import Array
from ...lie.group import Group
from .objective import AxisAim, TargetAim
from .transcription import Task
from .wong_equations import Motions, WongEquations

SEGMENTS = 16  # number of segments of the loop
_STEP = 1e-5  # step of the central differences, relative to the scale of the unknowns


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
        before, after = (np.broadcast_to(each, shape) for each in (before, after))
        return self.group.compose(self.group.compose(before, replaced), after)
