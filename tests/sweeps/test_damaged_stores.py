"""Stores whose files are missing, cut or changed: refused by name, and computed again."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_sweep import CAT, GAIN, numbers_of

import pinred
from pinred.common.files import lock_shared
from pinred.forces import Damper
from pinred.sweeps.sweep_job import digest_of_parts

SCENE = pinred.Scene(
    system=CAT, duration=0.1, rtol=1e-4, atol=1e-6, momentum=0, xdot0=[0.5, -0.3, 0.2],
    times=[0.0, 0.1], forces=[Damper("bend", GAIN)],
)  # fmt: skip
# The points of the first block are rejected, so no output has values in it.
VARY = {"front.mass": pinred.Values([-2.0, -1.0, 1.0, 2.0, 3.0])}
OUTPUTS = {"pose": "pose", "bend": "x.bend(t)", "turn": lambda many: many.pose[:, -1, 3:]}


def compute(path: Path) -> Any:
    """Compute the sweep, or continue it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pinred.RejectedWarning)
        return pinred.sweep(SCENE, VARY, outputs=OUTPUTS, block=2, store=path)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished store."""
    path = tmp_path_factory.mktemp("sweep") / "whole.zarr"
    compute(path)
    return path


@pytest.fixture
def copy(whole: Path, tmp_path: Path) -> Path:
    """A copy of the finished store, which a test may damage."""
    return Path(shutil.copytree(whole, tmp_path / "s.zarr"))


def replace_by_folder(path: Path, _: np.random.Generator) -> None:
    """Replace a file by an empty folder."""
    path.unlink()
    path.mkdir()


def truncate(path: Path, rng: np.random.Generator) -> None:
    """Cut bytes off the end."""
    data = path.read_bytes()
    path.write_bytes(data[: rng.integers(1, len(data))])


def flip_bit(path: Path, rng: np.random.Generator) -> None:
    """Change one bit."""
    data = bytearray(path.read_bytes())
    data[rng.integers(len(data))] ^= 1 << rng.integers(8)
    path.write_bytes(data)


FAULTS: dict[str, Callable[[Path, np.random.Generator], object]] = {
    "delete": lambda path, _: path.unlink(),
    "truncate": truncate,
    "empty": lambda path, _: path.write_bytes(b""),
    "flip": flip_bit,
    "zeros": lambda path, _: path.write_bytes(bytes(path.stat().st_size)),
    "folder": replace_by_folder,
}


def faulty_copies(
    whole: Path, folder: Path, faults: Callable[[int], list[str]]
) -> Iterator[tuple[str, Path]]:
    """Yield copies of a store with one fault each, and the fault."""
    for k, file in enumerate(numbers_of(whole)):
        for fault in faults(k):
            path = Path(shutil.copytree(whole, folder / "s.zarr"))
            FAULTS[fault](path / file, np.random.default_rng([k, *fault.encode()]))
            yield f"{fault} {file}", path
            shutil.rmtree(path)


def read_all(path: Path) -> tuple[dict[str, Any], str]:
    """Return all numbers, failures and CPUs of a store, or the error of reading them."""
    try:
        result = pinred.open_sweep(path)
        values = {str(name): np.asarray(result[name].values) for name in result.variables}
        return {**values, "failures": repr(result.failures), "cpus": result.cpus}, ""
    except pinred.PinredError as error:
        return {}, str(error)


def check_reading(path: Path, expected: Any) -> str:
    """Read a store; return the error, or "" if all numbers of points with a status are right."""
    values, error = read_all(path)
    if error:
        return error
    failures, cpus = values.pop("failures"), values.pop("cpus")
    assert values.keys() == set(expected.variables)
    is_known = values["status"] > 0
    for name, array in values.items():
        right = expected[name].values
        if expected[name].dims[0] == "point":
            np.testing.assert_array_equal(array[is_known], right[is_known])
        else:
            np.testing.assert_array_equal(array, right)
    if is_known.all():
        assert failures == repr(expected.failures)
        assert cpus == expected.cpus
    return ""


@pytest.mark.parametrize("turn", [0, pytest.param(None, marks=pytest.mark.by_hand)])
def test_every_damaged_file_is_refused_and_restored(
    turn: int | None, whole: Path, tmp_path: Path
) -> None:
    """Reading refuses a damaged store or gives right numbers; a further run restores every bit."""
    names, expected, right = [*FAULTS], pinred.open_sweep(whole), numbers_of(whole)

    def faults(k: int) -> list[str]:
        return names if turn is None else [names[k % len(names)]]

    for fault, path in faulty_copies(whole, tmp_path, faults):
        error = check_reading(path, expected)
        # Without its status, a block is one that is still to be computed.
        is_loud = "status/c" not in fault or fault.split()[0] not in ("delete", "folder")
        # Only `point` reads the scene, see test_sweep.py.
        is_loud &= "scene.signed" not in fault
        assert bool(error) == is_loud, fault
        if is_loud:
            assert "s.zarr" in error, fault
            assert fault.split()[1].split("/")[-1] in error, fault
            assert "Call the sweep again" in error, fault
        if is_loud:
            with pytest.warns(pinred.StoreWarning, match=r"s\.zarr"):
                compute(path)
        else:
            compute(path)
        assert numbers_of(path) == right, fault


def test_whole_points_of_a_complete_store_are_read_and_not_computed_again(
    whole: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without damage, nothing is computed, written or warned of."""
    from pinred.sweeps import sweep_store

    monkeypatch.setattr(sweep_store.SweepStore, "write", None)
    before = {path: path.stat().st_mtime_ns for path in whole.rglob("*")}
    with warnings.catch_warnings():
        warnings.simplefilter("error", pinred.StoreWarning)
        result = compute(whole)
    assert {path: path.stat().st_mtime_ns for path in whole.rglob("*")} == before
    assert check_reading(whole, result) == ""
    assert result["status"].values.tolist() == [3, 3, 1, 1, 1]


def test_damage_after_opening_is_found_when_numbers_are_read(copy: Path) -> None:
    """Results are read lazily; a point of a sound block can be read beside a damaged one."""
    result = pinred.open_sweep(copy)
    (copy / "bend/c/1/0").unlink()
    assert np.isfinite(result["bend"].isel(point=slice(4, 5)).values).all()
    with pytest.raises(pinred.LoadError, match=r"block 1 of the store '.*s\.zarr' is damaged: 'be"):
        _ = result["bend"].isel(point=slice(2, 3)).values
    (copy / "plan/00000002.json").unlink()
    with pytest.raises(pinred.LoadError, match=r"block 2 .*'plan/00000002\.json' is missing"):
        _ = result.failures


def test_faults_that_checksums_do_not_see_are_refused(copy: Path) -> None:
    """The checksum of no bytes is zero; and a pipe in place of a file does not end."""
    (copy / "bend/c/1/0").write_bytes(bytes(4))
    (copy / "pose/c/1/0").unlink()
    os.mkfifo(copy / "pose/c/1/0")
    shutil.copyfile(copy / "plan/00000001.json", copy / "plan/00000002.json")
    result = pinred.open_sweep(copy)
    with pytest.raises(pinred.LoadError, match="'bend/c/1/0' has fewer than"):
        _ = result["bend"].values
    with pytest.raises(pinred.LoadError, match="'pose/c/1/0' is missing"):
        _ = result["pose"].values
    with pytest.raises(pinred.LoadError, match=r"block 2 .*has another content"):
        _ = result.failures


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("plan/plan.json", '"points": 5', '"points": 6'),
        ("plan/00000001.json", '"cpu": "', '"cpu": "x'),
        ("plan/00000001.json", '"block"', ' "block"'),
        ("plan/files.json", '"files": {"', '"files": {"x'),
        ("bend/zarr.json", '"rad"', '"deg"'),
        ("plan/zarr.json", '"group"', '"group" '),
    ],
)
def test_valid_json_with_other_content_is_refused(
    name: str, old: str, new: str, copy: Path
) -> None:
    """Texts have checksums, too."""
    text = (copy / name).read_text()
    assert old in text
    (copy / name).write_text(text.replace(old, new))
    assert re.search(rf"'{name}'.*Call the sweep again with this store", read_all(copy)[1])


def test_damage_of_several_files_is_restored(whole: Path, copy: Path) -> None:
    """A block without its status may have other damage; a last block has fewer points."""
    (copy / "status/c/2").unlink()
    (copy / "bend/c/2/0").write_bytes(b"1")
    for name in ("plan/plan.json", "plan/files.json", "turn/zarr.json", "turn/c/1/0"):
        (copy / name).write_bytes(b"{")
    (copy / "pose/c/2/0").unlink()
    (copy / "pose/c/2/0").mkdir()
    with pytest.warns(pinred.StoreWarning, match=r"plan\.json, plan/files\.json, block 1$"):
        compute(copy)
    assert numbers_of(copy) == numbers_of(whole)


def test_folders_with_files_are_not_removed(copy: Path) -> None:
    """A folder in place of a chunk may contain files of somebody."""
    (copy / "front.mass/c/1").unlink()
    (copy / "front.mass/c/1").mkdir()
    (copy / "front.mass/c/1/mine.txt").write_text("mine")
    with pytest.raises(pinred.OutputError, match=r"front\.mass/c/1': Directory not empty. Move it"):
        compute(copy)
    assert (copy / "front.mass/c/1/mine.txt").read_text() == "mine"


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", "null", "[" * 100_000, '{"format": 1}'])
@pytest.mark.parametrize("name", ["plan/plan.json", "zarr.json", "bend/zarr.json"])
def test_foreign_json_is_refused_by_name(name: str, text: str, copy: Path) -> None:
    """Neither json nor zarr raise their own exceptions, in stores of both formats."""
    (copy / name).write_text(text)
    with pytest.raises(pinred.LoadError, match=f"'{name}' of the store .*s\\.zarr"):
        pinred.open_sweep(copy)


def use_first_format(path: Path) -> None:
    """Rewrite a store as versions without checksums did."""
    plan = json.loads((path / "plan/plan.json").read_text())
    old = plan.pop("hash")
    plan["format"] = 1
    plan["hash"] = digest_of_parts(plan)
    (path / "plan/plan.json").write_text(json.dumps(plan))
    (path / "plan/files.json").unlink()
    for file in path.rglob("zarr.json"):
        content = json.loads(file.read_text().replace(old, plan["hash"]))
        codecs = content.get("codecs", [])
        if {"name": "crc32c"} in codecs:
            codecs.remove({"name": "crc32c"})
            for chunk in (file.parent / "c").rglob("*"):
                if chunk.is_file():
                    chunk.write_bytes(chunk.read_bytes()[:-4])
        file.write_text(json.dumps(content))
    for file in (path / "plan").glob("0*.json"):
        record = json.loads(file.read_text())
        file.write_text(json.dumps({name: record[name] for name in ("cpu", "reasons")}))


def test_stores_of_the_first_format_are_read(whole: Path, copy: Path) -> None:
    """They are read without checksums, but cannot be continued."""
    use_first_format(copy)
    assert check_reading(copy, pinred.open_sweep(whole)) == ""
    with pytest.raises(pinred.InputError, match="was written for an older version of pinred"):
        compute(copy)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("bend/c/1/0", None, "block 1 .*'bend/c/1/0' is missing"),
        ("bend/c/1/0", b"1", "block 1 .*'bend/c/1/0' has fewer"),
        ("status/c/1", b"\7\7", "block 1 .*'status/c/1' has invalid entries"),
        ("plan/00000001.json", b'{"cpu": "a", "reasons": {"x": 1}}', "block 1 .*another content"),
        ("plan/00000001.json", b'{"cpu": "a", "reasons": 3}', "block 1 .*another content"),
        ("plan/00000001.json", b"3", "block 1 .*another content"),
        ("turn/zarr.json", None, "'turn/zarr.json' of the store"),
        ("bend/zarr.json", {"shape": [7, 2]}, "'bend/zarr.json' of the store"),
        ("bend/zarr.json", {"shape": [10**40, -1]}, "'bend/zarr.json' of the store"),
        ("bend/zarr.json", {"shape": "x"}, "'bend/zarr.json' of the store"),
        ("bend/zarr.json", {"data_type": "float32"}, "'bend/zarr.json' of the store"),
        ("bend/zarr.json", {"codecs": [{"name": "nothing"}]}, "'bend/zarr.json' of the store"),
        ("bend/zarr.json", {"chunk_grid": None}, "'bend/zarr.json' of the store"),
        ("bend/zarr.json", {"node_type": "group"}, "'bend/zarr.json' of the store"),
        ("status/zarr.json", {"attributes": 3}, r"status/zarr.json' of the store"),
        ("t/zarr.json", {"shape": "x"}, "'t/zarr.json' of the store"),
        ("t/c/0", None, "'t/c' of the store"),
        ("zarr.json", {"attributes": {}}, "'zarr.json' of the store"),
        ("zarr.json", {"node_type": "array"}, "zarr.json' of the store"),
    ],
)
def test_damaged_stores_of_the_first_format_are_refused_by_name(
    name: str, content: Any, words: str, copy: Path
) -> None:
    """Without checksums, missing files and foreign forms are found."""
    use_first_format(copy)
    if content is None:
        (copy / name).unlink()
    elif isinstance(content, dict):
        text = json.loads((copy / name).read_text())
        (copy / name).write_text(json.dumps(text | content))
    else:
        (copy / name).write_bytes(content)
    assert re.search(f"({words}).* with another store", read_all(copy)[1])


def test_plan_of_a_newer_version_is_refused(copy: Path) -> None:
    """The message says what to do."""
    plan = json.loads((copy / "plan/plan.json").read_text())
    (copy / "plan/plan.json").write_text(json.dumps(plan | {"format": 99}))
    with pytest.raises(pinred.InputError, match="newer version of pinred"):
        pinred.open_sweep(copy)


@pytest.mark.parametrize(
    "change",
    [
        {"points": 0},
        {"points": "5"},
        {"block": -2},
        {"vary": []},
        {"outputs": None},
        {"format": ""},
    ],
)
def test_plan_with_foreign_values_is_refused(change: dict[str, Any], copy: Path) -> None:
    """Its checksum fits, because its writer may have computed it."""
    plan = json.loads((copy / "plan/plan.json").read_text()) | change
    del plan["hash"]
    plan["hash"] = digest_of_parts(plan)
    (copy / "plan/plan.json").write_text(json.dumps(plan))
    with pytest.raises(pinred.LoadError, match=r"'plan/plan\.json' of the store"):
        pinred.open_sweep(copy)


def test_temporary_files_of_running_drivers_are_kept(copy: Path) -> None:
    """A second driver removes only the files of killed ones."""
    partial = copy / "status/c/3.0123.partial"
    partial.write_bytes(b"1")
    running = [lock_shared(copy, lambda: None) for _ in range(2)]
    while running:
        compute(copy)
        assert partial.exists()
        descriptor = running.pop(0)
        assert descriptor is not None
        os.close(descriptor)
    compute(copy)
    assert not partial.exists()


CHILD = """
import sys
sys.path.insert(0, sys.argv[1])
import test_damaged_stores
test_damaged_stores.compute_many(sys.argv[2], lambda part: print(part, flush=True))
"""


def compute_many(path: str | Path, progress: Callable[[float], None] | bool = False) -> Any:
    """Compute many small blocks."""
    vary = {"front.mass": pinred.Uniform(1, 2)}
    return pinred.sweep(
        SCENE, vary, points=80, outputs=OUTPUTS, block=2, store=path, progress=progress
    )


@pytest.mark.slow
def test_killed_driver_leaves_only_complete_files(tmp_path: Path) -> None:
    """A driver that is killed leaves no damaged block; the next one has the bits of one run."""
    path, whole = tmp_path / "s.zarr", tmp_path / "whole.zarr"
    command = [sys.executable, "-c", CHILD, str(Path(__file__).parent), str(path)]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    for line in child.stdout:
        if float(line) > 0.4:
            break
    child.kill()
    child.communicate()
    values, error = read_all(path)
    assert error == ""
    assert 0 < np.count_nonzero(values["status"]) < 80
    with warnings.catch_warnings():
        warnings.simplefilter("error", pinred.StoreWarning)
        compute_many(path)
    compute_many(whole)
    assert numbers_of(path) == numbers_of(whole)


def test_blocks_of_nan_have_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A function may return NaN for all points of a block, whose chunk is stored, too."""
    from pinred.sweeps import sweep_store

    outputs = {"a": lambda many: np.full(len(many), np.nan)}
    vary = {"front.mass": [1.0, 2.0]}
    options: dict[str, Any] = {"outputs": outputs, "store": tmp_path / "s.zarr"}
    assert np.isnan(pinred.sweep(SCENE, vary, **options)["a"].values).all()
    monkeypatch.setattr(sweep_store.SweepStore, "write", None)
    assert np.isnan(pinred.sweep(SCENE, vary, **options)["a"].values).all()
