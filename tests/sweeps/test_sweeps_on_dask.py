"""Sweeps on a real scheduler and workers, whose processes are killed."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinred
from pinred.forces import Torque

distributed = pytest.importorskip("distributed")
from dask_cluster import ROOT, DaskCluster  # noqa: E402

CAT = pinred.load("falling_cat")
SCENE = pinred.Scene(
    system=CAT, duration=0.5, rtol=1e-6, atol=1e-8, momentum=0, xdot0=[0.5, -0.3, 0.2],
    forces=[Torque(lambda _t, x, _xdot, _mu: {"bend": -0.1 * x["bend"]})],
)  # fmt: skip
VARY = {"front.mass": pinred.Normal(1.0, 0.4)}
OPTIONS: dict[str, Any] = {
    "points": 900, "block": 30,
    "outputs": {"pose": "pose", "turn": lambda many: many.pose[:, -1, 3]},
}  # fmt: skip

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::pinred.RejectedWarning"),
]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    """A scheduler with two workers that share the kernel cache."""
    folder = tmp_path_factory.mktemp("dask")
    cluster = DaskCluster(folder)
    try:
        cluster.add_worker()
        cluster.add_worker()
        yield cluster
    finally:
        cluster.close()


def files_of(folder: Path) -> dict[str, bytes]:
    """Return all files of a store, temporary ones included."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_killed_worker_changes_no_bit(cluster: DaskCluster, tmp_path: Path) -> None:
    """A worker that is killed in the middle is replaced by the other one.

    All files equal those of a local run, no temporary file is left, and a further run has no
    block to do. The workers print no warnings.
    """
    killed: list[float] = []

    def kill(part: float) -> None:
        if part > 0.1 and not killed:
            killed.append(part)
            os.kill(cluster.workers[0].pid, signal.SIGKILL)

    path = tmp_path / "dask.zarr"
    pinred.sweep(SCENE, VARY, store=path, scheduler=cluster.address, progress=kill, **OPTIONS)
    assert killed
    assert killed[0] < 0.9
    pinred.sweep(SCENE, VARY, store=tmp_path / "local.zarr", **OPTIONS)
    assert files_of(path) == files_of(tmp_path / "local.zarr")
    again: list[float] = []
    result = pinred.sweep(
        SCENE, VARY, store=path, scheduler=cluster.address, progress=again.append, **OPTIONS
    )
    assert again == [1.0]
    assert {1, 3} == set(np.unique(result["status"].values).tolist())
    assert "Warning" not in cluster.logs()


@pytest.mark.by_hand("many.md")
@pytest.mark.parametrize("page", ["sweeps.md", "many.md"])
def test_documented_histograms_are_equal_on_a_cluster(
    page: str, cluster: DaskCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The histogram of a page has ten lines, and one more on a cluster, with equal numbers."""
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    local = re.findall(r"```python\n(.*?)```", text, re.DOTALL)[0]
    line = '    scheduler="tcp://host:8786",\n)\npinred.plot'
    remote = local.replace(")\npinred.plot", line)
    assert (local.count("\n"), remote.count("\n")) == (10, 11)
    assert page == "many.md" or f"```python\n{remote}```" in text
    results = []
    for code in (local, remote.replace("tcp://host:8786", cluster.address)):
        names: dict[str, Any] = {}
        exec(compile(code, page, "exec"), names)
        results.append(names["result"])
        assert Path("turn.png").stat().st_size > 5000
        Path("turn.png").unlink()
    assert results[0].identical(results[1])
    assert np.ptp(results[0][next(iter(results[0].data_vars))].values) > 0.0


def test_errors_of_workers_reach_the_driver(cluster: DaskCluster, tmp_path: Path) -> None:
    """An error of pinred is raised with its message; a Client is accepted and stays open."""
    with distributed.Client(cluster.address, set_as_default=False) as client:
        vary = {"front.mass": [1.0, 2.0]}
        result = pinred.sweep(SCENE, vary, outputs=["x"], scheduler=client)
        assert result["status"].values.tolist() == [1, 1]
        assert client.status == "running"
    with pytest.raises(pinred.ShapeError, match="'turn' must return one row"):
        pinred.sweep(
            SCENE, VARY, points=60, block=30, outputs={"turn": lambda _: np.zeros(2)},
            store=tmp_path / "s.zarr", scheduler=cluster.address,
        )  # fmt: skip


def test_workers_of_another_version_are_refused(
    cluster: DaskCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker with another version computes nothing, and no store is left."""
    from pinred.sweeps import dask_engine

    monkeypatch.setattr(dask_engine, "__version__", "99.0")
    words = rf"a worker has pinred {pinred.__version__}, but the driver has 99\.0"
    with pytest.raises(pinred.InputError, match=words):
        pinred.sweep(
            SCENE, VARY, points=60, block=30, outputs={"turn": lambda _: np.zeros(2)},
            store=tmp_path / "s.zarr", scheduler=cluster.address,
        )  # fmt: skip
    assert not list(tmp_path.iterdir())


def test_schedulers_that_do_not_exist_are_rejected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The message says how to start a scheduler."""
    from pinred.sweeps import dask_engine

    monkeypatch.setattr(dask_engine, "_PATIENCE", "0.2s")
    for scheduler, words in (
        ("tcp://127.0.0.1:9", "Start one with `dask scheduler`"),
        (3, "expected an address such as"),
    ):
        with pytest.raises(pinred.InputError, match=words):
            pinred.sweep(
                SCENE, VARY, points=2, outputs=["x"], store=tmp_path / "s.zarr", scheduler=scheduler
            )


DRIVER = """
import sys
sys.path[:0] = [{tests!r}, {helpers!r}]
import pinred
from test_sweeps_on_dask import OPTIONS, SCENE, VARY
def report(part):
    print(part, flush=True)
pinred.sweep(SCENE, VARY, store={store!r}, scheduler={scheduler!r}, progress=report, **OPTIONS)
"""


@pytest.mark.by_hand
def test_killed_driver_continues_with_the_same_bits(cluster: DaskCluster, tmp_path: Path) -> None:
    """After a driver is killed, another one computes the missing blocks, with the same bits.

    One of the workers has a kernel cache of its own.
    """
    cluster.add_worker(PINRED_CACHE_DIR=str(tmp_path / "cache"))
    path = tmp_path / "dask.zarr"
    values = {
        "tests": str(Path(__file__).parent), "helpers": str(ROOT / "tests/helpers"),
        "store": str(path), "scheduler": cluster.address,
    }  # fmt: skip
    driver = subprocess.Popen(
        [sys.executable, "-c", DRIVER.format(**values)], stdout=subprocess.PIPE, text=True, cwd=ROOT
    )
    assert driver.stdout is not None
    for line in driver.stdout:
        if float(line) > 0.2:
            break
    driver.kill()
    driver.communicate()
    missing = 30 - len(list(path.glob("status/c/*")))
    assert 0 < missing < 30
    time.sleep(1.0)
    seen: list[float] = []
    pinred.sweep(
        SCENE, VARY, store=path, scheduler=cluster.address, progress=seen.append, **OPTIONS
    )
    assert len(seen) == missing + 1
    pinred.sweep(SCENE, VARY, store=tmp_path / "local.zarr", **OPTIONS)
    assert files_of(path) == files_of(tmp_path / "local.zarr")
