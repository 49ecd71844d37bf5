"""Coefficients of Fourier gaits, and gaits from rest to rest as plans of a simulation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...common.arrays import Array
from ...common.errors import InputError
from ...forces.signals import Expression, Signal
from .arcs import FourierArc
from .gait import Gait


def coefficients_of(gait: Gait, harmonics: int | None = None) -> Array:
    """Return mean, cosines and sines of a Fourier gait from its start on, (1 + 2 harmonics, m).

    harmonics: as many as it has if not given; of what it does not have they are zero.
    Raises InputError if it is not one Fourier series.
    """
    arc = gait.arcs[0]
    if not gait.is_smooth or not isinstance(arc, FourierArc):
        raise InputError("only a gait that is one Fourier series has coefficients")
    k = np.arange(1, len(arc.cos) + 1)[:, None]
    c, s = np.cos(k * arc.start), np.sin(k * arc.start)
    sense = np.sign(arc.end - arc.start)
    count = len(arc.cos) if harmonics is None else harmonics
    out = np.zeros((1 + 2 * count, gait.m))
    out[0] = arc.mean
    out[1 : 1 + len(k)] = c * arc.cos + s * arc.sin
    out[1 + count : 1 + count + len(k)] = sense * (c * arc.sin - s * arc.cos)
    return out


def rest_to_rest(
    gait: Gait, joints: Sequence[str], cycles: int, duration: float
) -> dict[str, Signal]:
    """Return each joint's motion through so many cycles, from rest to rest.

    The phase angle is φ = cycles (a − sin a), a = 2πt/duration, a cycloid: speeds and accelerations
    are zero at both ends.
    """
    c = coefficients_of(gait)
    h = (len(c) - 1) // 2
    a = f"(2*pi*t/{float(duration)!r})"
    angle = f"({cycles}*({a} - sin({a})))"
    out: dict[str, Signal] = {}
    for j, name in enumerate(joints):
        terms = [repr(float(c[0, j]))]
        for k in range(1, h + 1):
            terms.append(f"({float(c[k, j])!r})*cos({k}*{angle})")
            terms.append(f"({float(c[h + k, j])!r})*sin({k}*{angle})")
        out[name] = Expression(" + ".join(terms))
    return out
