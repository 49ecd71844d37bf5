"""Members with rejected values become failures; the others are simulated."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinred
from pinred.system.model_parameters import ModelParameters

SYSTEM = pinred.load("coupled_planar")
LINK = str(SYSTEM.model.names[2])


def test_negative_mass_becomes_failure_of_its_member(tmp_path: Path) -> None:
    """The other members have the bits of a batch without the rejected one."""
    masses = np.array([1.0, -0.5, 2.0, 0.0])
    xdot0 = np.full((4, 1), 0.3)
    options: dict[str, Any] = {"momentum": 0, "times": [0.0, 0.5]}
    with pytest.warns(pinred.RejectedWarning, match="2 of 4 members are rejected"):
        many = pinred.simulate_many(
            SYSTEM, members={f"{LINK}.mass": masses, "xdot0": xdot0}, **options
        )
    assert [failure.member for failure in many.failures] == [1, 3]
    assert many.failures[0].reason.endswith("'hinge.mass' must be above zero, got -0.5")
    assert np.isnan(many.pose[[1, 3]]).all()
    valid = {f"{LINK}.mass": masses[[0, 2]], "xdot0": xdot0[:2]}
    alone = pinred.simulate_many(SYSTEM, members=valid, **options)
    np.testing.assert_array_equal(many.pose[[0, 2]], alone.pose)
    one = pinred.simulate(SYSTEM, parameters={f"{LINK}.mass": 2.0}, xdot0=[0.3], **options)
    np.testing.assert_allclose(many.pose[2], one.pose, rtol=1e-12, atol=1e-13)
    assert many[2].scene.parameters == {f"{LINK}.mass": 2.0}
    many.save(tmp_path / "many.npz")
    with np.load(tmp_path / "many.npz") as saved:
        np.testing.assert_array_equal(saved["parameter_values"][:, 0], [1.0, np.nan, 2.0, np.nan])
        assert np.isnan(saved["gravity"]).all(axis=1).tolist() == [False, True, False, True]


def test_invalid_raise_names_the_member() -> None:
    """An error shared by all members, and a wrong shape, are raised in any case."""
    with pytest.raises(pinred.InputError, match=r"member 1: parameters: 'hinge.mass'"):
        pinred.simulate_many(SYSTEM, members={f"{LINK}.mass": [1.0, -1.0]}, invalid="raise")
    with pytest.raises(pinred.InputError, match=r"member 0: parameters: 'hinge.mass'"):
        pinred.simulate_many(SYSTEM, members={f"{LINK}.mass": [-1.0, -1.0]})
    with pytest.raises(pinred.ShapeError, match="must be finite"):
        pinred.simulate_many(SYSTEM, x0=np.array([[0.0], [np.nan]]))
    with pytest.raises(pinred.InputError, match="has no option"):
        pinred.simulate_many(SYSTEM, x0=np.zeros((2, 1)), durations=1.0)  # type: ignore[call-arg]
    with pytest.raises(pinred.InputError, match="expected one of record, raise"):
        pinred.simulate_many(SYSTEM, x0=np.zeros((2, 1)), invalid="no")  # type: ignore[arg-type]


def test_rejected_state_is_found_among_many() -> None:
    """An angle without a meaningful sine is rejected alone."""
    x0 = np.zeros((20, 1))
    x0[13] = 1e300
    with pytest.warns(pinred.RejectedWarning, match="1 of 20 members"):
        many = pinred.simulate_many(SYSTEM, x0=x0, times=[0.1])
    assert [failure.member for failure in many.failures] == [13]


def test_rows_of_moments_equal_single_moments() -> None:
    """Moments of many rows have the bits of one row, and reject the same rows."""
    names = [f"{LINK}.{kind}" for kind in ("mass", "com", "inertia", "payload.mass", "payload.at")]
    varied = ModelParameters(SYSTEM, names)
    own, rng = varied.own(), np.random.default_rng(0)
    samples = [varied.perturbed(rng) for _ in range(40)]
    rows = {name: np.array([sample[name] for sample in samples]) for name in names}
    for k, kind in ((3, "mass"), (5, "payload.mass"), (7, "inertia")):
        rows[f"{LINK}.{kind}"][k] *= -1.0
    result = varied.body_rows(rows, own)
    assert result is not None
    moments, reasons = result
    assert sorted(reasons) == [3, 5, 7]
    for k in range(40):
        values = {name: column[k] for name, column in rows.items()}
        if k in reasons:
            with pytest.raises(pinred.InputError) as raised:
                varied.checked(values)
            assert str(raised.value) == reasons[k]
        else:
            ((body, (single, _)),) = varied.inertias(varied.checked(values)).items()
            np.testing.assert_array_equal(moments[body][k], single)


def test_error_with_reasons_survives_pickling() -> None:
    """Worker processes send it."""
    from pinred.common.errors import RejectedValuesError

    error = pickle.loads(pickle.dumps(RejectedValuesError({4: "no", 2: "low"})))
    assert (str(error), error.reasons) == ("member 2: low", {4: "no", 2: "low"})
