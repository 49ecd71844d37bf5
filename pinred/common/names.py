"""Names that are looked up, and what to say of one that is not there."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

from .errors import InputError
from .plain_names import listed, quoted

_COMPARED = 200  # characters of a name that are compared with others
_MOST = 60  # names in a list


def nearest(name: str, known: Sequence[str]) -> str:
    """Return the question whether the nearest of the known names is meant; "" if none is near."""
    near = difflib.get_close_matches(name[:_COMPARED], known, n=1)
    return f"did you mean {quoted(near[0])}? " if near else ""


def joint_index(name: str, joints: Sequence[str], what: str) -> int:
    """Return the index of a joint.  Raises InputError naming `what` and listing the joints."""
    if name in joints:
        return joints.index(name)
    raise InputError(
        f"{what}: no shape joint {quoted(str(name))}; {nearest(str(name), joints)}"
        f"the joints are {listed(joints, _MOST) or 'none'}"
    )
