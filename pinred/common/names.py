"""Look-up of names, with suggestions for unknown ones."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

from .errors import InputError
from .plain_names import listed, quoted

_COMPARED = 200  # characters of a name that are compared
_MOST = 60  # joints listed in a message


def nearest(name: str, known: Sequence[str]) -> str:
    """Return a question that suggests the most similar known name; empty if none is similar."""
    near = difflib.get_close_matches(name[:_COMPARED], known, n=1)
    return f"did you mean {quoted(near[0])}? " if near else ""


def joint_index(name: str, joints: Sequence[str], what: str) -> int:
    """Return the index of a shape joint.

    Args:
        name: Name of the joint.
        joints: Names of all shape joints.
        what: Name of the argument, for messages.
    Returns:
        The index.
    Raises:
        InputError: No shape joint has this name.  The message lists the joints.
    """
    if name in joints:
        return joints.index(name)
    raise InputError(
        f"{what}: no shape joint {quoted(str(name))}; {nearest(str(name), joints)}"
        f"the joints are {listed(joints, _MOST) or 'none'}"
    )
