"""sweep() with faulty distributions, names, functions and stores."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_sweep import changed, numbers_of

import pinred


class OddLaw(pinred.Distribution):
    """A distribution that returns what it is told."""

    def __init__(self, values: Any) -> None:
        """Store the values."""
        self.values = values

    def at(self, u: Any) -> Any:  # noqa: ARG002
        """Return the values."""
        return self.values


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"vary": {"gain": OddLaw([0.1, float("nan"), 0.2])}}, "expected finite values .*got nan"),
        ({"vary": {"gain": OddLaw([0.1, float("inf"), 0.2])}}, "expected finite values .*got inf"),
        ({"vary": {"gain": OddLaw([0.1])}}, r"expected 3 values .*got shape \(1,\)"),
        ({"vary": {"gain": OddLaw(["a", "b", "c"])}}, "must be numbers"),
        ({"vary": {"seed": pinred.Uniform(0, 9)}}, "expected a list of whole numbers"),
        ({"vary": {"seed": [-1, 2]}}, "expected a list of whole numbers"),
        ({"vary": {"seed": [0.5, 2]}}, "expected a list of whole numbers"),
        ({"vary": {"front.com": [0.1]}}, r"is a vector. Vary some of its entries: front.com.x"),
        ({"vary": {"x0": [0.1]}}, "is a vector. Vary some of its entries: x0.bend"),
        (
            {"vary": {"momentum.omega3": [0.1], "momentum.ω3": [0.2]}},
            "'momentum.omega3' and 'momentum.ω3' are one number",
        ),
        ({"outputs": {"gain": "energy"}}, "'gain' is the name of 'gain' in vary"),
        ({"outputs": {"status": "energy"}}, "'status' is the name of a variable of pinred"),
        ({"outputs": {"point": "energy"}}, "'point' is the name of a variable of pinred"),
        ({"outputs": {"plan": "energy"}}, "'plan' is the name of a variable of pinred"),
        ({"outputs": {"coordinate": "x"}}, "'coordinate' is the name of a variable of pinred"),
        ({"outputs": {"a b": "x", "a/b": "x"}}, "'a/b' is the name of 'a b' in outputs"),
        ({"outputs": {"..": "x"}}, "expected a name that can be that of a file"),
        ({"outputs": {"zarr.json": "x"}}, "expected a name that can be that of a file"),
        ({"outputs": {"": "x"}}, "expected a name that can be that of a file"),
        ({"outputs": {"f": lambda _: 1 / 0}}, "function of 'f' raised ZeroDivisionError"),
        ({"outputs": {"f": lambda m: [1j] * len(m)}}, "values of 'f' must be numbers"),
        ({"outputs": {"f": lambda m: [[1.0] * k for k in range(len(m))]}}, "must be numbers"),
    ],
)
def test_faulty_values_and_names_leave_no_store(
    changes: dict[str, Any], words: str, tmp_path: Path
) -> None:
    """The message names the cause, and a corrected call can use the same name."""
    with pytest.raises(pinred.InputError, match=words):
        pinred.sweep(**changed(**changes), store=tmp_path / "s.zarr")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("together", [1, 8])
def test_functions_with_rows_of_several_shapes_are_rejected(
    together: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows have one shape, in the parts of a block and in all blocks."""
    from pinred.sweeps.sweep_job import SweepJob

    monkeypatch.setattr(SweepJob, "_members_of", lambda *_: together)
    calls: list[int] = []

    def grow(many: pinred.Trajectories) -> Any:
        calls.append(len(many))
        return np.zeros((len(many), len(calls)))

    with pytest.raises(pinred.ShapeError, match=r"one shape .*got \(1,\) .* and \(2,\)"):
        pinred.sweep(**changed(points=4, outputs={"f": grow}), block=2, store=tmp_path / "s.zarr")


def test_conditions_are_outputs_of_zero_and_one() -> None:
    """A function may return truth values."""
    result = pinred.sweep(**changed(outputs={"f": lambda m: m.x[:, -1, 0] > -9.0}))
    assert result["f"].values.tolist() == [1.0] * 3


def test_store_in_a_read_only_folder_fails_before_the_first_point(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No point is computed for a store that cannot be written."""
    from pinred.sweeps.sweep_job import SweepJob

    monkeypatch.setattr(SweepJob, "compute", None)
    with pytest.raises(pinred.OutputError, match="cannot write"):
        pinred.sweep(**changed(), store="/proc/s.zarr")
    (tmp_path / "s.zarr").mkdir()
    with pytest.raises(pinred.InputError, match="is not the store of a sweep"):
        pinred.sweep(**changed(), store=tmp_path / "s.zarr")


@pytest.mark.parametrize("other", [{}, {"seed": 1}])
def test_store_that_another_driver_creates_first_is_shared_or_refused(
    other: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two drivers of one sweep write equal files; a driver of another sweep is refused."""
    from pinred.sweeps.sweep_job import SweepJob

    path, compute = tmp_path / "s.zarr", SweepJob.compute
    whole = pinred.sweep(**changed(), block=2, store=tmp_path / "whole.zarr")
    done = numbers_of(tmp_path / "whole.zarr")

    def late(self: Any, index: int, *rest: Any) -> Any:
        monkeypatch.setattr(SweepJob, "compute", compute)
        pinred.sweep(**changed(**other), block=2, store=path)
        return compute(self, index, *rest)

    monkeypatch.setattr(SweepJob, "compute", late)
    if other:
        with pytest.raises(pinred.InputError, match="was written for seed=1"):
            pinred.sweep(**changed(), block=2, store=path)
    else:
        assert pinred.sweep(**changed(), block=2, store=path).identical(whole)
        assert numbers_of(path) == done
    assert not list(tmp_path.glob(".*"))
