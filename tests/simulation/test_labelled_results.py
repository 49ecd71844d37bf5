"""Names, units and torques in tables, xarray and HDF5."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.cli.command_line import main
from pinred.forces import Damper, Torque, Wrench
from pinred.system.state_fields import (
    FIELDS,
    State,
    axis_labels,
    column_names,
    entry_names,
    label_entries,
)

ROBOTS = ("falling_cat", "coupled_planar", "rigid_body", "cartpole", "upright_drone", "four_bar")


def _cat() -> pinred.Trajectory:
    return pinred.simulate(
        pinred.load("falling_cat"), seed=0, duration=0.3, times=[0.0, 0.1, 0.3],
        springs={"bend": (1.0, 0.2)},
    )  # fmt: skip


@pytest.mark.parametrize("robot", ROBOTS)
def test_every_column_has_a_name_of_its_own(robot: str) -> None:
    """In plain letters, as many as there are entries; the first names are those of the model."""
    system = pinred.load(robot)
    labels = axis_labels(system)
    assert (len(labels["nq"]), len(labels["nv"])) == (system.model.nq, system.model.nv)
    names = [name for field in State.__dataclass_fields__ for name in column_names(system, field)]
    assert len(set(names)) == len(names)
    assert all(name.isascii() for name in names)
    for field in State.__dataclass_fields__:
        axis = FIELDS[field].axis
        count = 1 if axis is None else len(labels[axis])
        assert len(column_names(system, field)) == len(label_entries(system, field)) == count


@pytest.mark.parametrize("robot", ROBOTS)
def test_labels_of_model_are_those_of_its_joints(robot: str) -> None:
    """The entries of a joint in q and v are where Pinocchio has them."""
    system = pinred.load(robot)
    model, labels = system.model, axis_labels(system)
    for name, joint in zip(list(model.names)[2:], model.joints[2:], strict=True):
        q = labels["nq"][joint.idx_q : joint.idx_q + joint.nq]
        assert list(q) == ([name] if joint.nq == 1 else [f"{name}.cos", f"{name}.sin"])
        assert labels["nv"][joint.idx_v] == name


def test_csv_heads_name_the_entries(tmp_path: Path) -> None:
    """Joints, the axes of the base, and momenta; the columns are those of the trajectory."""
    traj, path = _cat(), tmp_path / "run.csv"
    traj.save(path)
    head = path.read_text().splitlines()[0].split(",")
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    column = dict(zip(head, table.T, strict=True))
    for name, values in (
        ("q.sway", traj.q[:, 8]), ("q.base.qw", traj.q[:, 6]), ("v.twist", traj.v[:, 8]),
        ("v.base.wz", traj.v[:, 5]), ("xi.vx", traj.xi[:, 0]), ("xi.wz", traj.xi[:, 5]),
        ("body_momentum.py", traj.body_momentum[:, 1]), ("spatial_momentum.Lx",
        traj.spatial_momentum[:, 3]), ("x.bend", traj.x[:, 0]), ("pose.qx", traj.pose[:, 3]),
    ):  # fmt: skip
        np.testing.assert_array_equal(column[name], values)
    names = entry_names(traj.system, "q")
    assert names["7"] == names["bend"] == 7  # the former name of the entry


def test_xarray_has_units_long_names_and_torques() -> None:
    """The units are those of the robot's joints."""
    pytest.importorskip("xarray")
    data = _cat().to_xarray()
    assert data["x"].attrs == {"units": "rad", "long_name": "Shape"}
    assert data["t"].attrs == {"units": "s", "long_name": "Time"}
    assert data["xi"].attrs["units"] == "m/s | rad/s"
    assert data["torques"].attrs["units"] == "N·m"
    assert data["torques"].dims == ("t", "joint")
    expected = 0.2 - data["x"].sel(joint="bend")
    np.testing.assert_allclose(data["torques"].sel(joint="bend"), expected, atol=1e-14)
    assert not data["torques"].sel(joint=["sway", "twist"]).any()
    assert {variable.attrs.get("long_name", "") for variable in data.values()}.isdisjoint({""})


def test_torques_are_those_of_inverse_dynamics() -> None:
    """Of springs, dampers, torques, a wrench and a prescribed joint, by pin.rnea on all of them."""
    system = pinred.load("falling_cat", gravity=(0.0, 0.0, -2.0))
    traj = pinred.simulate(
        system, seed=3, duration=0.6, times=np.linspace(0.1, 0.5, 5), rtol=1e-12, atol=1e-13,
        springs={"bend": (2.0, 0.3)}, prescribed={"twist": "0.4*sin(3*t)"},
        forces=[Damper("sway", 0.3), Torque(lambda s: {"bend": -0.2 * s.pose["qx"]}),
                Wrench(lambda s: [0, 0, 0.1, 0.02 * s.x["bend"], 0, 0])],
    )  # fmt: skip
    h, model, data = 1e-5, system.model, system.model.createData()
    for k, t in enumerate(traj.t):
        before, now, after = traj(t - h), traj(t), traj(t + h)
        effort = pin.rnea(model, data, now.q, now.v, (after.v - before.v) / (2.0 * h))
        np.testing.assert_allclose(traj.torques[k], effort[6:], rtol=0, atol=2e-8)
    assert np.abs(traj.torques).min(axis=0).max() > 1e-3
    twist = system.shape_names.index("twist")
    assert np.abs(traj.torques[:, twist]).max() > 0.05


def test_hdf5_has_arrays_units_labels_and_the_robot(tmp_path: Path) -> None:
    """Dimensions are scales, as readers of netCDF expect them."""
    h5py = pytest.importorskip("h5py")
    traj, path = _cat(), tmp_path / "run.h5"
    traj.save(path)
    with h5py.File(path) as file:
        for name in State.__dataclass_fields__:
            np.testing.assert_array_equal(file[name][...], getattr(traj.states, name))
        assert file["xdot"].attrs["units"] == "rad/s"
        assert file["energy"].attrs["long_name"].startswith("Kinetic and potential energy")
        assert [list(dim.keys()) for dim in file["q"].dims] == [["t"], ["nq"]]
        labels = [label.decode() for label in file["nq"][...]]
        assert labels == list(axis_labels(traj.system)["nq"])
        assert file.attrs["robot"] == "falling_cat"
        assert file.attrs["gravity"].tolist() == traj.system.gravity.tolist()


def test_hdf5_without_its_package_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is written, and the message says how to install it."""
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(pinred.MissingPackageError, match=r"HDF5 files need h5py: pip install "):
        _cat().save(tmp_path / "run.h5")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".npz", ".csv", ".h5", ".zarr"])
def test_commands_write_all_formats(
    suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`simulate` and `run` write what `save` writes, and state its size."""
    pytest.importorskip({".h5": "h5py", ".zarr": "zarr"}.get(suffix, "numpy"))
    scene = tmp_path / "scene.toml"
    scene.write_text('robot = "elroys_beanie"\n[run]\nduration = 0.1\n', encoding="utf-8")
    for words in (["run", str(scene)], ["simulate", "elroys_beanie", "--duration", "0.1"]):
        path = tmp_path / f"{words[0]}{suffix}"
        assert main([*words, "--out", str(path)]) == 0
        files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]
        size = sum(file.stat().st_size for file in files)
        assert f"written to {path} ({size / 1e3:.0f} kB)" in capsys.readouterr().out
