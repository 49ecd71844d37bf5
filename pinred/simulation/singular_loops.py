"""Shapes at which the equations of closed loops become dependent, so that motions can branch."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..common.arrays import Array
from ..common.errors import IntegrationError
from ..common.names import listed
from ..reduction.tree.loop_constraints import jacobian_function
from ..system.loops.loop_assembly import rate_units, singularity
from ..system.loops.looped_system import loop_kinematics
from ..system.system import System

if TYPE_CHECKING:
    from .motion import Motion

_MOST = 400  # largest number of times at which the rank of the equations is checked
_NEAR = 0.05  # fraction of the generic singular value below which a minimum is refined
_SINGULAR = 1e-6  # fraction of the generic singular value at which equations are dependent
# Number of times of a closer look, and least cosine between neighbours at which rows are followed.
_CLOSER, _RESOLVED = 17, 0.8
_COSINE = 0.3  # least cosine between the row spaces of J at neighbouring times


class SingularLoopsError(IntegrationError):
    """The equations of the loops become dependent along a motion.

    Attributes:
        time: Time at which they do [s].
    """

    def __init__(self, message: str, time: float) -> None:
        """Store the message and the time."""
        super().__init__(message)
        self.time = time

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.time)


def may_pass_singular_shape(system: System, x: Array) -> bool:
    """Return whether a motion through given shapes may pass a singular shape of the loops.

    The least singular value of the scaled Jacobian J is small near such a shape, and behind it the
    rows of J span the same space with the opposite orientation.

    Args:
        system: The system, with or without loops.
        x: Shapes of the motion in order, (T, nx) [rad | m].
    Returns:
        True if J is nearly singular at a shape, or turns too far between two shapes.
    """
    if system.closure is None or not len(x):
        return False
    J = _scaled_jacobians(system, x)
    if not np.linalg.svd(J, compute_uv=False)[:, -1].min() > _NEAR * system.closure.least:
        return True
    cosines, orientation = _turns(J)
    return bool((cosines < _COSINE).any() or (orientation < 0.0).any())


def _scaled_jacobians(system: System, x: Array) -> Array:
    """Return the Jacobians without units, (T, k, m), at shapes (T, nx)."""
    closure = system.closure
    assert closure is not None
    blocks = jacobian_function(system).map(len(x))(x.T).full()
    J = blocks.reshape(closure.rank, len(x), system.m).transpose(1, 0, 2)
    is_length = loop_kinematics(system).is_length[closure.rows]
    J = J * np.where(is_length, 1.0 / closure.length, 1.0)[:, None]
    return np.asarray(J * rate_units(system, closure.length))


def _turns(J: Array) -> tuple[Array, Array]:
    """Return how the row spaces of successive Jacobians (T, k, m) turn.

    Returns:
        Cosines of the largest angles between them, (T − 1,), and numbers that are negative where
        the orientation of the rows changes, (T − 1,).
    """
    Q, R = np.linalg.qr(J.transpose(0, 2, 1))
    Q[:, :, 0] *= np.sign(np.linalg.det(R))[:, None]
    change = Q[:-1].transpose(0, 2, 1) @ Q[1:]
    return np.linalg.svd(change, compute_uv=False)[:, -1], np.linalg.det(change)


def near_singular_loops(system: System, x: Array) -> str:
    """Return a clause about equations of loops that are nearly dependent at x; empty otherwise."""
    if system.closure is None or singularity(system, x) > _NEAR:
        return ""
    return f", near a shape at which the equations of the loops {_names(system)} become dependent"


def _names(system: System) -> str:
    return listed([loop.name for loop in system.loops], 6)


def refuse_singular_loops(system: System, motion: Motion) -> None:
    """Reject a motion through a shape at which the equations of the loops become dependent.

    There the motion can continue along several branches, so it is not determined.

    Args:
        system: The system.
        motion: The motion.
    Raises:
        IntegrationError: The motion passes such a shape; the message names loops, time and shape.
    """
    if system.closure is not None:
        refuse_singular_shapes(system, motion.knots, lambda t: motion.states(t).x)


def refuse_singular_shapes(
    system: System, knots: Array, shapes_at: Callable[[Array], Array]
) -> None:
    """Reject a motion through a singular shape, given its shapes; see `refuse_singular_loops`.

    Args:
        system: The system, with loops.
        knots: Times of all step ends, (K,) [s].
        shapes_at: Function that returns the shapes (T, nx) at times (T,).
    Raises:
        SingularLoopsError: The motion passes such a shape.
    """
    count = min(_MOST, 4 * len(knots))
    times = np.interp(np.linspace(0.0, 1.0, count), np.linspace(0.0, 1.0, len(knots)), knots)

    def value(t: float) -> float:
        return singularity(system, shapes_at(np.array([t]))[0])

    shapes = shapes_at(times)
    values = np.array([singularity(system, x) for x in shapes])
    passed = np.zeros(count, dtype=bool)
    for k in np.flatnonzero(_turns(_scaled_jacobians(system, shapes))[1] < 0.0).tolist():
        # Rows that turn far between two times also change their orientation, so look closer.
        between = shapes_at(np.linspace(times[k], times[k + 1], _CLOSER))
        cosines, orientation = _turns(_scaled_jacobians(system, between))
        passed[k] = cosines.min() > _RESOLVED and np.prod(orientation) < 0.0
    for k in np.flatnonzero((values < _NEAR) | passed).tolist():
        first, last = max(k - 1, 0), min(k + 1, count - 1)
        if values[k] > min(values[first], values[last]) and not passed[k]:
            continue
        span = (float(times[first]), float(times[last]))
        from scipy.optimize import minimize_scalar

        found = minimize_scalar(value, bounds=span, method="bounded", options={"xatol": 1e-12})
        if passed[k] or min(found.fun, values[k]) < _SINGULAR:
            at = shapes_at(np.array([found.x]))[0]
            raise SingularLoopsError(
                f"the equations of the loops {_names(system)} of '{system.name}' become dependent "
                f"at t = {found.x:g} s, x = {at}. There the motion can continue in several ways. "
                "End the motion earlier, or avoid the shape with a limit or a spring.",
                float(found.x),
            )
