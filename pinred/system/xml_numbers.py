"""Numbers in XML attributes, read as strictly as Pinocchio's own parsers read them."""

from __future__ import annotations

import re
from xml.etree.ElementTree import Element

import numpy as np

from ..common.arrays import Array
from ..common.errors import ModelError
from ..common.plain_names import quoted

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def floats(element: Element, key: str, what: str, *sizes: int) -> Array:
    """Return the numbers in an attribute.

    what: the owner of the attribute, for the message.  sizes: how many numbers there may be.
    Raises ModelError if they are not that many finite numbers.
    """
    text = element.get(key, "")
    words = text.split()
    values = np.array([float(w) for w in words if _NUMBER.fullmatch(w)])
    if len(values) != len(words) or len(values) not in sizes or not np.isfinite(values).all():
        many = " or ".join(map(str, sizes))
        raise ModelError(f"{what}: '{key}' must be {many} finite number(s), got {quoted(text)}")
    return values


def axis(element: Element, key: str, what: str) -> None:
    """Check the axis of a joint.  Raises ModelError if it has no direction."""
    if not floats(element, key, f"the axis of {what}", 3).any():
        raise ModelError(f"the axis of {what} is zero")
