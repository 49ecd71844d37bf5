"""Coefficients of Fourier gaits, and gaits from rest to rest as prescribed joint motions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...common.arrays import Array
from ...common.errors import InputError
from ...forces.signals import Expression, Signal
from .arcs import FourierArc
from .gait import Gait


def coefficients_of(gait: Gait, harmonics: int | None = None) -> Array:
    """Return mean, cosines and sines of a Fourier gait, with t = 0 at its start.

    Args:
        gait: Gait that is one Fourier series.
        harmonics: Number of harmonics to return, padded with zeros; by default the number of the
            gait.
    Returns:
        Mean, cosine and sine coefficients, (1 + 2 harmonics, m).
    Raises:
        InputError: The gait is not one Fourier series.
    """
    arc = gait.arcs[0]
    if not gait.is_smooth or not isinstance(arc, FourierArc):
        raise InputError(
            "gait: expected one Fourier series (Gait.fourier); other gaits have no coefficients"
        )
    k = np.arange(1, len(arc.cos) + 1)[:, None]
    cosine, sine = np.cos(k * arc.start), np.sin(k * arc.start)
    sense = np.sign(arc.end - arc.start)
    count = len(arc.cos) if harmonics is None else harmonics
    coefficients = np.zeros((1 + 2 * count, gait.m))
    coefficients[0] = arc.mean
    coefficients[1 : 1 + len(k)] = cosine * arc.cos + sine * arc.sin
    coefficients[1 + count : 1 + count + len(k)] = sense * (cosine * arc.sin - sine * arc.cos)
    return coefficients


def rest_to_rest(
    gait: Gait, joints: Sequence[str], cycles: int, duration: float
) -> dict[str, Signal]:
    """Return the motion of each joint through several cycles of a gait, from rest to rest.

    The phase angle is the cycloid φ = cycles (a − sin a), a = 2πt/duration. Rates and accelerations
    are zero at both ends.

    Args:
        gait: Gait that is one Fourier series.
        joints: Names of the joints, in order.
        cycles: Number of cycles.
        duration: Duration of all cycles [s].
    Returns:
        A signal per joint, for `prescribed` of a Scene.
    """
    c = coefficients_of(gait)
    h = (len(c) - 1) // 2
    a = f"(2*pi*t/{float(duration)!r})"
    angle = f"({cycles}*({a} - sin({a})))"
    signals: dict[str, Signal] = {}
    for j, name in enumerate(joints):
        terms = [repr(float(c[0, j]))]
        for k in range(1, h + 1):
            terms.append(f"({float(c[k, j])!r})*cos({k}*{angle})")
            terms.append(f"({float(c[h + k, j])!r})*sin({k}*{angle})")
        signals[name] = Expression(" + ".join(terms))
    return signals
