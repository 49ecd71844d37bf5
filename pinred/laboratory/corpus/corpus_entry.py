"""One row of the corpus table: a description and the outcome of its trial."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal, TypeAlias

from ...common.files import write_table

Kind: TypeAlias = Literal["urdf", "mjcf", "sdf", "name"]
Outcome: TypeAlias = Literal[
    "passed", "without gravity", "refused", "stopped", "FAILED", "error", "fragment"
]
GOOD: tuple[Outcome, ...] = ("passed", "without gravity")


@dataclass(frozen=True)
class Entry:
    """The outcome of one description.

    Attributes:
        file: Path of the file, or name of the robot.
        kind: "urdf", "mjcf", "sdf" or "name".
        outcome: "passed"; "without gravity" (gravity breaks the symmetry of its root);
            "refused" (an error of pinred); "stopped" (the simulation or the time limit);
            "FAILED" (differs from ABA, MuJoCo or the independent reader); "error" (other exception,
            or a crash);
            "fragment" (only part of other files).
        reason: Reason of the outcome in one line.
        about: Category of the reason, for the summary.
        due: Whether the description should work, see scope.py.
        why_not: Reason why the description is not required to work.
        choice: Option that resolved an ambiguity of the description, such as "root=arm".
        group: Symmetry group of the system.
        joints: Number of joints m.
        duration: Duration of the motion [s].
        aba: Largest error against ABA, relative to the motion's size.
        allowed: Largest `aba` that passes.
        mass: Largest relative error of the mass matrix against MuJoCo's reading; NaN if none.
        forces: Largest relative error of the forces against MuJoCo's reading; NaN if none.
        second: Reason why there is no comparison with MuJoCo's reading.
        reader: Independent reader of the format whose reading was compared; "" if there is none
            or if it does not open the file.
        unread: Reason why that reader does not open the file.
        load: Time for loading [s].
        simulate: Time for the first simulation [s].
        wall: Total time [s].
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
    reader: str = ""
    unread: str = ""
    load: float = math.nan
    simulate: float = math.nan
    wall: float = math.nan

    @property
    def good(self) -> bool:
        """Whether the description was loaded and simulated, and agrees with ABA and MuJoCo."""
        return self.outcome in GOOD


COLUMNS = tuple(field.name for field in fields(Entry))


def write_entries(path: Path, entries: Iterable[Entry]) -> None:
    """Write entries as csv; raise OutputError and keep the old file on failure."""
    write_table(path, COLUMNS, (vars(entry) for entry in entries))
