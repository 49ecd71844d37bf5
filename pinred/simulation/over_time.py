"""OverTime: the interface of motions whose states are known at report times."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

from ..system.state_fields import State, StateArrays, with_base
from ..system.system import System


class OverTime(StateArrays):
    """A motion whose states are known at report times, as State fields with time first."""

    @property
    @abstractmethod
    def system(self) -> System:
        """The system that moves."""

    @property
    @abstractmethod
    def _name(self) -> str:
        """Name of the motion in messages."""

    @property
    def states(self) -> State:
        """The states at the report times.  Raises InputError if the base was left out."""
        return with_base(self.outputs, self._name)

    def to_xarray(self) -> Any:
        """Return the states as an xarray.Dataset with named joints and coordinates.

        Returns:
            Dataset over t, or over member and t for the members of simulate_many.

        Raises:
            MissingPackageError: xarray is not installed.
        """
        from .labelled import dataset

        return dataset(self.outputs, self.system)

    def to_pandas(self) -> Any:
        """Return the states as a pandas.DataFrame with columns such as "x.elbow".

        Returns:
            Table with a row for each t, or for each member and t for the members of
            simulate_many.

        Raises:
            MissingPackageError: pandas is not installed.
        """
        from .labelled import frame

        return frame(self.outputs, self.system)
