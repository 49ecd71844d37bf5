"""Vector parameters: one name and one input for several numbers, with the bits of scalars."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from twelve_gains import (
    CAT,
    NAMES,
    OTHER,
    OWN,
    assert_same_bits,
    flow_pair,
    scalar_parameters,
    scene_of,
    vector_parameter,
)

import pinred
from pinred import InputError, Parameter
from pinred.forces import PD, Damper, Spring
from pinred.simulation.read_recording import read_recording


def test_vector_has_the_bits_of_scalars_in_flows() -> None:
    """Values, forward derivatives and backward passes are equal, with own and other values."""
    one, many = flow_pair()
    assert dict(one.inputs) == {"u": 12, "x0": 3}
    for values in (OWN, OTHER):
        named = dict(zip(NAMES, values.tolist(), strict=True))
        assert_same_bits(one(u=values).x, many(**named).x)
        by_one, by_many = one.jacobian(u=values), many.jacobian(**named)
        assert_same_bits(by_one["u"], np.stack([by_many[name] for name in NAMES], axis=-1))
        along = dict(zip(NAMES, OTHER, strict=True))
        assert_same_bits(one.jvp({"u": OTHER}, u=values), many.jvp(along, **named))
        covector = np.random.default_rng(0).normal(size=len(by_one["u"]))
        back, scalar_back = one.vjp(covector, u=values), many.vjp(covector, **named)
        assert_same_bits(back["u"], np.array([scalar_back[name] for name in NAMES]))
        assert_same_bits(back["x0"], scalar_back["x0"])
    stated = pinred.flow(scene_of(vector_parameter(), parameters={"u": OTHER}), wrt=["u"])
    assert_same_bits(stated.own("u"), OTHER)
    ends = pinred.simulate(stated.scene, times=[stated.scene.end])  # reports affect the method
    assert_same_bits(stated().x, ends.x[-1])


def test_derivatives_of_vector_agree_with_differences() -> None:
    """Both modes agree with central differences along a direction of all entries."""
    flow = pinred.flow(scene_of(vector_parameter(), rtol=1e-11), wrt=["u"])
    low, high = (flow(u=OWN + s * 1e-4 * OTHER) for s in (-1.0, 1.0))
    slope = flow.jacobian()["u"] @ OTHER
    for name in ("x", "xdot"):
        by_differences = (getattr(high, name) - getattr(low, name)) / 2e-4
        expected = slope[flow.outputs[name]]
        np.testing.assert_allclose(by_differences, expected, atol=1e-6 * np.abs(slope).max())
    covector = np.ones(len(slope))
    np.testing.assert_allclose(flow.vjp(covector)["u"] @ OTHER, covector @ slope, rtol=1e-10)


def test_vector_has_the_bits_of_scalars_in_casadi() -> None:
    """The Function has one input of twelve rows, and its derivatives are those of scalars."""
    import casadi as ca

    one, many = flow_pair()
    f, g = one.casadi(), many.casadi()
    assert f.size_in(0) == (12, 1)
    assert f.n_in() == 2
    x = np.array([0.1, 0.2, -0.1])
    assert_same_bits(f(OTHER, x).full(), g(*OTHER, x).full())
    J, by_scalars = f.jacobian()(OTHER, x, 0)[0], g.jacobian()(*OTHER, x, 0)
    assert_same_bits(J.full(), np.hstack([column.full() for column in by_scalars[:12]]))
    y = f(u := ca.MX.sym("u", 12), x)
    forward = ca.Function("forward", [u], [ca.jtimes(y, u, ca.DM(OWN))])
    back = ca.Function("back", [u], [ca.gradient(ca.sumsqr(y), u)])
    v = [ca.MX.sym(name) for name in NAMES]
    z = g(*v, x)
    along = sum(ca.jtimes(z, entry, 1.0) * d for entry, d in zip(v, OWN.tolist(), strict=True))
    scalar_forward = ca.Function("forward", v, [along])
    bound = 1e-12 * np.abs(forward(OTHER).full()).max()
    np.testing.assert_allclose(forward(OTHER), scalar_forward(*OTHER), atol=bound)
    gradients = ca.Function("gradients", v, [ca.gradient(ca.sumsqr(z), entry) for entry in v])
    assert_same_bits(back(OTHER).full(), np.vstack([entry.full() for entry in gradients(*OTHER)]))


def test_members_with_vectors_agree_with_scalars_and_single_runs() -> None:
    """Members state rows; they have the bits of scalar members."""
    rows = OWN + 0.002 * np.arange(5.0)[:, None]
    one = pinred.simulate_many(scene_of(vector_parameter()), members={"u": rows}, threads=1)
    columns = dict(zip(NAMES, rows.T, strict=True))
    many = pinred.simulate_many(scene_of(scalar_parameters()), members=columns, threads=1)
    assert_same_bits(one.x, many.x)
    single = pinred.simulate(scene_of(vector_parameter()), parameters={"u": rows[3]})
    np.testing.assert_allclose(one.x[3], single.x, atol=1e-7)
    shared = pinred.simulate_many(
        scene_of(vector_parameter()), parameters={"u": rows[3]}, members={"xdot0": np.zeros((2, 3))}
    )
    expected = pinred.simulate(
        scene_of(vector_parameter()), parameters={"u": rows[3]}, xdot0=np.zeros(3)
    )
    np.testing.assert_allclose(shared.x[1], expected.x, atol=1e-7)


def test_entries_replace_numbers_and_unused_entries_have_zero_derivatives() -> None:
    """Entries stand in springs and prescribed joints; a vector of one entry keeps its axis."""
    k, a = Parameter("k", [1.0, 0.1, 5.0]), Parameter("a", [0.3])
    scene = pinred.Scene(
        system=CAT, seed=1, duration=0.2, springs={"bend": (k[0], k[-2])},
        prescribed={"twist": a[0]},
    )  # fmt: skip
    flow = pinred.flow(scene, wrt=["k", "a"])
    J = flow.jacobian()
    assert J["k"].shape == (len(J["a"]), 3)
    assert J["a"].shape == (len(J["a"]), 1)
    assert np.abs(J["k"][:, :2]).max(axis=0).min() > 1e-6
    assert_same_bits(J["k"][:, 2], np.zeros(len(J["a"])))
    assert_same_bits(flow(k=[2.0, 0.3, 7.0]).x, flow(k=[2.0, 0.3, -1.0]).x)
    number = pinred.simulate(
        CAT, seed=1, duration=0.2, springs={"bend": (2.0, 0.3)}, prescribed={"twist": 0.3}
    )
    np.testing.assert_allclose(flow(k=[2.0, 0.3, 7.0]).x, number.x[-1], atol=1e-8)


def test_step_map_has_one_array() -> None:
    """A step takes the vector and has its columns in by_parameters."""
    step = pinred.flow(scene_of(vector_parameter()), wrt=["u"]).step(0.01)
    assert step.parameters == {"u": 12}
    linear = step.linear(u=OTHER)
    low, high = (step(u=OTHER + s * 1e-4 * OWN).xdot for s in (-1.0, 1.0))
    expected = (linear.by_parameters @ OWN)[step.outputs["xdot"]]
    np.testing.assert_allclose((high - low) / 2e-4, expected, atol=1e-9)


@pytest.mark.parametrize("copy_of", [lambda v: pickle.loads(pickle.dumps(v)), copy.deepcopy])
def test_copies_and_recordings_of_scenes_with_vectors(
    copy_of: Callable[[Any], Any], tmp_path: Path
) -> None:
    """Copies have one vector again, with the same numbers; recordings have the same states."""
    u = Parameter("u", [2.0, 0.5, 0.3])
    scene = pinred.Scene(
        system=CAT, seed=1, duration=0.2, forces=[Spring("bend", u[0], u[2]), Damper("bend", u[1])],
        parameters={"u": [1.5, 0.4, 0.2]},
    )  # fmt: skip
    same = copy_of(scene)
    traj = pinred.simulate(scene)
    assert_same_bits(pinred.simulate(same).x, traj.x)
    assert_same_bits(
        pinred.simulate(same, parameters={"u": u.value}).x,
        pinred.simulate(scene, parameters={"u": u.value}).x,
    )
    flow = pinred.flow(scene, wrt=["u"])
    assert_same_bits(copy_of(flow).jacobian()["u"], flow.jacobian()["u"])
    traj.save(tmp_path / "run.npz")
    assert_same_bits(read_recording(tmp_path / "run.npz").x, traj.x)
    with pytest.raises(ValueError, match="read-only"):
        scene.parameters["u"][0] = 1.0


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (
            [],
            r"'u' must be a number or have shape \(k,\) with at least one entry, got shape \(0,\)",
        ),
        (np.zeros((2, 3)), r"got shape \(2, 3\)"),
        ([[1.0], [2.0, 3.0]], "'u' must be numbers"),
        (["a", "b"], "'u' must be numbers"),
        ([1.0, np.nan], r"'u' must be finite, got \[1.0, nan\]"),
        ([1.0, np.inf], "'u' must be finite"),
    ],
)
def test_invalid_vectors_are_refused(value: Any, message: str) -> None:
    """A vector has one axis and finite numbers."""
    with pytest.raises(InputError, match=message):
        Parameter("u", value)


def test_wrong_shapes_and_names_are_refused() -> None:
    """Messages name the parameter, the expected shape and the given shape."""
    u = vector_parameter()
    scene, flow = scene_of(u), pinred.flow(scene_of(u), wrt=["u"])
    entry = r"'u\[0\]' is an entry of the vector parameter 'u'. Use 'u', with shape \(12,\)"
    many = pinred.simulate_many
    refused: list[tuple[Callable[[], Any], str]] = [
        (lambda: flow(u=OWN[:5]), r"u must have shape \(12,\), got \(5,\)"),
        (lambda: flow(u=1.0), r"u must have shape \(12,\), got \(\)"),
        (lambda: flow(u=[np.nan] * 12), "u must be finite"),
        (lambda: flow.jvp({"u": OWN[:5]}), r"direction of u must have shape \(12,\), got \(5,\)"),
        (lambda: flow.step(0.1)(u=OWN[:5]), r"u must have shape \(12,\), got \(5,\)"),
        (lambda: flow(**{"u[0]": 1.0}), entry),
        (lambda: pinred.flow(scene, wrt=["u[0]"]), entry),
        (lambda: scene_of(u, parameters={"u[0]": 1.0}), entry),
        (lambda: scene_of(u, parameters={"u": 1.0}), r"parameters\['u'\] .* \(12,\), got \(\)"),
        (lambda: scene_of(u, parameters={"u": [1, 2]}), r"parameters\['u'\] .* got \(2,\)"),
        (lambda: scene_of(u, parameters={"u": [np.nan] * 12}), r"parameters\['u'\] must be finite"),
        (lambda: many(scene, members={"u": np.zeros((4, 2))}), r"\(N, 12\) .* got \(4, 2\)"),
        (lambda: many(scene, members={"u": OWN}, seeds=[1]), r"\(N, 12\), got \(12,\)"),
        (lambda: many(scene, members={"u[0]": np.zeros(4)}), entry),
        (lambda: Spring("bend", u), "must be a number, got VectorParameter"),
        (lambda: pinred.Scene(system=CAT, duration=0.1, prescribed={"bend": u}), "a number"),
        (lambda: pinred.simulate(CAT, duration=0.1, forces=[PD({"bend": u}, kp=1, kd=1)]), "bend"),
    ]  # fmt: skip
    for call, message in refused:
        with pytest.raises(InputError, match=message):
            call()
    with pytest.raises(IndexError, match="Parameter 'u' has 12 entries, got the index 12"):
        u[12]


@pytest.mark.parametrize(
    "other",
    [Parameter("u", 1.0), Parameter("u[0]", 1.0), Parameter("u[7]", 1.0), Parameter("u", OWN)[11]],
)
def test_colliding_names_are_refused(other: Parameter) -> None:
    """A name of a vector or of an entry, used or not, belongs to that vector alone."""
    u = vector_parameter()
    used = [u[0]] * 11
    for entries in ([*used, other], [other, *used]):
        with pytest.raises(InputError, match="two Parameters have the name 'u"):
            scene_of(entries)
