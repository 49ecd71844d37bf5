"""Batches on a CUDA device, exported and through `simulate_many`.

Tests marked `device` need a device.  `-m device` selects them; they take four minutes at most.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from export_batches import BATCHES, TANGENTS, Batch, export
from host_cuda_driver import host_driver
from run_on_device import run_folder

import pinred
from pinred.common.errors import DeviceError, MissingPackageError
from pinred.kernels.device import cuda_driver


@pytest.fixture
def _device() -> None:
    """Skip a test where there is no device."""
    try:
        cuda_driver.opened_devices()
    except (DeviceError, MissingPackageError) as error:
        pytest.skip(str(error))


# --- without a device: the CPU executes the threads -----------------------------------------


def test_exported_batch_runs_without_pinred(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The members are repeated, and a wrong expectation is found."""
    driver = host_driver(monkeypatch)
    file = export(Batch("cat", "falling_cat", 0.2), tmp_path, count=6)
    (result,) = run_folder(driver, tmp_path, members=10)
    assert (result["batch"], result["members"], result["passed"]) == ("cat", 12, True)
    assert result["largest"] < 1e-13
    assert (driver.memory, driver.modules, driver.contexts) == ({}, {}, [])
    with np.load(file) as stored:
        arrays = dict(stored)
    arrays["expected0"][4, 2] += 1e-8
    np.savez(file, **arrays)
    (result,) = run_folder(driver, tmp_path, members=10)
    assert not result["passed"]
    arrays["expected0"][4, 2] = np.nan  # as a member that failed
    np.savez(file, **arrays)
    (result,) = run_folder(driver, tmp_path, members=10)
    assert not result["passed"]
    assert capsys.readouterr().out.count("FAILED") == 2


def test_exported_states_are_those_of_the_cpu(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """All fields are compared."""
    driver = host_driver(monkeypatch)
    file = export(Batch("states", "falling_cat", 0.2, fields=("x", "energy")), tmp_path, count=6)
    (result,) = run_folder(driver, tmp_path, members=10)
    assert (result["members"], result["passed"]) == (12, True)
    assert result["largest"] < 1e-13
    with np.load(file) as stored:
        arrays = dict(stored)
    assert arrays["expected0"].shape == (6, 33)
    arrays["expected1"][5, 10] += 1e-8
    np.savez(file, **arrays)
    (result,) = run_folder(driver, tmp_path, members=10)
    assert not result["passed"]


def test_exported_tangents_are_those_of_the_cpu(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Each direction of each member is a row."""
    driver = host_driver(monkeypatch)
    export(Batch("tangents", "falling_cat", 0.1, wrt=("x0", "xi0")), tmp_path, count=2)
    (result,) = run_folder(driver, tmp_path, members=20)
    assert (result["members"], result["passed"]) == (36, True)
    assert result["largest"] < 1e-12


def test_runner_imports_neither_pinred_nor_pinocchio() -> None:
    """It runs on machines that have neither."""
    code = (
        "import sys, run_on_device; "
        "assert not {'pinred', 'pinocchio', 'casadi', 'numba'} & set(sys.modules)"
    )
    here = str(Path(__file__).parent)
    subprocess.run([sys.executable, "-c", code], check=True, cwd=here, env={"PYTHONPATH": here})


# --- with a device --------------------------------------------------------------------------


@pytest.mark.device
@pytest.mark.usefixtures("_device")
def test_exported_batches_agree_with_the_cpu(tmp_path: Path) -> None:
    """The command is the one that runs on machines without pinred."""
    for batch in (*BATCHES, *TANGENTS):
        export(batch, tmp_path, 256 if batch in BATCHES else 32)
    runner = Path(__file__).with_name("run_on_device.py")
    command = [sys.executable, str(runner), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    print(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr
    results = json.loads((tmp_path / "results.json").read_text())
    assert len(results) == len(BATCHES) + len(TANGENTS)


@pytest.mark.device
@pytest.mark.usefixtures("_device")
@pytest.mark.parametrize("batch", BATCHES, ids=lambda batch: batch.name)
def test_simulate_many_on_a_device_agrees_with_the_cpu(batch: Batch) -> None:
    """All calls of the driver are those of users; a second call uses the loaded module."""
    options = batch.options(256)
    expected = pinred.simulate_many(**options)
    for _ in range(2):
        many = pinred.simulate_many(device="cuda", **options)
        assert not many.failures
        for name in ("x", "pose", "energy"):
            values = getattr(expected, name)
            scale = max(1.0, float(np.abs(values).max()))
            assert np.abs(getattr(many, name) - values).max() <= batch.bound * scale


@pytest.mark.device
@pytest.mark.usefixtures("_device")
@pytest.mark.parametrize("batch", TANGENTS, ids=lambda batch: batch.name)
def test_jacobians_on_a_device_agree_with_the_cpu(batch: Batch) -> None:
    """All calls of the driver are those of users."""
    columns, inputs = batch.columns(), batch.inputs(32)
    expected = columns.jacobians(*inputs)
    for found, slopes in zip(columns.jacobians(*inputs, device="cuda"), expected, strict=True):
        assert np.abs(found - slopes).max() <= batch.bound * max(1.0, np.abs(slopes).max())
