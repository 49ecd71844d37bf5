"""Rejection of shapes at which a connection is not defined."""

from __future__ import annotations

import numpy as np

from ...common.arrays import Array
from ...common.errors import InputError, SingularInertiaError
from ...kernels.connection.connection_form import ConnectionForm

# Least health of P_b, by whether the form is symmetric.
_LEAST_HEALTH = {True: 16.0 * np.finfo(float).eps, False: 1e-9}


def refuse_singular(form: ConnectionForm, x: Array, health: Array) -> None:
    """Raise an error at shapes where A is not defined.

    Args:
        form: Form of the connection.
        x: Shapes, (N, nx) [rad | m].
        health: Health of P_b at these shapes, (N,).
    Raises:
        SingularInertiaError: P_b is singular; the message names the first shape.
    """
    size = health if form.symmetric else np.abs(health)
    singular = ~(size > _LEAST_HEALTH[form.symmetric])
    if singular.any():
        shape = x[int(np.argmax(singular))]
        raise SingularInertiaError(
            f"A is not defined at the shape {shape}: {form.what} do not determine the "
            "motion of the body there. Keep the joints away from this shape."
        )


def refuse_crossing(form: ConnectionForm, health: Array) -> None:
    """Reject paths across singular shapes, where a non-symmetric form's health changes sign.

    Args:
        form: Form of the connection.
        health: Health of P_b along the path, (N,).
    Raises:
        SingularInertiaError: P_b is singular between two shapes.
    """
    if not form.symmetric and health.min() < 0.0 < health.max():
        raise SingularInertiaError(
            f"the gait crosses shapes at which {form.what} do not determine the motion "
            "of the body. Choose a gait that stays on one side of these shapes."
        )


def require_metric(form: ConnectionForm, M: Array | None) -> Array:
    """Return the metric of a form.  Raises InputError if the form defines none."""
    if M is None:
        raise InputError(f"{form.what} define no metric on shape space")
    return M
