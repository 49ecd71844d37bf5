"""The record of a run: its integrations from stop to stop, and the state of its followers.

The followers of a run are its controllers and events.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from ..common.arrays import Array, read_only
from ..integrators.run_keeper import SavedRun


@dataclass(frozen=True)
class Part:
    """An integration from one stop to the next.

    Attributes:
        start: Start time [s].
        end: End time [s].
        y0: Reduced state at the start, (k,).
        parameters: Parameters of the vector field, (p,).
        run: State of the integration; None if it has not begun.
        follower: State of controllers and events at the start, or None.
    """

    start: float
    end: float
    y0: Array
    parameters: Array
    run: SavedRun | None = None
    follower: Mapping[str, Any] | None = None

    @property
    def is_finished(self) -> bool:
        """Whether the run of this part is finished."""
        return self.run is not None and self.follower is None

    @classmethod
    def of(cls, saved: Mapping[str, Any]) -> Part:
        """Return a saved part."""
        part = cls(**saved)
        return replace(part, y0=read_only(part.y0), parameters=read_only(part.parameters))


class RunRecord:
    """The record of one run; it keeps the integration of its last part (see RunKeeper).

    Attributes:
        finished: Finished parts, in order.
        current: The saved part that is not finished, or None.
        follower: State of controllers and events at the end of a finished run, or None.
    """

    def __init__(self, saved: Mapping[str, Any], write: Callable[..., None]) -> None:
        """Read a record.

        Args:
            saved: The record as nested values; {} for a new run.
            write: Function that writes the checkpoint if a save is due.
        """
        self.finished = [Part.of(part) for part in saved.get("finished", ())]
        self.current = Part.of(saved["current"]) if saved.get("current") else None
        self.follower: Mapping[str, Any] | None = saved.get("follower")
        self._write, self._done = write, list(self.finished)
        self._part: Part | None = None
        self._follower: Callable[[], dict[str, Any]] = dict

    def begin_run(self, follower: Callable[[], dict[str, Any]]) -> None:
        """Set the function that returns the state of controllers and events.

        Raises an InputError if they have a state that cannot be saved.
        """
        follower()
        self._follower = follower

    def begin(self, part: Part) -> None:
        """Start a part; if its run is saved, it continues from there."""
        self._part = part

    def saved(self) -> SavedRun | None:
        """Return the state from which the current part continues; see RunKeeper."""
        assert self._part is not None
        return self._part.run

    def pause(self, state: Callable[[], dict[str, Any]]) -> None:
        """Write the checkpoint if a save is due; see RunKeeper."""
        part = self._part
        assert part is not None
        if part.is_finished:
            return

        def current() -> dict[str, Any]:
            return vars(replace(part, run=state(), follower=self._follower()))

        self._write(lambda: self._values(current()))

    def finish(self, state: dict[str, Any]) -> None:
        """Keep a finished part; see RunKeeper."""
        assert self._part is not None
        if not self._part.is_finished:
            self._done.append(replace(self._part, run=state, follower=None))

    def values(self) -> dict[str, Any]:
        """Return the record of a finished run as nested values."""
        return self._values(None) | {"follower": self._follower()}

    def _values(self, current: dict[str, Any] | None) -> dict[str, Any]:
        return {"finished": [dict(vars(part)) for part in self._done], "current": current}
