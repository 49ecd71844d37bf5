"""States over time as labelled arrays: an xarray.Dataset or a pandas.DataFrame."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from ..common.errors import MissingPackageError
from ..system.state_fields import FIELDS, ShapeState, State, arrays_of, axis_labels
from ..system.system import System


def dataset(outputs: State | ShapeState, system: System) -> Any:
    """Return an xarray.Dataset over t, or over member and t, with named joints and coordinates.

    Raises MissingPackageError if xarray is not installed.
    """
    xarray = _import_package("xarray")
    labels = axis_labels(system)
    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {"t": outputs.t}
    leading: tuple[str, ...] = ("t",)
    if outputs.x.ndim == 3:
        leading, coordinates["member"] = ("member", "t"), np.arange(len(outputs.x))
    for name, values in arrays_of(outputs).items():
        axis = FIELDS[name].axis
        if name == "t":
            continue
        variables[name] = ((*leading, axis) if axis else leading, values)
        if axis:
            coordinates[axis] = list(labels[axis])
    attributes = {"robot": system.name, "group": system.group.name}
    return xarray.Dataset(variables, coordinates, attributes)


def frame(outputs: State | ShapeState, system: System) -> Any:
    """Return a pandas.DataFrame over t, or over member and t, with columns such as "x.elbow".

    Raises MissingPackageError if pandas is not installed.
    """
    pandas = _import_package("pandas")
    labels, columns = axis_labels(system), {}
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
    try:
        return import_module(package)
    except ImportError as missing:
        raise MissingPackageError(
            f"this needs {package}: pip install 'pinred[{package}]'"
        ) from missing
