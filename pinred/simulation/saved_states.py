"""OverTime: states at report times, also as an xarray.Dataset, a pandas.DataFrame or a file.

The formats of files are .npz, .csv, HDF5 (.h5), .zarr, and keyframes of MuJoCo (.xml).
"""

from __future__ import annotations

import json
from abc import abstractmethod
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..common.argument_kinds import checks_arguments
from ..common.errors import LoadError, install_command, optional_package
from ..common.files import (
    check_path,
    create_array,
    create_group,
    import_zarr,
    open_group,
    replace_folder,
    write_atomic,
)
from ..common.names import quoted_path
from ..system.body_parameters import name_in_files
from ..system.locked_joints import LockValue
from ..system.model_parameters import GRAVITY
from ..system.robot_file_contents import Origin
from ..system.state_fields import (
    FIELDS,
    State,
    StateArrays,
    arrays_of,
    axis_labels,
    column_names,
    dimension,
    field_attributes,
    with_base,
)
from ..system.system import System, nominal
from .impacts import ImpactTable, impact_arrays


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


SUFFIXES, FOLDERS = (".npz", ".csv", ".h5", ".zarr", ".xml"), (".zarr",)  # formats, and folders


def save(traj: OverTime, path: str | Path) -> None:
    """Write the states of a motion at its report times; no partial file remains after a failure.

    .npz contains one array for each field of State, with time as first axis, and `robot`, `group`
    and `joints`.  The arrays `source`, `lock_joints`, `lock_sizes`, `lock_values`, `gravity`,
    `root`, `balls` and `parameter_names`, `parameter_sizes`, `parameter_values` state how load()
    finds the robot; `derivation` is a JSON text that states how it was joined or cut.
    The arrays `impact_t`, `impact_joint` and so on are the columns of the impacts.
    .csv has a row for each time and columns such as `pose.x`, `x.hinge`, `xi.vx` and `energy`.
    .h5 (HDF5, written by h5py) has the arrays of .zarr with names of dimensions, labels, units and
    long names, as xarray and netCDF readers understand them.
    .zarr is a folder with the arrays of .npz, dimension names, and texts as its attributes; an
    existing one is replaced.
    .xml has a keyframe of MuJoCo for each time; the robot must be from an MJCF file.

    InputError is raised for another suffix or a folder that does not exist, OutputError if
    writing fails, and MissingPackageError if h5py or zarr is not installed.

    Args:
        traj: A Trajectory or a Recording.
        path: Path of the file; its suffix selects the format.
    """
    path = check_path(path, SUFFIXES, folders=FOLDERS)
    if path.suffix == ".zarr":
        write_zarr(path, _arrays(traj), traj.system)
        return
    if path.suffix == ".h5":
        optional_package("h5py", f"HDF5 files need h5py: {install_command('hdf5')}")
    write = {
        ".npz": _write_npz, ".csv": _write_csv, ".h5": _write_hdf5, ".xml": _write_keyframes,
    }[path.suffix]  # fmt: skip
    write_atomic(path, lambda file: write(traj, file))


def _write_npz(traj: OverTime, file: BinaryIO) -> None:
    np.savez_compressed(file, **_arrays(traj))


def _write_keyframes(traj: OverTime, file: BinaryIO) -> None:
    from ..system.mjcf.keyframe_export import write_keyframes

    states = traj.states
    keyframes = zip(states.t.tolist(), states.pose, states.x, states.xi, states.xdot, strict=True)
    file.write(write_keyframes(traj.system, keyframes).encode())


def _arrays(traj: OverTime) -> dict[str, Any]:
    arrays = {**robot_arrays(traj.system), **arrays_of(traj.outputs)}
    table: ImpactTable | None = getattr(traj, "impacts", None)
    return arrays | impact_arrays(table)


def robot_arrays(system: System) -> dict[str, Any]:
    """Return the arrays that name a robot and record how load() finds it.

    Gravity and locked joints are stored with their current values, including changes by parameters.
    """
    origin = system.origin
    lock = dict({} if origin is None else origin.lock)
    loaded = nominal(system)
    parameters = {name_in_files(loaded, n): value for n, value in system.parameters.items()}
    for name in system.parameters:
        if name.endswith(".lock"):
            lock[name.removesuffix(".lock")] = float(parameters.pop(name))
        elif name in GRAVITY:
            del parameters[name]
    root = {} if origin is None or origin.root is None else {"root": np.array(origin.root)}
    merged = [triple.name for triple in system.contents.merged]
    return {
        "robot": np.array(system.name),
        "group": np.array(system.group.name),
        "joints": np.array(system.shape_names, dtype=str),
        **({"coordinates": np.array(system.x_names, dtype=str)} if system.space.balls else {}),
        "source": np.array("" if origin is None else origin.source),
        **_lock_arrays(lock),
        "gravity": system.gravity,
        **root,
        **({"balls": np.array(merged, dtype=str)} if merged else {}),
        **_parameter_arrays(parameters),
        **_derivation_array(origin),
    }


def _derivation_array(origin: Origin | None) -> dict[str, Any]:
    """Return how a system was made from others, as an array with one JSON text."""
    if origin is None or origin.derivation is None:
        return {}
    source = origin.derivation
    systems = []
    for system in source.systems:
        entries = {name: value.tolist() for name, value in robot_arrays(system).items()}
        if system.origin is not None and system.origin.text is not None:
            entries["text"] = system.origin.text
        systems.append(entries)
    recipe = {"function": source.function, "arguments": dict(source.arguments), "systems": systems}
    return {"derivation": np.array(json.dumps(recipe, ensure_ascii=False))}


def _lock_arrays(lock: Mapping[str, LockValue]) -> dict[str, Any]:
    """Return the names and values of locked joints, and the sizes unless all are 1."""
    entries = [np.atleast_1d(value) for value in lock.values()]
    sizes = np.array([len(array) for array in entries], dtype=int)
    return {
        "lock_joints": np.array(list(lock), dtype=str),
        "lock_values": np.concatenate([np.empty(0), *entries]),
        **({"lock_sizes": sizes} if (sizes > 1).any() else {}),
    }


def lock_in(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the locked joints in the arrays of a file, {joint: number or list of numbers}.

    Args:
        content: Arrays of a file by name.  Without sizes, each joint has one number.
    Returns:
        The values of the locked joints.
    Raises:
        ValueError: The lengths of the names, sizes and values do not match.
    """
    names = np.atleast_1d(content.get("lock_joints", ()))
    sizes = content.get("lock_sizes", np.ones(len(names), dtype=int))
    arrays = _split("locked joints", names, sizes, content.get("lock_values", ()))
    return {
        name: float(values[0]) if len(values) == 1 else values.tolist()
        for name, values in arrays.items()
    }


def _split(what: str, names: Any, sizes: Any, values: Any) -> dict[str, Any]:
    """Split values, (sum of sizes,), into an array for each name.  Raises ValueError."""
    names = [str(name) for name in np.atleast_1d(names)]
    sizes = [int(size) for size in np.atleast_1d(sizes)]
    values = np.ravel(np.asarray(values, dtype=float))
    if len(names) != len(sizes) or min(sizes, default=1) < 1 or sum(sizes) != len(values):
        raise ValueError(f"the names, sizes and values of its {what} are inconsistent")
    arrays = np.split(values, np.cumsum(sizes)[:-1]) if names else []
    return dict(zip(names, arrays, strict=True))


def _parameter_arrays(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the names of parameters, the number of entries of each, and all entries."""
    if not values:
        return {}
    entries = [np.ravel(value) for value in values.values()]
    return {
        "parameter_names": np.array(list(values), dtype=str),
        "parameter_sizes": np.array([len(array) for array in entries]),
        "parameter_values": np.concatenate(entries).astype(float),
    }


def parameters_in(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the robot parameters in the arrays of a file, {name: values}.

    Args:
        content: Arrays of a file by name.
    Returns:
        The values of each parameter, (size,).
    Raises:
        ValueError: The lengths of the names, sizes and values do not match.
    """
    names, sizes, values = (
        content.get(f"parameter_{what}", ()) for what in ("names", "sizes", "values")
    )
    return _split("parameters", names, sizes, values)


def _write_csv(traj: OverTime, file: BinaryIO) -> None:
    names, columns = [], []
    for name, values in arrays_of(traj.outputs).items():
        names += column_names(traj.system, name)
        columns.append(values)
    header = ",".join(map(_quote_for_csv, names))
    table = np.column_stack(columns)
    np.savetxt(file, table, fmt="%.17g", delimiter=",", header=header, comments="")


def _write_hdf5(traj: OverTime, file: BinaryIO) -> None:
    import h5py

    system, arrays = traj.system, _arrays(traj)
    stored = {name: array for name, array in arrays.items() if name in FIELDS and array.size}
    labels = {dimension(system, axis): names for axis, names in axis_labels(system).items()}
    buffer = BytesIO()  # HDF5 reads what it has written.
    with h5py.File(buffer, "w") as root:
        for name in arrays.keys() - stored.keys():
            if name.startswith("impact_"):  # attributes hold 64 kB at most
                dtype = h5py.string_dtype() if arrays[name].dtype.kind == "U" else float
                root.create_dataset(name, data=arrays[name].tolist(), dtype=dtype)
            else:
                root.attrs[name] = arrays[name].tolist()
        for name, array in stored.items():
            data = root.create_dataset(name, data=array)
            data.attrs.update(field_attributes(system, name))
            if name == "t":  # "t" is the first of the fields.
                data.make_scale("t")
                continue
            for k, dim in enumerate(_dims_of(name, array, system, 0)):
                if dim not in root:
                    texts = [str(label) for label in labels[dim]]
                    root.create_dataset(dim, data=texts, dtype=h5py.string_dtype())
                    root[dim].make_scale(dim)
                data.dims[k].attach_scale(root[dim])
    file.write(buffer.getvalue())


def _split_arrays(arrays: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return arrays of floats, and texts, whole numbers and empty arrays, which are attributes."""
    stored = {n: a for n, a in arrays.items() if a.ndim and a.size and a.dtype.kind == "f"}
    return stored, {name: array.tolist() for name, array in arrays.items() if name not in stored}


def _quote_for_csv(name: str) -> str:
    """Return a column name, in quotes if it contains a separator, quote or line break."""
    if not any(mark in name for mark in ',"\r\n'):
        return name
    return '"' + name.replace('"', '""') + '"'


def write_zarr(path: Path, arrays: dict[str, Any], system: System) -> None:
    """Write arrays to a zarr folder (format 3), which gets its final name when it is complete.

    Arrays name their dimensions, so that xarray reads them with labels and units.

    Args:
        path: Path of the folder; an existing zarr folder is replaced.
        arrays: Arrays by name; texts, whole numbers and empty arrays become attributes.
        system: The robot, whose labels become coordinates.
    Raises:
        InputError: Something else than a zarr folder has this name.
        MissingPackageError: zarr is not installed.
        OutputError: Writing fails.
    """
    import_zarr(path)
    members = len(arrays["x"]) if np.ndim(arrays["x"]) == 3 else 0
    dims = {name: _dims_of(name, array, system, members) for name, array in arrays.items()}
    stored, others = _split_arrays(arrays)
    labels = {dimension(system, axis): names for axis, names in axis_labels(system).items()}

    def write(folder: Path) -> None:
        root = create_group(folder, others)
        for name, array in stored.items():
            attributes = field_attributes(system, name) if name in FIELDS else {"units": ""}
            create_array(root, name, dims[name], attributes, data=np.ascontiguousarray(array))
        for dim in sorted({entry for name in stored for entry in dims[name]} & labels.keys()):
            texts = np.array([str(label) for label in labels[dim]], dtype=object)
            coordinate = create_array(root, dim, (dim,), {}, shape=texts.shape, dtype="string")
            coordinate[:] = texts

    replace_folder(path, write)


def _dims_of(name: str, array: Any, system: System, members: int) -> tuple[str, ...]:
    """Return the names of the dimensions of an array in a file."""
    leading: tuple[str, ...]
    if name in FIELDS:
        axis = FIELDS[name].axis
        leading = ("t",) if name == "t" or not members else ("member", "t")
        return leading if axis is None else (*leading, dimension(system, axis))
    if name.startswith("impact_"):
        leading = ("impact",)
    else:
        leading = ("member",) if members and np.shape(array)[:1] == (members,) else ()
    return (*leading, *(f"{name}_{k}" for k in range(len(leading), np.ndim(array))))


def read_zarr(path: Path, most: int) -> dict[str, Any]:
    """Return the arrays of a zarr folder that `write_zarr` wrote, texts included.

    Args:
        path: Path of the folder.
        most: Largest accepted size of all arrays together [bytes].
    Returns:
        The arrays by name.
    Raises:
        LoadError: The folder cannot be read, or is too large.
        MissingPackageError: zarr is not installed.
    """
    try:
        root = open_group(path)
        found = {name: array for name, array in root.arrays() if array.dtype.kind == "f"}
        if (size := sum(array.nbytes for array in found.values())) > most:
            raise LoadError(
                f"{quoted_path(path)} would take {size / 1e9:.3g} GB; read it by xarray"
            )
        arrays = {name: np.asarray(array[...]) for name, array in found.items()}
        return {name: np.array(value) for name, value in root.attrs.items()} | arrays
    except (OSError, ValueError, KeyError, TypeError, RuntimeError) as error:
        raise LoadError(f"{quoted_path(path)} cannot be read: {error}") from None
