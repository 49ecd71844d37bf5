"""States over time as labelled arrays of other libraries: an xarray Dataset, a pandas DataFrame."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from ..common.errors import MissingPackageError
from ..system.state_fields import FIELDS, ShapeState, State, arrays_of, axis_labels
from ..system.system import System


def dataset(outputs: State | ShapeState, system: System) -> Any:
    """Return an xarray.Dataset of a State or ShapeState over t, joints and coordinates by name.

    Of many members it is over member, too.  Raises MissingPackageError without xarray.
    """
    xarray = _needed("xarray")
    labels = axis_labels(system)
    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {"t": outputs.t}
    over: tuple[str, ...] = ("t",)
    if outputs.x.ndim == 3:
        over, coordinates["member"] = ("member", "t"), np.arange(len(outputs.x))
    for name, values in arrays_of(outputs).items():
        axis = FIELDS[name].axis
        if name == "t":
            continue
        variables[name] = ((*over, axis) if axis else over, values)
        if axis:
            coordinates[axis] = list(labels[axis])
    attributes = {"robot": system.name, "group": system.group.name}
    return xarray.Dataset(variables, coordinates, attributes)


def frame(outputs: State | ShapeState, system: System) -> Any:
    """Return a pandas.DataFrame of a State or ShapeState over t, with columns such as "x.elbow".

    Of many members it is over member and t.  Raises MissingPackageError without pandas.
    """
    pandas = _needed("pandas")
    labels, columns = axis_labels(system), {}
    for name, values in arrays_of(outputs).items():
        axis = FIELDS[name].axis
        if axis:
            for k, entry in enumerate(labels[axis]):
                columns[f"{name}.{entry}"] = np.ravel(values[..., k])
        elif name != "t":
            columns[name] = np.ravel(values)
    index = pandas.Index(outputs.t, name="t")
    if outputs.x.ndim == 3:
        every = [range(len(outputs.x)), outputs.t]
        index = pandas.MultiIndex.from_product(every, names=["member", "t"])
    return pandas.DataFrame(columns, index=index)


def _needed(package: str) -> Any:
    try:
        return import_module(package)
    except ImportError as missing:
        raise MissingPackageError(
            f"this needs {package}: pip install 'pinred[{package}]'"
        ) from missing
