"""States over time as labelled arrays of other libraries: an xarray Dataset, a pandas DataFrame."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from ..common.errors import MissingPackageError

if TYPE_CHECKING:
    from ..system.system import System


def dataset(outputs: Any, system: System) -> Any:
    """Return an xarray.Dataset of a State or ShapeState over t, joints and coordinates by name.

    Of many members it is over member, too.  Raises MissingPackageError without xarray.
    """
    xarray = _needed("xarray")
    labels = _labels(system)
    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {"t": outputs.t}
    over: tuple[str, ...] = ("t",)
    if outputs.x.ndim == 3:
        over, coordinates["member"] = ("member", "t"), np.arange(len(outputs.x))
    for name, values in vars(outputs).items():
        if name == "t":
            continue
        axis, names = labels.get(name, ("", ()))
        variables[name] = ((*over, axis) if axis else over, values)
        if axis:
            coordinates[axis] = list(names)
    attributes = {"robot": system.name, "group": system.group.name}
    return xarray.Dataset(variables, coordinates, attributes)


def frame(outputs: Any, system: System) -> Any:
    """Return a pandas.DataFrame of a State or ShapeState over t, with columns such as "x.elbow".

    Of many members it is over member and t.  Raises MissingPackageError without pandas.
    """
    pandas = _needed("pandas")
    labels, columns = _labels(system), {}
    for name, values in vars(outputs).items():
        if name == "t":
            continue
        if name not in labels:
            columns[name] = np.ravel(values)
            continue
        for k, entry in enumerate(labels[name][1]):
            columns[f"{name}.{entry}"] = np.ravel(values[..., k])
    index = pandas.Index(outputs.t, name="t")
    if outputs.x.ndim == 3:
        every = [range(len(outputs.x)), outputs.t]
        index = pandas.MultiIndex.from_product(every, names=["member", "t"])
    return pandas.DataFrame(columns, index=index)


def _labels(system: System) -> dict[str, tuple[str, tuple[Any, ...]]]:
    """Return, for each field of a state, its second axis and the names along it."""
    joints, twist = ("joint", system.shape_names), ("twist", tuple(system.group.twist_names))
    return {
        "x": joints,
        "xdot": joints,
        "xi": twist,
        "body_momentum": twist,
        "spatial_momentum": twist,
        "pose": ("coordinate", tuple(system.group.pose_names)),
        "q": ("nq", tuple(range(system.model.nq))),
        "v": ("nv", tuple(range(system.model.nv))),
    }


def _needed(package: str) -> Any:
    try:
        return import_module(package)
    except ImportError as missing:
        raise MissingPackageError(
            f"this needs {package}: pip install 'pinred[{package}]'"
        ) from missing
