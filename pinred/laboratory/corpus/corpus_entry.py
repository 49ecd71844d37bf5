"""One line of the table: a description, and what came of it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal, TypeAlias

from ...common.files import write_table

Kind: TypeAlias = Literal["urdf", "mjcf", "name"]
Outcome: TypeAlias = Literal[
    "passed", "without gravity", "refused", "stopped", "FAILED", "error", "fragment"
]
GOOD: tuple[Outcome, ...] = ("passed", "without gravity")


@dataclass(frozen=True)
class Entry:
    """The outcome of one description.

    file: its path, or a robot's name.  outcome: "passed"; "without gravity", which breaks the
    symmetry of its root; "refused", by an error of pinred; "stopped", by a simulation that
    cannot go on, or by time; "FAILED", against ABA or MuJoCo; "error", any other exception or a
    crash; "fragment", of other files only.  reason: in one line.  about: the kind of the reason,
    in few words.  due: whether it should work (see `scope`); why_not: if not, why.
    choice: what had to be chosen for it, as "root=arm".  group, joints: of the system.
    duration: of the motion [s].
    aba: largest error against ABA, relative to the motion's size; allowed: what passes.
    mass, forces: largest error of the mass matrix and of forces against MuJoCo's reading,
    relative; NaN if it has none, and `second` says why.
    load, simulate, wall: seconds for reading, for the first simulation, and in all.
    """

    file: str
    kind: Kind
    outcome: Outcome
    reason: str = ""
    about: str = ""
    due: bool = True
    why_not: str = ""
    choice: str = ""
    group: str = ""
    joints: int = -1
    duration: float = math.nan
    aba: float = math.nan
    allowed: float = math.nan
    mass: float = math.nan
    forces: float = math.nan
    second: str = ""
    load: float = math.nan
    simulate: float = math.nan
    wall: float = math.nan

    @property
    def good(self) -> bool:
        """Whether it was read, simulated, and agrees with its judges."""
        return self.outcome in GOOD


COLUMNS = tuple(field.name for field in fields(Entry))


def write_entries(path: Path, entries: Iterable[Entry]) -> None:
    """Write entries as csv, whole or not at all.  Raises OutputError."""
    write_table(path, COLUMNS, (vars(entry) for entry in entries))
