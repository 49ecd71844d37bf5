"""Numbers in XML attributes."""

from __future__ import annotations

from xml.etree.ElementTree import Element

import numpy as np

from .arrays import Array
from .errors import ModelError


def floats(element: Element, key: str, what: str, *sizes: int) -> Array:
    """Return the numbers in an attribute.

    what: whose attribute it is, for the message.  sizes: how many there may be.
    Raises ModelError if they are not that many finite numbers.
    """
    text = element.get(key, "")
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.empty(0)
    if len(values) not in sizes or not np.isfinite(values).all():
        many = " or ".join(map(str, sizes))
        raise ModelError(f"{what}: '{key}' must be {many} finite number(s), got '{text}'")
    return values


def axis(element: Element, key: str, what: str) -> None:
    """Check the axis of a joint.  Raises ModelError if it has no direction."""
    if not floats(element, key, f"the axis of {what}", 3).any():
        raise ModelError(f"the axis of {what} is zero")
