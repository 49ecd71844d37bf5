"""OverTime: states at report times, also as an xarray.Dataset or a pandas.DataFrame."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np

from ..common.argument_kinds import checks_arguments
from ..common.optional_packages import install_command, optional_package
from ..system.state_fields import (
    FIELDS,
    State,
    StateArrays,
    arrays_of,
    axis_labels,
    dimension,
    field_attributes,
    with_base,
)
from ..system.system import System
from .impacts import impact_arrays


@checks_arguments
class OverTime(StateArrays):
    """A motion with known states at the report times: fields of State, with time as first axis."""

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
        """Return the states as an xarray.Dataset with named joints, units and long names.

        Trajectories have `torques` of the joints, too.  The columns of impacts at joint stops are
        variables over impact, such as `impact_t`, if there are any.

        Returns:
            Dataset over t, or over member and t for the members of simulate_many.
        Raises:
            MissingPackageError: xarray is not installed.
        """
        outputs, system = self.outputs, self.system
        xarray = _import_package("xarray")
        labels = axis_labels(system)
        variables: dict[str, Any] = {}
        coordinates: dict[str, Any] = {"t": ("t", outputs.t, field_attributes(system, "t"))}
        leading: tuple[str, ...] = ("t",)
        if outputs.x.ndim == 3:
            leading, coordinates["member"] = ("member", "t"), np.arange(len(outputs.x))
        for name, values in arrays_of(outputs).items():
            axis = FIELDS[name].axis
            if name == "t":
                continue
            if axis is None:
                variables[name] = (leading, values, field_attributes(system, name))
                continue
            last = dimension(system, axis)
            variables[name] = ((*leading, last), values, field_attributes(system, name))
            coordinates[last] = list(labels[axis])
        variables |= self._further_variables()
        for name, values in impact_arrays(getattr(self, "impacts", None)).items():
            dims = ("impact", dimension(system, "twist"))[: values.ndim]
            variables[name] = (dims, values, {"units": "s"} if name == "impact_t" else {})
        attributes = {"robot": system.name, "group": system.group.name}
        return xarray.Dataset(variables, coordinates, attributes)

    def _further_variables(self) -> dict[str, Any]:
        """Return variables of to_xarray besides the fields: {name: (dimensions, values, …)}."""
        return {}

    def to_pandas(self) -> Any:
        """Return the states as a pandas.DataFrame with columns such as "x.elbow".

        Returns:
            Table with a row for each t, or for each member and t for the members of
            simulate_many.
        Raises:
            MissingPackageError: pandas is not installed.
        """
        outputs = self.outputs
        pandas = _import_package("pandas")
        labels, columns = axis_labels(self.system), {}
        for name, values in arrays_of(outputs).items():
            axis = FIELDS[name].axis
            if axis:
                for k, label in enumerate(labels[axis]):
                    columns[f"{name}.{label}"] = np.ravel(values[..., k])
            elif name != "t":
                columns[name] = np.ravel(values)
        index = pandas.Index(outputs.t, name="t")
        if outputs.x.ndim == 3:
            index = pandas.MultiIndex.from_product(
                [range(len(outputs.x)), outputs.t], names=["member", "t"]
            )
        return pandas.DataFrame(columns, index=index)


def _import_package(package: str) -> Any:
    return optional_package(package, f"this needs {package}: {install_command(package)}")
