"""A motion read back from a .npz file: numbers and names, and no robot."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..arrays import Array, as_floats, read_only
from ..errors import InputError, LoadError
from ..lie import GROUPS

_TIME_FIRST = (
    *("x", "xdot", "energy", "pose", "xi", "q", "v", "body_momentum", "spatial_momentum"),
)


@dataclass(frozen=True, eq=False)
class Recording:
    """What `Trajectory.save` wrote to a .npz file; arrays are those of State, read-only.

    The file names its robot and joints, but holds no model of it.
    """

    path: Path
    robot: str
    group: str
    joints: tuple[str, ...]
    arrays: Mapping[str, Array]

    @property
    def t(self) -> Array:
        """Report times, (T,) [s]."""
        return self.arrays["t"]

    @property
    def x(self) -> Array:
        """Shape, (T, m) [rad | m]."""
        return self.arrays["x"]

    @property
    def xdot(self) -> Array:
        """Shape rate, (T, m)."""
        return self.arrays["xdot"]

    @property
    def energy(self) -> Array:
        """Total energy, (T,) [J]."""
        return self.arrays["energy"]

    @property
    def pose(self) -> Array:
        """Pose of the base, (T, size).  Raises InputError if the base was left out."""
        return self._with_base("pose")

    @property
    def body_momentum(self) -> Array:
        """Body momentum μ, (T, r).  Raises InputError if the base was left out."""
        return self._with_base("body_momentum")

    @property
    def spatial_momentum(self) -> Array:
        """Spatial momentum J, (T, r).  Raises InputError if the base was left out."""
        return self._with_base("spatial_momentum")

    def _with_base(self, name: str) -> Array:
        if name not in self.arrays:
            raise InputError(
                f"'{self.path}' has no {name}: its scene had outputs='shape', which leaves out "
                "the base"
            )
        return self.arrays[name]


def read_recording(path: str | Path) -> Recording:
    """Return the motion in a .npz file that `Trajectory.save` wrote.

    Raises LoadError if it cannot be read or holds something else.
    """
    path = Path(path)
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            content = {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise LoadError(f"'{path}': no such file") from None
    except (OSError, ValueError, EOFError, AttributeError, zipfile.BadZipFile) as error:
        raise LoadError(f"'{path}' is not a .npz file that can be read: {error}") from None
    missing = {"robot", "group", "joints", "t", "x", "xdot", "energy"} - content.keys()
    if missing:
        raise LoadError(
            f"'{path}' is not a motion that pinred wrote: it has no array '{min(missing)}'"
        )
    arrays = {
        name: read_only(as_floats(content[name], f"'{name}' of '{path}'").copy())
        for name in ("t", *_TIME_FIRST)
        if name in content
    }
    joints = tuple(map(str, np.atleast_1d(content["joints"])))
    if str(content["group"]) not in GROUPS:
        raise LoadError(f"'{path}': unknown group '{content['group']}'")
    times, group = arrays["t"], GROUPS[str(content["group"])]
    widths = {"x": len(joints), "xdot": len(joints), "pose": group.size, "xi": group.dim}
    widths |= dict.fromkeys(("body_momentum", "spatial_momentum"), group.dim)
    for name, array in arrays.items():
        shape = (len(times), widths[name]) if name in widths else (len(times), *array.shape[1:])
        if times.ndim != 1 or len(times) == 0 or array.shape != shape:
            raise LoadError(f"'{path}': '{name}' has shape {array.shape}, expected {shape}")
        if not np.isfinite(array).all():
            raise LoadError(f"'{path}': '{name}' has numbers that are not finite")
    return Recording(path, str(content["robot"]), group.name, joints, arrays)
