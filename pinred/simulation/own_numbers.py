"""Numbers of a kernel that members of one plan have for themselves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..common.arrays import Array


@dataclass(frozen=True)
class OwnNumbers:
    """Numbers of members; None for those of the plan.

    numbers: (N, p) in the forces.  robot: (N, s) those of bodies that are freed, which may be any.
    gravity: (N, 3) what of it acts, and fall: (N, k) with which
    the centre of mass falls, in the root joint's fixed frame [m/s²].
    """

    numbers: Array | None = None
    robot: Array | None = None
    gravity: Array | None = None
    fall: Array | None = None

    def __getitem__(self, which: object) -> OwnNumbers:
        rows: dict[str, Any] = {
            name: None if part is None else part[which] for name, part in vars(self).items()
        }
        return OwnNumbers(**rows)
