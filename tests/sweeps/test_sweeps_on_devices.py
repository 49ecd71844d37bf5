"""Sweeps on CUDA devices, whose threads the CPU executes, here and on workers of Dask."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from host_cuda_driver import host_driver

import pinred
from pinred.cli.command_line import main
from pinred.common.errors import DeviceError, InputError
from pinred.kernels.device import cuda_driver
from pinred.sweeps.sweep_result import SweepResult

CAT = pinred.load("falling_cat")
OUTPUTS = ["x", "pose", "energy"]

pytestmark = pytest.mark.filterwarnings("ignore::pinred.RejectedWarning")


def _sweep(store: Path, **options: Any) -> SweepResult:
    """Return a sweep over masses, one of which is negative."""
    scene = pinred.Scene(
        system=CAT, duration=0.2, method="DOP853(rtol=1e-9, atol=1e-9)", momentum=0,
        xdot0=[0.5, -0.3, 0.2],
    )  # fmt: skip
    masses = [1.0, 1.2, -1.0, 1.4, 0.7]
    return pinred.sweep(
        scene, {"front.mass": masses}, outputs=OUTPUTS, store=store, block=2, **options
    )


def test_points_on_a_device_agree_with_the_cpu(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A store names what computed its blocks, and the CPU continues the sweep of a device."""
    driver = host_driver(monkeypatch)
    device = _sweep(tmp_path / "device.zarr", device="cuda")
    # The second block has one point, because a mass is rejected; states follow the motion.
    assert [size for _, size in driver.launched] == [2, 2, 1, 1, 1, 1]
    cpu = _sweep(tmp_path / "cpu.zarr")
    for name in OUTPUTS:
        np.testing.assert_allclose(device[name], cpu[name], rtol=0, atol=1e-12, err_msg=name)
    assert device.cpus == {"cuda": 3}
    assert device["status"].values.tolist() == [1, 1, 3, 1, 1]
    again = _sweep(tmp_path / "device.zarr")
    assert again.cpus == {"cuda": 3}


def test_command_sweeps_on_a_device(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The option is that of the function."""
    driver = host_driver(monkeypatch)
    scene, store = tmp_path / "scene.toml", tmp_path / "sweep.zarr"
    scene.write_text(
        'robot = "falling_cat"\nrun = { duration = 0.1, method = "DOP853" }\n'
        "start = { momentum = 0, xdot0 = [0.5, -0.3, 0.2] }\n"
    )
    vary = ["--vary", "front.mass=Values([1.0, 1.5])", "--outputs", "x"]
    assert main(["sweep", str(scene), *vary, "--store", str(store), "--device", "cuda"]) == 0
    assert [size for _, size in driver.launched] == [2, 2]
    assert pinred.open_sweep(store).cpus == {"cuda": 1}


def test_points_on_devices_of_dask_workers_agree_with_the_cpu(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Two threads of a worker take turns on its devices; errors of devices reach the caller."""
    distributed = pytest.importorskip("distributed")
    driver = host_driver(monkeypatch)
    driver.capabilities = [(9, 0), (9, 0)]
    monkeypatch.setattr(cuda_driver, "LEAST", 1)
    cluster = distributed.Client(
        processes=False, n_workers=1, threads_per_worker=2, dashboard_address=None,
        set_as_default=False,
    )  # fmt: skip
    with cluster as client:
        device = _sweep(tmp_path / "device.zarr", device="cuda", scheduler=client)
        assert {place for place, _ in driver.launched} == {"context of 0", "context of 1"}
        driver.limit = 0
        with pytest.raises(DeviceError, match="CUDA_ERROR_OUT_OF_MEMORY"):
            _sweep(tmp_path / "full.zarr", device="cuda", scheduler=client)
    cpu = _sweep(tmp_path / "cpu.zarr")
    for name in OUTPUTS:
        np.testing.assert_allclose(device[name], cpu[name], rtol=0, atol=1e-12, err_msg=name)
    assert device.cpus == {"cuda": 3}
    assert (driver.memory, driver.streams, driver.contexts) == ({}, {}, [])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"device": "gpu"}, "device: expected None or 'cuda', got 'gpu'"),
        ({"threads": 2}, "threads: expected None with a device, got 2"),
        ({"method": "Gauss(0.1)"}, "method: expected DOP853 or Tsit5 on a device, got Gauss"),
        (
            {"events": [pinred.Event("x['bend'] - 0.1", "bent")]},
            "expected members that share a kernel, got 7 that are simulated one by one",
        ),
    ],
)
def test_sweeps_that_no_device_computes_are_refused_before_the_store(
    options: dict[str, Any], message: str, tmp_path: Path
) -> None:
    """A device would find out after hours."""
    own = {name: options.pop(name) for name in ("method", "events") if name in options}
    scene = pinred.Scene(system=CAT, duration=0.2, **own)
    store = tmp_path / "sweep.zarr"
    options = {"device": "cuda", **options}
    with pytest.raises(InputError, match=re.escape(message)):
        pinred.sweep(scene, {"front.mass": np.arange(1.0, 8.0)}, store=store, **options)
    assert not store.exists()
