"""Names of the entries of a reduced state, for messages."""

from __future__ import annotations

from collections.abc import Sequence

from ..system.system import System


def entry_name(system: System, active: Sequence[int], cyclic: Sequence[int], entry: int) -> str:
    """Return what an entry of y = (x, π of active joints, x of cyclic ones, base) is."""
    names, k = system.shape_names, len(active)
    if entry < k:
        return f"the position of joint '{names[active[entry]]}'"
    if entry < 2 * k:
        return f"the momentum of joint '{names[active[entry - k]]}'"
    if entry < 2 * k + len(cyclic):
        return f"the position of joint '{names[cyclic[entry - 2 * k]]}'"
    return f"the motion of the root joint '{system.root_name}'"
