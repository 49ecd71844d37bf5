"""sweep(): results, resumption, failures, and errors."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray

import pinred
from pinred.forces import Damper, Torque

CAT = pinred.load("falling_cat")
GAIN = pinred.Parameter("gain", 0.1)
SCENE = pinred.Scene(
    system=CAT, duration=0.5, rtol=1e-6, atol=1e-8, momentum=0, xdot0=[0.5, -0.3, 0.2],
    forces=[Damper("bend", GAIN)], springs={"sway": (1.0, 0.0)},
)  # fmt: skip
VARY = {"front.mass": pinred.Uniform(0.5, 2.0), "x0.bend": "Grid(-1, 1, 50)", "gain": [0.1, 0.2]}
OUTPUTS = {"pose": "pose", "bend": "x.bend", "energy": "energy(t)"}


def numbers_of(folder: Path) -> dict[str, bytes]:
    """Return all files of a store but its pickled scene, whose bytes depend on the process."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.suffix != ".signed"
    }


def test_results_are_those_of_simulate(tmp_path: Path) -> None:
    """Values, labels, units and outputs agree with `simulate` of each point."""
    result = pinred.sweep(
        SCENE, VARY, points=40, outputs=OUTPUTS, store=tmp_path / "s.zarr", block=16
    )
    assert isinstance(result, xarray.Dataset)
    assert result["pose"].dims == ("point", "coordinate")
    assert result["energy"].dims == ("point", "t")
    assert result["coordinate"].values.tolist() == list(CAT.group.pose_names)
    assert result["front.mass"].attrs["units"] == "kg"
    assert result["x0.bend"].attrs["units"] == result["bend"].attrs["units"] == "rad"
    assert set(result.coords) == {*VARY, "coordinate", "t"}
    assert list(result.data_vars) == [*OUTPUTS, "status"]
    for k in (0, 17, 39):
        values = {name: float(result[name][k]) for name in VARY}
        x0 = {"bend": values.pop("x0.bend")}
        one = pinred.simulate(
            CAT, duration=0.5, rtol=1e-6, atol=1e-8, momentum=0, xdot0=[0.5, -0.3, 0.2], x0=x0,
            forces=[Damper("bend", GAIN)], springs={"sway": (1.0, 0.0)}, parameters=values,
            method="DOP853",
        )  # fmt: skip
        np.testing.assert_allclose(result["pose"][k], one.pose[-1], rtol=0, atol=1e-12)
        np.testing.assert_allclose(result["energy"][k], one.energy, rtol=1e-12)
        again = result.isel(point=slice(0, 2)).point(k)
        np.testing.assert_array_equal(again.pose[-1], result["pose"][k])
        np.testing.assert_array_equal(again.x[-1, 0], result["bend"][k])


def test_plain_xarray_reads_the_store(tmp_path: Path) -> None:
    """The store has dimension names, opens without warnings, and opens again in pinred."""
    path = tmp_path / "s.zarr"
    result = pinred.sweep(SCENE, VARY, points=5, outputs=["pose", "x"], store=path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plain = xarray.open_zarr(str(path), consolidated=False)
    assert plain.identical(xarray.Dataset(result.data_vars, result.coords, result.attrs))
    again = pinred.open_sweep(path)
    np.testing.assert_array_equal(again["pose"], result["pose"])


def test_open_sweep_simulates_points_of_own_stores_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The scene in the store gives the bits of the sweep; only the own signature is accepted."""
    path = tmp_path / "s.zarr"
    result = pinred.sweep(SCENE, VARY, points=5, outputs=["pose", "x"], store=path)
    opened = pinred.open_sweep(path)
    np.testing.assert_array_equal(opened.point(3).x[-1], result["x"][3])
    np.testing.assert_array_equal(opened.isel(point=[1]).point(3).pose[-1], result["pose"][3])
    with pytest.raises(pinred.InputError, match="whole number from 0 to 4, got 5"):
        opened.point(5)
    file = path / "plan" / "scene.signed"
    content = file.read_bytes()
    other = tmp_path / "other.zarr"
    pinred.sweep(SCENE, {"gain": [0.1, 0.2]}, outputs=["x"], store=other)
    foreign = (other / "plan" / "scene.signed").read_bytes()
    changed = content[:-1] + bytes([content[-1] ^ 1])
    monkeypatch.setattr("pinred.sweeps.sweep_job.StoredScene", _refuse_to_execute)
    for wrong in (foreign, changed, content[:40], b""):
        file.write_bytes(wrong)
        with pytest.raises(pinred.InputError, match="written or changed by another user"):
            pinred.open_sweep(path).point(0)
    file.write_bytes(content)
    monkeypatch.setattr("pinred.sweeps.sweep_job.signing_key", lambda: bytes(32))
    with pytest.raises(pinred.InputError, match="written or changed by another user"):
        pinred.open_sweep(path).point(0)
    monkeypatch.undo()
    file.write_bytes(foreign)
    pinred.sweep(SCENE, VARY, points=5, outputs=["pose", "x"], store=path)
    assert file.read_bytes() == content


def _refuse_to_execute(data: BytesIO) -> None:
    count = len(data.getvalue())
    raise AssertionError(f"{count} bytes that another user may have written are unpickled")


def test_open_sweep_says_that_a_scene_with_functions_is_not_stored(tmp_path: Path) -> None:
    """A lambda cannot be pickled; the results are stored all the same."""
    scene = replace(SCENE, forces=Torque(lambda t, x, xdot, mu: -0.1 * xdot))  # noqa: ARG005
    result = pinred.sweep(scene, {"x0.bend": [0.1, 0.2]}, outputs=["x"], store=tmp_path / "s.zarr")
    assert result.point(1).x.shape[1] == 3
    with pytest.raises(pinred.InputError, match="the scene contains functions"):
        pinred.open_sweep(tmp_path / "s.zarr").point(1)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the path of a store with one point of SCENE."""
    path = tmp_path_factory.mktemp("sweep") / "s.zarr"
    pinred.sweep(SCENE, {"x0.bend": [0.1]}, outputs=["x"], store=path)
    return path


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"duration": 0.6}, "another scene: duration is 0.5 there, and 0.6 here"),
        ({"xdot0": [0.5, -0.3, 0.25]}, "another scene: xdot0 is [0.5, -0.3, 0.2] there"),
        ({"springs": {"sway": (2.0, 0.0)}}, "another scene: numbers of springs, forces and presc"),
        ({"forces": Damper("twist", GAIN)}, "another scene: other forces."),
        ({"events": pinred.Event("x[0] - 9")}, "another scene: other events."),
        ({"parameters": {"gain": 0.3}}, "another scene: parameters.gain is none there, and 0.3"),
        ({"outputs": "shape"}, "another scene: outputs is all there, and shape here"),
        ({"times": [0.0, 0.5]}, "another scene: other times."),
        ({"system": pinred.load("falling_cat", parameters={"back.mass": 2.5})},
         "another scene: other robot."),
        ({"system": pinred.load("falling_cat", gravity=[0, 0, -1.0])},
         "another scene: gravity is [0.0, 0.0, 0.0] there, and [0.0, 0.0, -1.0] here"),
        ({"rtol": 1e-7}, "another scene: method is DOP853(rtol=1e-07, "),
    ],
)  # fmt: skip
def test_store_of_another_scene_names_the_first_difference(
    changes: dict[str, Any], words: str, written: Path
) -> None:
    """With both values, or the name of what is too long to show."""
    scene = replace(SCENE, **changes)
    with pytest.raises(pinred.InputError) as refused:
        pinred.sweep(scene, {"x0.bend": [0.1]}, outputs=["x"], store=written)
    assert words in str(refused.value)
    assert str(refused.value).endswith("Choose another name, or delete the folder")


def test_store_of_other_numbers_names_the_first_difference(written: Path) -> None:
    """Its distribution there and here, or that it is missing."""
    for vary, words in (
        (
            {"x0.bend": [0.2]},
            "other varied numbers: x0.bend is Values([0.1]) there, and Values([0.2])",
        ),
        ({"x0.bend": [0.1], "gain": [1.0]}, "other varied numbers: gain is none there"),
        ({"gain": [1.0]}, "other varied numbers: gain is none there"),
    ):
        with pytest.raises(pinred.InputError, match=re.escape(words)):
            pinred.sweep(SCENE, vary, outputs=["x"], store=written)


@pytest.mark.by_hand("True")
@pytest.mark.parametrize("broken", [False, True])
def test_interrupted_sweep_continues_with_the_same_bits(
    broken: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After an interruption, all files equal those of one run, and no block is left to do."""
    from pinred.sweeps import sweep_job, sweep_store

    arguments: dict[str, Any] = {"points": 50, "outputs": OUTPUTS, "block": 8}
    pinred.sweep(SCENE, VARY, store=tmp_path / "whole.zarr", **arguments)
    path = tmp_path / "s.zarr"
    write = sweep_store.SweepStore._write_chunk
    calls: list[str] = []

    def interrupt(self: Any, name: str, *rest: Any, **more: Any) -> None:
        calls.append(name)
        if len(calls) > 17:
            raise KeyboardInterrupt
        write(self, name, *rest, **more)

    monkeypatch.setattr(sweep_store.SweepStore, "_write_chunk", interrupt)
    with pytest.raises(KeyboardInterrupt):
        pinred.sweep(SCENE, VARY, store=path, **arguments)
    monkeypatch.undo()
    assert 0 < len(list(path.glob("status/c/*"))) < 7
    if broken:  # files that a killed process leaves
        (path / "pose/c/.pinred-0123456789abcdef.tmp").write_bytes(b"1")
        (path / "status/c/3.0123.partial").write_bytes(b"1")
    computed: list[int] = []
    compute = sweep_job.SweepJob.compute

    def count(self: Any, index: int, *rest: Any) -> Any:
        computed.append(index)
        return compute(self, index, *rest)

    monkeypatch.setattr(sweep_job.SweepJob, "compute", count)
    pinred.sweep(SCENE, VARY, store=path, **arguments)
    assert computed
    assert computed[0] > 0
    done = numbers_of(path)
    assert done == numbers_of(tmp_path / "whole.zarr")
    computed.clear()
    pinred.sweep(SCENE, VARY, store=path, **arguments)
    assert computed == []
    assert numbers_of(path) == done


def changed(**changes: Any) -> dict[str, Any]:
    """Return arguments of a sweep."""
    return {"scene": SCENE, "vary": VARY, "points": 3, "outputs": ["pose"], **changes}


def turn(many: pinred.Trajectories) -> Any:
    """Return an output."""
    return many.pose[:, -1, 3]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"scene": pinred.Scene(system=CAT, duration=0.5, forces=[Damper("bend", GAIN)])}, "scene"),
        ({"vary": VARY | {"gain": [0.1, 0.3]}}, "other varied numbers"),
        ({"points": 4}, "points=3"),
        ({"seed": 1}, "seed=0"),
        ({"outputs": ["x"]}, "other outputs"),
        ({"outputs": {"pose": turn}}, "other outputs"),
        ({"sampler": "random"}, "sampler='sobol'"),
    ],
)
def test_store_of_another_sweep_is_rejected(
    changes: dict[str, Any], words: str, tmp_path: Path
) -> None:
    """The plan in the store prevents mixing; the message names the difference."""
    path = tmp_path / "s.zarr"
    pinred.sweep(**changed(), store=path)
    before = numbers_of(path)
    with pytest.raises(pinred.InputError, match=words):
        pinred.sweep(**changed(**changes), store=path)
    assert numbers_of(path) == before


def test_functions_with_other_code_have_other_plans(tmp_path: Path) -> None:
    """A function is identified by its code, its constants and its closure."""

    def scaled(factor: float) -> Callable[[pinred.Trajectories], Any]:
        return lambda many: factor * many.energy[:, -1]

    path = tmp_path / "s.zarr"
    result = pinred.sweep(**changed(outputs={"e": scaled(2.0), "f": "energy"}), store=path)
    np.testing.assert_array_equal(result["e"], 2.0 * result["f"])
    pinred.sweep(**changed(outputs={"e": scaled(2.0), "f": "energy"}), store=path)
    with pytest.raises(pinred.InputError, match="other outputs"):
        pinred.sweep(**changed(outputs={"e": scaled(3.0), "f": "energy"}), store=path)


def test_rejected_values_become_rows_with_reasons(tmp_path: Path) -> None:
    """Negative masses of a normal law are rejected; one warning counts them."""
    path = tmp_path / "s.zarr"
    vary = {"front.mass": pinred.Normal(1.0, 1.0)}
    with pytest.warns(pinred.RejectedWarning, match="rejected of 64 points") as caught:
        result = pinred.sweep(SCENE, vary, points=64, outputs={"turn": turn}, store=path, block=16)
    assert len(caught) == 1
    assert caught[0].filename == __file__
    negative = np.flatnonzero(result["front.mass"].values <= 0.0)
    assert 5 < len(negative) < 20
    assert [failure.member for failure in result.failures] == negative.tolist()
    assert "'front.mass' must be above zero" in result.failures[0].reason
    assert np.flatnonzero(result["status"].values == 3).tolist() == negative.tolist()
    assert np.flatnonzero(np.isnan(result["turn"].values)).tolist() == negative.tolist()
    with pytest.raises(pinred.InputError, match="must be above zero"):
        result.point(int(negative[0]))
    assert sum(result.cpus.values()) == 4


def test_failing_points_have_their_reason(tmp_path: Path) -> None:
    """A point that does not reach its end has failed; a block may have no valid point."""
    system = pinred.load("coupled_planar")
    scene = pinred.Scene(system=system, x0=[0.0], duration=100.0, springs={"hinge": (-1e6, 0.0)})
    vary = {"x0.hinge": [0.0, 1.0]}
    with pytest.warns(pinred.RejectedWarning, match="1 failed of 2 points"):
        result = pinred.sweep(scene, vary, outputs=["pose"], store=tmp_path / "s.zarr")
    assert result["status"].values.tolist() == [1, 2]
    assert np.isnan(result["pose"].values).any(axis=1).tolist() == [False, True]
    with pytest.warns(pinred.RejectedWarning, match="2 rejected of 2 points"):
        result = pinred.sweep(
            SCENE, {"front.mass": [-1.0, -2.0]}, outputs={"a": turn, "b": "pose"},
            store=tmp_path / "none.zarr",
        )  # fmt: skip
    assert np.isnan(result["b"].values).all()


def test_functions_of_a_wrong_shape_are_rejected(tmp_path: Path) -> None:
    """A function returns one row for each point."""
    with pytest.raises(pinred.ShapeError, match="'turn' must return one row for each of the 3"):
        pinred.sweep(**changed(outputs={"turn": lambda _: np.zeros(2)}), store=tmp_path / "s.zarr")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"vary": {}}, "at least one number"),
        ({"vary": {"front.mas": [1.0]}}, "did you mean"),
        ({"vary": {"x0.bnd": [1.0]}}, "did you mean 'x0.bend'"),
        ({"vary": {"duration": [1.0]}}, "the same for all points; store an output over time"),
        ({"points": None, "vary": {"gain": "Uniform(0, 1)"}}, "expected a number of points"),
        ({"points": 7, "sampler": "grid", "vary": {"gain": [0.1, 0.2]}}, "the grid has 2 points"),
        ({"sampler": "sobl"}, "sobol"),
        ({"outputs": ["pos"]}, "did you mean 'pose'"),
        ({"outputs": ["pose.roll"]}, "the entries are x, y"),
        ({"outputs": []}, "at least one"),
        ({"store": "s.h5"}, "ends in .zarr"),
        ({"points": 2**31}, "sampler='random'"),
    ],
)
def test_invalid_arguments_are_rejected(changes: dict[str, Any], words: str) -> None:
    """The message names the argument, valid values and a remedy."""
    with pytest.raises(pinred.InputError, match=words):
        pinred.sweep(**changed(**changes))


def test_progress_counts_points_and_continues(tmp_path: Path) -> None:
    """The fraction starts at what is stored, and ends at 1."""
    path, seen = tmp_path / "s.zarr", list[float]()
    pinred.sweep(**changed(points=20), block=8, store=path, progress=seen.append)
    assert seen[0] == 0.0
    assert seen[-1] == 1.0
    assert seen == sorted(seen)
    (path / "status/c/2").unlink()
    seen.clear()
    pinred.sweep(**changed(points=20), block=8, store=path, progress=seen.append)
    assert (seen[0], seen[-1]) == (0.8, 1.0)
    assert json.loads((path / "plan/plan.json").read_text())["points"] == 20


def test_temporary_store_is_used_without_name() -> None:
    """Without a store, the results are in a temporary folder."""
    result = pinred.sweep(SCENE, {"gain": [0.1, 0.2]}, outputs=["x.bend"])
    assert result["x.bend"].shape == (2,)


def test_robots_with_loops_warn_once(tmp_path: Path) -> None:
    """Points of closed loops are closed; only the first block warns that they were open."""
    system = pinred.load("four_bar")
    scene = pinred.Scene(system=system, duration=0.2, seed=1)
    vary = {f"xdot0.{system.shape_names[0]}": pinred.Uniform(0.1, 0.2)}
    with pytest.warns(pinred.LoopWarning) as caught:
        result = pinred.sweep(
            scene, vary, points=6, block=2, outputs=["x"], store=tmp_path / "s.zarr"
        )
    assert len(caught) == 1
    assert result["status"].values.tolist() == [1] * 6


@pytest.mark.parametrize(
    ("package", "extra", "scheduler"),
    [("zarr", "sweep", None), ("xarray", "sweep", None), ("distributed", "dask", "tcp://a:1")],
)
def test_missing_packages_are_named_with_their_extra(
    package: str,
    extra: str,
    scheduler: str | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The message has the command that installs the package."""
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(pinred.MissingPackageError, match=rf'pip install "pinred\[{extra}\]"'):
        pinred.sweep(**changed(), store=tmp_path / "s.zarr", scheduler=scheduler)


def test_import_of_pinred_loads_no_extra() -> None:
    """Neither zarr, xarray nor dask are loaded before the first sweep."""
    code = (
        "import sys, pinred; pinred.simulate, pinred.sweep, pinred.Uniform; "
        "print({'zarr', 'xarray', 'dask', 'distributed', 'pandas'} & {*sys.modules})"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "set()"
