"""View: how a motion is to be drawn."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypedDict

from ...common.arrays import positive
from ...common.errors import InputError
from ...system.visuals import mesh_folders

FPS = 60.0  # frames in a second of playback
FILM_FPS = 30.0  # and of a film


@dataclass(frozen=True, kw_only=True)
class View:
    """Things drawn besides the robot, and the speed.

    ghost: also draw the full simulation (ABA on the full state) beside the reduced one.
    speed: seconds of the motion in a second of playback, to begin with.  fps: frames in a
    second of playback; the page draws between them, too.  pair: two joints, the axes of the
    shape panel (those that move the most without spinning).  meshes: draw what the robot's
    file says, else bodies made from the inertias; or folders in which the meshes of a URDF are
    looked for, beside those of `load`.

    Raises InputError for values that make no sense.
    """

    ghost: bool = False
    speed: float = 1.0
    fps: float = FPS
    pair: Sequence[str] | None = None
    meshes: bool | str | Path | Sequence[str | Path] = True

    def __post_init__(self) -> None:
        if not isinstance(self.meshes, bool):
            object.__setattr__(self, "meshes", mesh_folders(self.meshes))
        for name in ("speed", "fps"):
            object.__setattr__(self, name, positive(getattr(self, name), name))
        if self.pair is not None:
            several = isinstance(self.pair, Iterable) and not isinstance(self.pair, str)
            pair = tuple(self.pair) if several else ()
            two = len(pair) == 2 and all(isinstance(name, str) for name in pair)
            if not two or pair[0] == pair[1]:
                raise InputError(f"pair must be the names of two joints, got {self.pair!r}")
            object.__setattr__(self, "pair", pair)


class ViewOptions(TypedDict, total=False):
    """The fields of View, for functions that take them as `**options`."""

    ghost: bool
    speed: float
    fps: float
    pair: Sequence[str] | None
    meshes: bool | str | Path | Sequence[str | Path]


def as_view(options: Mapping[str, Any], what: str) -> View:
    """Return the View that options make.  Raises InputError for one that there is not."""
    names = [entry.name for entry in fields(View)]
    for option in options:
        if option not in names:
            raise InputError(f"{what} has no option '{option}'; they are {', '.join(names)}")
    return View(**options)
