"""Batches of motions with joint stops: the bits of single runs, tables, files and refusals."""

from __future__ import annotations

import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import xarray

import pinred
from pinred.common.errors import LoadError
from pinred.forces import PD, Controller, Damper, Torque
from pinred.kernels.build import build_kernel
from pinred.simulation.compiled import compiled_flow

DOCS = Path(__file__).parents[2] / "docs" / "stops.md"
CAT = pinred.load("falling_cat")
STOPS: dict[str, Any] = {
    "bend": (-0.6, 0.6),
    "sway": pinred.Stop(-0.5, 0.5, restitution=0.6),
}
RATES = np.array([[3.0, -2.0, 1.0], [2.0, 1.0, 1.0], [0.1, 0.1, 0.1]])


def bouncing_slide() -> pinred.System:
    """Return two masses, 3 kg and 1 kg, on one line: the reduced mass is 0.75 kg."""
    model = pin.Model()
    model.name = "slide"
    model.gravity.setZero()
    for k, mass in enumerate((3.0, 1.0)):
        i = model.addJoint(k, pin.JointModelPX(), pin.SE3.Identity(), ("base", "slide")[k])
        inertia = pin.Inertia(mass, np.zeros(3), 0.1 * np.eye(3))
        model.appendBodyToJoint(i, inertia, pin.SE3.Identity())
    return pinred.load(model)


def assert_equal_tables(table: Any, other: Any) -> None:
    """Assert that two tables of impacts have the same bits."""
    for name in ("t", "joint", "side", "impulse", "rate_before", "rate_after", "energy_lost"):
        np.testing.assert_array_equal(getattr(table, name), getattr(other, name))
    np.testing.assert_array_equal(table.momentum_before, other.momentum_before)
    np.testing.assert_array_equal(table.momentum_after, other.momentum_after)


def test_members_have_the_bits_of_simulate_and_pass_the_comparison() -> None:
    """Members differ in states, force parameters, robot parameters, gravity and stops."""
    gain = pinred.Parameter("gain", 0.0)
    varied: dict[str, Any] = {
        "gain": [0.0, 0.05, 0.1], "front.mass": [4.0, 5.0, 6.0],
        "gravity": [[0.0, 0.0, -9.81], [0.0, 0.0, 0.0], [1.0, 2.0, 3.0]], "xdot0": RATES,
        "sway.stop.restitution": [0.0, 0.5, 1.0], "bend.stop.lower": [-0.1, -0.2, -0.3],
    }  # fmt: skip
    options: dict[str, Any] = {"forces": [Damper("bend", gain)], "duration": 0.7}
    many = pinred.simulate_many(CAT, members=varied, stops=STOPS, **options)
    for k in range(3):
        parameters = {name: varied[name][k] for name in ("gain", "front.mass", "gravity")}
        stops = {
            "bend": pinred.Stop(varied["bend.stop.lower"][k], 0.6),
            "sway": pinred.Stop(-0.5, 0.5, varied["sway.stop.restitution"][k]),
        }
        alone = pinred.simulate(CAT, xdot0=RATES[k], parameters=parameters, stops=stops, **options)
        np.testing.assert_array_equal(many.q[k], alone.q)
        np.testing.assert_array_equal(many.v[k], alone.v)
        assert_equal_tables(many.impacts.of_member(k), alone.impacts)
        assert_equal_tables(many[k].impacts, alone.impacts)
        np.testing.assert_array_equal(many[k].torques, alone.torques)
        assert many.impacts.counts[k] == len(alone.impacts.times)
        assert many[k].run.steps == alone.run.steps
    assert many.impacts.counts.tolist() == [2, 1, 0]
    np.testing.assert_array_equal(many.impacts.member, [0, 0, 1])
    assert pinred.compare(many[0]).verdict == "PASSED"


def test_members_with_stops_have_the_method_of_simulate() -> None:
    """Without stops, batches replace AdaptiveGauss by DOP853, which runs in lanes."""
    run: dict[str, Any] = {"times": [0.0, 0.5], "stops": STOPS}
    many = pinred.simulate_many(CAT, xdot0=RATES[:2], **run)
    alone = pinred.simulate(CAT, xdot0=RATES[1], **run)
    assert many[1].run.method == alone.run.method == "AdaptiveGauss"
    np.testing.assert_array_equal(many.x[1], alone.x)


def test_numbers_of_stops_vary_as_in_the_closed_form() -> None:
    """A slide hits a stop at its own position and bounces with its own restitution."""
    lower, e = np.array([0.0, 0.1, 0.2]), np.array([0.25, 0.5, 1.0])
    numbers = {
        # Both bounds change at once: each of them alone would exclude the other one.
        "slide.stop.lower": lower, "slide.stop.upper": lower + 9.0, "slide.stop.restitution": e,
    }  # fmt: skip
    many = pinred.simulate_many(
        bouncing_slide(), members=numbers, x0=[0.5], xdot0=[-1.0], xi0=[0.0], duration=1.0,
        stops={"slide": (-2.0, -1.0)},
    )  # fmt: skip
    np.testing.assert_allclose(many.impacts.t, 0.5 - lower, rtol=1e-12)
    np.testing.assert_allclose(many.impacts.rate_after, e, rtol=1e-12)
    np.testing.assert_allclose(many.impacts.energy_lost, 0.375 * (1 - e**2), atol=1e-13)
    np.testing.assert_allclose(many.x[:, -1, 0], lower + e * (0.5 + lower), rtol=1e-12)
    assert many.impacts.counts.tolist() == [1, 1, 1]
    assert str(many.impacts).splitlines()[2].split()[:3] == ["1", "0.400000000", "slide"]


def test_rows_of_one_time_are_one_impact_of_a_member() -> None:
    """Two slides that reach their stops together make one impact, also in the next member."""
    model = pin.Model()
    model.name = "pair"
    model.gravity.setZero()
    base = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, pin.Inertia(2.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    for name in ("left", "right"):
        k = model.addJoint(base, pin.JointModelPX(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(k, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    many = pinred.simulate_many(
        pinred.load(model), xdot0=[[1.0, -1.0]] * 2, x0=[0.0, 0.0], xi0=[0.0], duration=0.75,
        stops={"left": (-1.0, 0.5, 0.5), "right": (-0.5, 1.0, 0.5)},
    )  # fmt: skip
    assert len(many.impacts) == 4
    assert many.impacts.counts.tolist() == [1, 1]


def test_rejected_members_do_not_affect_the_others() -> None:
    """A start beyond a stop, and stops that are not valid, reject their member alone."""
    with pytest.warns(pinred.RejectedWarning, match="3 of 4 members"):
        many = pinred.simulate_many(
            CAT, members={
                "x0": [[0.1, 0, 0], [0.7, 0, 0], [0.1, 0, 0], [0.1, 0, 0]],
                "sway.stop.restitution": [0.5, 0.5, 1.5, 0.5],
                "bend.stop.lower": [-0.6, -0.6, -0.6, 0.2],
            }, duration=0.1, stops=STOPS,
        )  # fmt: skip
    reasons = {failure.member: failure.reason for failure in many.failures}
    assert [*reasons] == [1, 2, 3]
    assert "'bend' is 0.1 beyond its upper stop" in reasons[1]
    assert "stops['sway']: restitution" in reasons[2]
    assert "'bend' is 0.1 beyond its lower stop" in reasons[3]
    assert np.isnan(many.x[1:]).all()
    assert np.isfinite(many.x[0]).all()
    with pytest.raises(pinred.InputError, match=r"member 1: stops: .*beyond its upper stop"):
        pinred.simulate_many(
            CAT, x0=[[0.1, 0, 0], [0.7, 0, 0]], duration=0.1, stops=STOPS, invalid="raise"
        )


def test_prescribed_joint_that_runs_into_a_stop_of_the_file_fails_alone() -> None:
    """The member that moves too far is a failure, the other one is simulated."""
    scenes = [
        pinred.Scene(
            system=CAT, prescribed={"bend": f"{speed}*t"}, hold="free", duration=1.0, stops="file"
        )
        for speed in (0.1, 3.0)
    ]
    many = pinred.simulate_many(scenes)
    assert [failure.member for failure in many.failures] == [1]
    assert "'bend' runs into its upper stop at t = 0.53" in many.failures[0].reason
    assert np.isfinite(many.x[0]).all()
    assert many.impacts.counts.tolist() == [0, 0]


def test_scenes_of_a_list_keep_their_own_stops_and_events() -> None:
    """The first scene of a list does not decide whether others have stops or events."""
    event = pinred.Event("x['twist'] - 0.3", "turned", terminal=True)
    run: dict[str, Any] = {"system": CAT, "xdot0": RATES[0], "duration": 0.5}
    scenes = [
        pinred.Scene(**run),
        pinred.Scene(**run, stops={"bend": (-0.2, 0.2)}),
        pinred.Scene(**run, events=[event]),
        pinred.Scene(**run, stops={"bend": (-0.4, 0.4, 0.5)}, events=[event]),
    ]
    for order in ([0, 1, 2, 3], [3, 2, 1, 0]):
        many = pinred.simulate_many([scenes[k] for k in order])
        for member, k in enumerate(order):
            alone = pinred.simulate(scenes[k])
            reached = np.isfinite(many.x[member, :, 0])
            count = np.count_nonzero(alone.t <= many.t[reached][-1])
            np.testing.assert_allclose(
                many.x[member, reached], alone.x[:count], rtol=0.0, atol=1e-12
            )
            assert_equal_tables(many.impacts.of_member(member), alone.impacts)
            assert many[member].ended_by == alone.ended_by


def test_files_and_copies_keep_the_impacts(tmp_path: Path) -> None:
    """Files of both formats, pickles and datasets have the table with its members."""
    rates = RATES[[0, 1, 2, 2]]
    many = pinred.simulate_many(CAT, xdot0=rates, duration=0.5, stops=STOPS)
    assert len(many.impacts) == len(many) == 4  # Dimensions are not told apart by their lengths.
    copies = [pickle.loads(pickle.dumps(many))]
    for name in ("many.npz", "many.zarr"):
        many.save(tmp_path / name)
        copies.append(pinred.read_members(tmp_path / name))
    for copy in copies:
        assert_equal_tables(copy.impacts, many.impacts)
        np.testing.assert_array_equal(copy.impacts.member, many.impacts.member)
        np.testing.assert_array_equal(copy.impacts.counts, [2, 2, 0, 0])
        assert_equal_tables(copy[1].impacts, many[1].impacts)
        dataset = copy.to_xarray()
        np.testing.assert_array_equal(dataset["impact_member"], many.impacts.member)
        np.testing.assert_array_equal(dataset["impact_joint"], many.impacts.joint)
        assert dataset["impact_momentum_after"].dims == ("impact", "twist")
    np.testing.assert_array_equal(many[1].to_xarray()["impact_t"], many[1].impacts.t)
    with xarray.open_zarr(tmp_path / "many.zarr", consolidated=False, chunks=None) as folder:
        assert folder["impact_t"].dims == ("impact",)
        assert folder["reached"].dims == ("member",)
    free = pinred.simulate_many(CAT, xdot0=RATES, duration=0.1)
    free.save(tmp_path / "free.npz")
    assert len(pinred.read_members(tmp_path / "free.npz").impacts) == 0
    assert str(free.impacts) == "no impacts"


@pytest.mark.parametrize(
    "member", [[0, 0, 1], [0, 0, 1, 3], [0, -1, 1, 1], [1, 0, 1, 1], [0.0, 0.0, 1.0, 1.0]]
)
def test_damaged_members_of_impacts_are_refused(tmp_path: Path, member: list[float]) -> None:
    """A file whose column of members is not sorted, or names no member, is not read."""
    path = tmp_path / "many.npz"
    pinred.simulate_many(CAT, xdot0=RATES, duration=0.5, stops=STOPS).save(path)
    with np.load(path) as file:
        content = {name: file[name] for name in file.files}
    np.savez(path, **{**content, "impact_member": np.array(member)})
    with pytest.raises(LoadError, match="no sorted members"):
        pinred.read_members(path)


@pytest.mark.by_hand("1-False")
@pytest.mark.parametrize(("most", "once"), [(compiled_flow.MOST_MODES, True), (1, False)])
def test_kernels_of_modes_are_built_once(
    monkeypatch: pytest.MonkeyPatch, most: int, once: bool
) -> None:
    """Modes of members do not displace each other, nor the kernel without rest."""
    system = bouncing_pair_of_hinges()
    assert "a system keeps those of 128 modes" in DOCS.read_text("utf-8")
    assert compiled_flow.MOST_MODES == 128
    monkeypatch.setattr(compiled_flow, "MOST_KERNELS", 1)
    monkeypatch.setattr(compiled_flow, "MOST_MODES", most)
    built: list[str] = []
    build = build_kernel

    def counted(*args: Any) -> Any:
        built.append(repr(args[2] and args[2].joints))
        return build(*args)

    monkeypatch.setattr(compiled_flow, "build_kernel", counted)
    run: dict[str, Any] = {
        "xdot0": np.array([[2.0, -3.0], [-3.0, 2.0], [2.5, 3.5]]), "x0": [0.0, 0.0],
        "duration": 0.6, "stops": {"first": (-0.3, 0.3), "second": (-0.3, 0.3)},
        "forces": [Torque(lambda _t, _x, xdot, *_: [6.0 * xdot[0] ** 0, 6.0])],
    }  # fmt: skip
    many = pinred.simulate_many(system, **run)
    assert many.impacts.counts.sum() > 3
    pinred.simulate_many(system, **run)
    assert len(set(built)) >= 3
    assert (len(built) == len(set(built))) is once


def bouncing_pair_of_hinges() -> pinred.System:
    """Return a chain of two hinges on a free base in the plane."""
    model = pin.Model()
    model.name = "hinges"
    model.gravity.setZero()
    joints = (pin.JointModelPlanar(), pin.JointModelRZ(), pin.JointModelRZ())
    for k, (joint, name) in enumerate(zip(joints, ("base", "first", "second"), strict=True)):
        place = pin.SE3(np.eye(3), np.array([0.5 * (k > 0), 0.0, 0.0]))
        i = model.addJoint(k, joint, place, name)
        inertia = pin.Inertia(1.0 + k, np.array([0.2, 0.1, 0.0]), 0.1 * np.eye(3))
        model.appendBodyToJoint(i, inertia, pin.SE3.Identity())
    return pinred.load(model)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"device": "cuda"}, "joints come to rest at their stops at different times. Omit device"),
        ({"method": "Gauss(0.01, 8)"}, "stops: expected none with method Gauss8"),
        ({"members": {"twist.stop.lower": [0.1, 0.2]}}, "stops of 'twist', got stops of bend"),
        ({"stops": None, "members": {"bend.stop.lower": [0.1, 0.2]}}, "got stops of no joint"),
        ({"members": {"bend.stop.lowest": [0.1, 0.2]}}, "got 'lowest'; did you mean 'lower'"),
        ({"members": {"bent.stop.lower": [0.1, 0.2]}}, "'bent.stop.lower' cannot vary"),
        ({"members": {"bend.stop.lower": [0.1, 0.2, 0.3]}}, "bend.stop.lower: 3"),
        ({"stops": {"bent": (-1.0, 1.0)}}, "did you mean 'bend'"),
        ({"members": {"bend.stop.lower": 0.5}}, r"must have shape \(N,\), got \(\)"),
        ({"members": {"bend.stop.lower": None}}, "bend.stop.lower"),
        ({"members": {"bend.stop.lower": [[0.1], [0.2]]}}, r"got \(2, 1\)"),
        ({"members": {"bend.stop.lower": [0.1, np.nan]}}, "must be finite"),
    ],
)  # fmt: skip
def test_refusals_of_batches_have_a_remedy(options: dict[str, Any], message: str) -> None:
    """What does not act together with stops in batches is refused by name."""
    run = {"xdot0": RATES[:2], "duration": 0.1, "stops": STOPS, **options}
    with pytest.raises((pinred.InputError, pinred.ShapeError), match=message):
        pinred.simulate_many(CAT, **run)


@pytest.mark.parametrize(
    "force", [Controller(lambda *_: [0.1, 0.0, 0.0], period=0.1), PD({"twist": 0.1}, 1.0, 0.1)]
)
def test_batches_accept_and_refuse_the_forces_of_simulate(force: Any) -> None:
    """A force that acts together with stops in single runs acts in batches, and no other."""
    run: dict[str, Any] = {"duration": 0.5, "stops": STOPS, "forces": [force]}
    try:
        alone = pinred.simulate(CAT, xdot0=RATES[0], **run)
    except pinred.InputError as error:
        with pytest.raises(pinred.InputError, match=re.escape(str(error))):
            pinred.simulate_many(CAT, xdot0=RATES[:2], **run)
        return
    many = pinred.simulate_many(CAT, xdot0=RATES[:2], **run)
    np.testing.assert_array_equal(many.x[0], alone.x)
    assert_equal_tables(many.impacts.of_member(0), alone.impacts)


def test_explanation_names_the_modes_of_members(capsys: pytest.CaptureFixture[str]) -> None:
    """The lines say why members are simulated one by one, and how often each mode occurs."""
    pinred.simulate_many(
        CAT, xdot0=[[3.0, 0.0, 0.0], [0.0, 0.0, 0.0]], duration=0.5, stops={"bend": (-0.6, 0.6)},
        forces=[Torque(lambda *_: [0.3, 0.0, 0.0])], explain=True,
    )  # fmt: skip
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("2 members one by one, DOP853: joints come to rest")
    assert lines[1:] == [
        "mode: bend at its upper stop, in 2 members",
        "mode: no joint at rest, in 2 members",
    ]


def test_card_of_a_scene_shows_its_stops() -> None:
    """The card in notebooks has a row for each joint with stops, or one for the file."""
    card = pinred.Scene(system=CAT, duration=0.1, stops=STOPS)._repr_html_()
    assert "stops sway" in card
    assert "restitution=0.6" in card
    card = pinred.Scene(system=CAT, duration=0.1, stops="file")._repr_html_()
    assert "stops" in card
