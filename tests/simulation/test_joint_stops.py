"""Joint stops: impacts, rest and release against full-state hybrid dynamics and closed forms."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from coupled_trees import make_case
from hybrid_reference import HybridMotion, HybridReference, complementarity, stops_of
from scipy.optimize import brentq
from slides import bouncing_slide, pair_of_slides

import pinred
from pinred.cli.command_line import main
from pinred.common.arrays import Array
from pinred.common.errors import IntegrationError
from pinred.forces import Torque
from pinred.judge.verdict import Verdict
from pinred.simulation import run_with_stops
from pinred.simulation.impacts import bernstein, first_root, impulses, solve_complementarity


def reference_of(traj: pinred.Trajectory, torque: Any = None) -> HybridMotion:
    """Return the motion of a trajectory's scene by the full-state code."""
    system, stops = traj.system, stops_of(traj)
    shape = system.joint_values(traj.x[0])
    names = system.tree.x_names
    positions = {name: float(shape[names.index(name)]) for name in stops}
    reference = HybridReference(system, stops, torque)
    return reference.run(traj.q[0], traj.v[0], positions, traj.t)


def assert_equal_motions(
    traj: pinred.Trajectory, motion: HybridMotion, times: float, states: float
) -> None:
    """Assert that impacts, their order, modes and states of both routes are equal."""
    table = traj.impacts
    hits = [(hit.t, name) for hit in motion.hits for name in hit.joints]
    assert [name for _, name in hits] == list(table.joint)
    np.testing.assert_allclose(table.t, [t for t, _ in hits], rtol=0.0, atol=times)
    impulses_of_reference = np.concatenate([np.empty(0), *(hit.impulses for hit in motion.hits)])
    # The slowest impacts of a sequence have the relative error of their rates.
    np.testing.assert_allclose(table.impulse, impulses_of_reference, rtol=1e-6, atol=states)
    lost = [table.energy_lost[table.t == t].sum() for t in table.times]
    np.testing.assert_allclose(lost, [hit.lost for hit in motion.hits], rtol=0.0, atol=states)
    modes = traj.motion.modes
    assert len(modes) == len(motion.modes)
    for (t, label), (t_other, names) in zip(modes, motion.modes, strict=True):
        assert abs(t - t_other) <= times
        assert label.count(" at its ") == len(names)
        assert all(name in label for name in names)
    np.testing.assert_allclose(traj.v, np.array(motion.v), rtol=0.0, atol=states)
    np.testing.assert_allclose(traj.q, np.array(motion.q), rtol=0.0, atol=states)


def spatial_momentum(system: pinred.System, q: Array, v: Array) -> Array:
    """Return linear momentum, and angular momentum about the origin, by Pinocchio."""
    data = system.model.createData()
    h: Array = pin.computeCentroidalMomentum(system.model, data, q, v).vector.copy()
    h[3:] += np.cross(data.com[0], h[:3])
    return h


@pytest.mark.by_hand(
    "satellite_two_arms-0.5-0.3-0.1-2.0",
    "solo12-0.5-0.3-0.15-5.0",
    "satellite_two_arms-0.5-0.9-0.5-3.0",
)
@pytest.mark.parametrize(
    ("robot", "limit", "restitution", "end", "speed"),
    [
        ("falling_cat", 0.3, 0.6, 2.0, 8.0),
        ("solo12", 0.5, 0.3, 0.15, 5.0),
        ("satellite_two_arms", 0.5, 0.9, 0.5, 3.0),
    ],
)
def test_impacts_of_robots_agree_with_full_state_dynamics(
    robot: str, limit: float, restitution: float, end: float, speed: float
) -> None:
    """Impacts of robots agree with full state dynamics."""
    system, rng = pinred.load(robot), np.random.default_rng(1)
    stops = {name: pinred.Stop(-limit, limit, restitution) for name in system.shape_names}
    traj = pinred.simulate(
        system, x0=np.zeros(system.m), xdot0=speed * rng.normal(size=system.m),
        xi0=0.3 * rng.normal(size=6), duration=end, stops=stops,
    )  # fmt: skip
    assert len(traj.impacts.times) >= 3
    assert_equal_motions(traj, reference_of(traj), times=1e-9, states=1e-8)


def test_rest_and_release_agree_with_multipliers_of_the_full_state() -> None:
    """Rest and release agree with multipliers of the full state."""
    system = pinred.load("falling_cat")
    torque = Torque(
        lambda t, x, *_: ca.vertcat(0.05 * ca.sin(3 * t), 0.04 * ca.cos(2 * t), -0.02 * x[2])
    )

    def generalised(t: float, q: Array, _: Array) -> Array:
        return np.array([*np.zeros(6), 0.05 * np.sin(3 * t), 0.04 * np.cos(2 * t), -0.02 * q[9]])

    traj = pinred.simulate(
        system, x0=[0.1, 0.2, -0.1], xdot0=[1.0, -1.0, 0.5], xi0=[0.1, 0.2, 0.3, 0.1, 0.5, -0.2],
        duration=4.0, forces=[torque], stops=dict.fromkeys(system.shape_names, (-0.5, 0.5)),
    )  # fmt: skip
    assert len(traj.motion.modes) > 10
    assert any(label.count(" at its ") == 2 for _, label in traj.motion.modes)
    motion = reference_of(traj, generalised)
    assert_equal_motions(traj, motion, times=1e-9, states=1e-9)
    balance = traj.energy_balance
    assert balance.labels == ("torque", "joint stops")
    np.testing.assert_allclose(balance.residual, 0.0, atol=1e-11)
    # Inverse dynamics of Pinocchio at an instant of rest gives the torque and the reaction.
    reaction, model = traj.stop_reactions, system.model
    k = int(np.argmax(np.abs(reaction).max(axis=1)))
    t = float(traj.t[k])
    q, v, data = traj.q[k], traj.v[k], model.createData()
    reference = HybridReference(system, stops_of(traj), generalised)
    rest = tuple(
        n for n, row in enumerate(reference.rows) if reaction[k, row[1] - 6] * row[2] > 0.0
    )
    a, _ = reference.accelerations(t, q, v, rest)
    needed = pin.rnea(model, data, q, v, a) - generalised(t, q, v)
    np.testing.assert_allclose(needed[6:], reaction[k], atol=1e-9)
    np.testing.assert_allclose(traj.torques[k], reaction[k] + generalised(t, q, v)[6:], atol=1e-10)


@pytest.mark.parametrize("restitution", [0.5, 0.8])
def test_bouncing_slide_accumulates_at_the_time_of_the_closed_form(restitution: float) -> None:
    """Bouncing slide accumulates at the time of the closed form."""
    force, height, mass = 1.5, 1.0, 0.75
    traj = pinred.simulate(
        bouncing_slide(), x0=[height], xdot0=[0.0], xi0=[0.0], duration=20.0,
        forces=[Torque(lambda *_: [-force])],
        stops={"slide": pinred.Stop(0.0, restitution=restitution)},
    )  # fmt: skip
    g = force / mass
    first, e = np.sqrt(2.0 * height / g), restitution
    k = np.arange(len(traj.impacts))
    expected = first * (1.0 + 2.0 * e * (1.0 - e**k) / (1.0 - e))
    np.testing.assert_allclose(traj.impacts.t, expected, rtol=0.0, atol=1e-9)
    rates = -g * first * e**k
    np.testing.assert_allclose(traj.impacts.rate_before, rates, rtol=1e-5)
    accumulation = first * (1.0 + e) / (1.0 - e)
    (_, label), (start, rest) = traj.motion.modes
    assert (label, rest) == ("no joint at rest", "slide at its lower stop")
    assert 0.0 <= accumulation - start <= 2e-6 / (g * (1.0 - e))
    assert traj.impacts.rate_after[-1] == 0.0
    assert traj.impacts.rate_before[-1] * e >= -1e-6  # the first rebound below rest_rate
    assert traj.impacts.rate_before[-2] * e < -1e-6
    # All of the energy is gone, and the table says where.
    np.testing.assert_allclose(traj.impacts.energy_lost.sum(), force * height, rtol=1e-10)
    np.testing.assert_allclose(traj.stop_reactions[-1], force, rtol=1e-12)
    np.testing.assert_allclose(traj.x[-1], 0.0, atol=1e-15)


def test_elastic_stops_keep_the_energy_over_200_impacts() -> None:
    """Elastic stops keep the energy over 200 impacts."""
    system = pinred.load("falling_cat")
    traj = pinred.simulate(
        system, x0=[0.0, 0.0, 0.0], xdot0=[6.0, -5.0, 4.0], xi0=np.zeros(6), duration=12.0,
        rtol=1e-12, atol=1e-14,
        stops={name: pinred.Stop(-0.3, 0.3, 1.0) for name in system.shape_names},
    )  # fmt: skip
    assert len(traj.impacts.times) >= 200
    np.testing.assert_allclose(traj.energy, traj.energy[0], rtol=1e-11)
    np.testing.assert_allclose(traj.impacts.energy_lost, 0.0, atol=1e-15)
    times = traj.impacts.times
    before, after = traj(times), traj(np.nextafter(times, np.inf))
    J = [
        [spatial_momentum(system, q, v) for q, v in zip(states.q, states.v, strict=True)]
        for states in (before, after)
    ]
    scale = np.abs(before.v).max()
    np.testing.assert_allclose(J[0], J[1], rtol=0.0, atol=1e-13 * scale)
    assert not np.allclose(before.v, after.v, atol=1e-3)
    table = traj.impacts
    np.testing.assert_array_equal(table.momentum_before, table.momentum_after)


def test_prescribed_and_locked_joints_are_equivalent_to_rest() -> None:
    """With restitution 0, a pressed joint moves as one that is locked when it is loaded."""
    system, force = pinred.load("falling_cat"), Torque(lambda *_: [0.2, 0.0, 0.0])
    start: dict[str, Any] = {"x0": [0.5, 0.1, -0.2], "xdot0": [0.0, 1.0, -0.7], "duration": 1.0}
    traj = pinred.simulate(
        system, **start, xi0=[0.0, 0.0, 0.0, 0.4, -0.3, 0.2], forces=[force],
        stops={"bend": (-0.5, 0.5)},
    )  # fmt: skip
    assert traj.motion.modes == ((0.0, "bend at its upper stop"),)
    locked = pinred.load("falling_cat", lock={"bend": 0.5})
    other = pinred.simulate(
        locked, x0=[0.1, -0.2], xdot0=[1.0, -0.7], xi0=[0.0, 0.0, 0.0, 0.4, -0.3, 0.2],
        duration=1.0,
    )  # fmt: skip
    np.testing.assert_allclose(traj.x[:, 1:], other.x, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(traj.xi, other.xi, rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("method", ["Tsit5", "AdaptiveGauss", "Radau"])
def test_other_methods_find_the_impacts_of_dop853(method: str) -> None:
    """Other methods find the impacts of dop853."""
    system = pinred.load("falling_cat")
    stops = {name: pinred.Stop(-0.6, 0.6, 0.5) for name in system.shape_names}
    run: dict[str, Any] = {
        "xdot0": [3.0, -2.0, 2.0], "x0": np.zeros(3), "duration": 1.0, "stops": stops,
    }  # fmt: skip
    first, other = (pinred.simulate(system, method=m, **run) for m in ("DOP853", method))
    assert len(first.impacts) >= 3
    assert first.impacts.joint == other.impacts.joint
    np.testing.assert_allclose(first.impacts.t, other.impacts.t, rtol=0.0, atol=1e-8)


def test_complementarity_solution_matches_all_sets() -> None:
    """Complementarity solution matches all sets."""
    rng = np.random.default_rng(3)
    for _ in range(50):
        K = int(rng.integers(1, 6))
        root = rng.normal(size=(K, K))
        G, q = root @ root.T + 0.1 * np.eye(K), rng.normal(size=K)
        z = solve_complementarity(G, q)
        np.testing.assert_allclose(z, complementarity(G, q), rtol=1e-9, atol=1e-12)
    u, e = -rng.random(3), np.array([0.0, 0.5, 1.0])
    impulse = impulses(np.diag([1.0, 2.0, 4.0]), u, e)
    np.testing.assert_allclose(impulse, -(1.0 + e) * u / [1.0, 2.0, 4.0], rtol=1e-14)


@pytest.mark.parametrize(
    ("roots", "expected"),
    [
        ([0.3], 0.3), ([0.7, 0.2], 0.2), ([0.5, 0.5 + 1e-7], 0.5), ([1.5, -0.5], None),
        ([0.99999], 0.99999), ([1e-9], 1e-9),
    ],
)  # fmt: skip
def test_first_root_of_bernstein_coefficients_is_the_known_root(
    roots: list[float], expected: float | None
) -> None:
    """First root of bernstein coefficients is the known root."""
    polynomial = np.poly1d(roots, r=True) * np.poly1d([1.0, 0.0, 2.0])
    polynomial = polynomial * np.sign(polynomial(0.0))
    nodes, matrix = bernstein(7)
    found = first_root(matrix @ polynomial(nodes))
    if expected is None:
        assert found is None
    else:
        assert found is not None
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-8)


def test_two_joints_that_arrive_together_bounce_in_one_impact() -> None:
    """Two equal slides on a free base are symmetric, so both reach their stops at once."""
    system, e = pair_of_slides(), 0.5
    traj = pinred.simulate(
        system, x0=[0.0, 0.0], xdot0=[1.0, -1.0], xi0=[0.0], duration=0.75,
        stops={"left": (-1.0, 0.5, e), "right": (-0.5, 1.0, e)},
    )  # fmt: skip
    assert len(traj.impacts) == 2
    assert len(traj.impacts.times) == 1
    # The base does not move, so each slide of 1 kg bounces alone: λ = (1 + e) m v.
    np.testing.assert_allclose(traj.impacts.t, 0.5, atol=1e-12)
    np.testing.assert_allclose(traj.impacts.impulse, [-1.5, 1.5], rtol=1e-12)
    np.testing.assert_allclose(traj.impacts.energy_lost, 0.375, rtol=1e-12)
    np.testing.assert_allclose(traj.x[-1], [0.375, -0.375], atol=1e-12)


def test_impact_that_pushes_another_joint_into_its_stop_at_once_has_the_closed_form() -> None:
    """The right slide is 2e-14 m from its stop when the left one hits, and is pushed back.

    With masses of 2, 1 and 1 kg: λ = 2/3 (right, plastic), 4/3 (left, e = 1/2), 4/9 (right).
    """
    system, apart = pair_of_slides(), 1e-7
    traj = pinred.simulate(
        system, x0=[0.0, 0.0], xdot0=[1.0, -1.0], xi0=[0.0], duration=0.6,
        forces=[Torque(lambda t, *_: [0.0, ca.if_else(t < 0.5 - 2.0 * apart, 0.0, 2.0)])],
        stops={"left": (-1.0, 0.5, 0.5), "right": (-0.5 + apart, 1.0)},
    )  # fmt: skip
    assert traj.impacts.joint == ("right", "left", "right")
    np.testing.assert_allclose(traj.impacts.impulse, [2 / 3, -4 / 3, 4 / 9], rtol=1e-6)
    np.testing.assert_allclose(traj.impacts.t[[0, 2]], [0.5 - apart, 0.5], rtol=0.0, atol=1e-7)
    after = traj(float(np.nextafter(traj.impacts.t[-1], 1.0)))
    np.testing.assert_allclose(after.xi, [1 / 9], rtol=1e-5)
    np.testing.assert_allclose(after.xdot, [-4 / 9, 0.0], rtol=1e-5, atol=1e-6)


def test_impacts_without_time_between_them_are_an_error_after_a_hundred(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A joint that hits its stop again and again at one time is an error, not an endless loop."""
    calls: list[float] = []

    def nothing(t: float, *_: object) -> list[object]:
        calls.append(t)
        return []

    monkeypatch.setattr(run_with_stops, "cut_at", nothing)
    with pytest.raises(IntegrationError, match="cannot leave its stop at t = 0 s"):
        pinred.simulate(
            bouncing_slide(), x0=[0.5], xdot0=[-1.0], xi0=[0.0], duration=9.0,
            forces=[Torque(lambda *_: [-1.0])], stops={"slide": pinred.Stop(0.0, restitution=1.0)},
        )  # fmt: skip
    assert len(calls) == 101


def test_stop_of_a_follower_stops_its_leader() -> None:
    """Stop of a follower stops its leader."""
    case = make_case("SE3", 3, 6)
    follower, system = case.system.couplings[0].follower, case.system
    assert len(case.system.couplings[0].ratios) == 1
    names = system.tree.x_names
    value = float(system.joint_values(np.zeros(system.m))[names.index(follower)])
    traj = pinred.simulate(
        system, x0=np.zeros(system.m), xdot0=np.ones(system.m), duration=3.0,
        stops={follower: (value - 0.3, value + 0.2, 0.5)},
    )  # fmt: skip
    assert len(traj.impacts) >= 1
    assert set(traj.impacts.joint) == {follower}
    assert_equal_motions(traj, reference_of(traj), times=1e-9, states=1e-8)


def test_events_are_found_across_impacts() -> None:
    """A rate that jumps through zero at an impact crosses zero there."""
    traj = pinred.simulate(
        bouncing_slide(), x0=[0.5], xdot0=[-1.0], xi0=[0.0], duration=1.25,
        stops={"slide": (0.0, 10.0, 0.5)},
        events=[
            pinred.Event("xdot['slide']", "turn"),
            pinred.Event("x['slide'] - 0.25", "quarter"),
            pinred.Event("x['slide'] - 0.3", "last", terminal=True, direction=1),
        ],
    )  # fmt: skip
    np.testing.assert_allclose(traj.events["turn"].t, [0.5], atol=1e-12)
    np.testing.assert_allclose(traj.events["quarter"].t, [0.25, 1.0], atol=1e-12)
    assert traj.ended_by == "last"
    np.testing.assert_allclose(traj.t[-1], 1.1, atol=1e-12)


def test_saved_motions_keep_their_impacts(tmp_path: Path) -> None:
    """Saved motions keep their impacts."""
    system = pinred.load("falling_cat")
    traj = pinred.simulate(
        system, xdot0=[3.0, -2.0, 2.0], duration=1.0, stops={"bend": (-1.0, 0.8, 0.4)}
    )
    assert len(traj.impacts) == 1
    traj.save(tmp_path / "motion.npz")
    recording = pinred.read_recording(tmp_path / "motion.npz")
    for name, column in vars(traj.impacts).items():
        np.testing.assert_array_equal(getattr(recording.impacts, name), column)
    copy = pickle.loads(pickle.dumps(traj))
    np.testing.assert_array_equal(copy.impacts.t, traj.impacts.t)
    assert "bend" in str(traj.impacts)
    free = pinred.simulate(system, duration=0.1)
    assert len(free.impacts) == 0
    assert str(free.impacts) == "no impacts"


def test_without_stops_the_bits_of_a_motion_are_unchanged() -> None:
    """Stops that no joint reaches change neither the steps nor the end of a motion."""
    system = pinred.load("falling_cat")
    run: dict[str, Any] = {"duration": 1.0, "xdot0": [0.5, -0.4, 0.3], "method": "DOP853"}
    free = pinred.simulate(system, **run)
    stopped = pinred.simulate(system, **run, stops=dict.fromkeys(system.shape_names, (-9.0, 9.0)))
    assert len(stopped.impacts) == 0
    assert free.run.steps == stopped.run.steps
    np.testing.assert_array_equal(free.x[-1], stopped.x[-1])
    np.testing.assert_allclose(free.x, stopped.x, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize(
    ("stops", "message"),
    [
        ("limits", "expected 'file'"),
        (3, "stops: expected"),
        ({"bend": (1.0, -1.0)}, "expected lower < upper"),
        ({"bend": (np.nan, 1.0)}, "expected lower < upper"),
        ({"bend": (-np.inf, np.inf)}, "expected a finite"),
        ({"bend": (-1.0, 1.0, 1.5)}, "restitution: expected a number from 0"),
        ({"bend": (-1.0, 1.0, -0.1)}, "restitution: expected a number from 0"),
        ({"bend": (-1.0, 1.0, np.nan)}, "restitution: expected a number from 0"),
        ({"bend": (1.0,)}, "expected a Stop"),
        ({"bent": (-1.0, 1.0)}, "did you mean 'bend'"),
        ({"bend": (0.6, 1.0)}, "initial position of joint 'bend'"),
        ({"bend": (-1.0, 0.4)}, "initial position of joint 'bend'"),
    ],
)
def test_bad_stops_are_refused_by_name(stops: Any, message: str) -> None:
    """Bad stops are refused by name."""
    with pytest.raises(pinred.InputError, match=message):
        pinred.simulate(pinred.load("falling_cat"), x0=[0.5, 0.2, -0.3], duration=1.0, stops=stops)


def test_bad_arguments_of_a_stop_are_refused() -> None:
    """Bad arguments of a stop are refused."""
    with pytest.raises(pinred.InputError, match="rest_rate"):
        pinred.Stop(0.0, 1.0, rest_rate=0.0)
    with pytest.raises(pinred.InputError, match="lower"):
        pinred.Stop("a", 1.0)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "Gauss(0.01, 8)"}, "method"),
        ({"method": "Variational(0.01)"}, "method"),
        ({"method": "RKMK4(0.01)"}, "method"),
        ({"prescribed": {"bend": 0.1}, "hold": "free"}, "prescribed"),
    ],
)
def test_options_that_do_not_act_with_stops_are_refused(
    options: dict[str, Any], message: str
) -> None:
    """Options that do not act with stops are refused."""
    with pytest.raises(pinred.InputError, match=rf"(?s)stops.*{message}"):
        pinred.simulate(
            pinred.load("falling_cat"), duration=0.1, stops={"bend": (-1.0, 1.0)}, **options
        )


def test_exponents_refuse_stops() -> None:
    """Lyapunov exponents and linearisations refuse stops."""
    scene = pinred.Scene(
        system=pinred.load("falling_cat"), duration=0.1, stops={"bend": (-1.0, 1.0)}
    )
    with pytest.raises(pinred.InputError, match="stops"):
        pinred.lyapunov(pinred.simulate(scene))


def test_prescribed_motion_beyond_the_limits_of_the_file_is_refused() -> None:
    """Prescribed motion beyond the limits of the file is refused."""
    system = pinred.load("falling_cat")
    inside = pinred.simulate(
        system, prescribed={"bend": "0.1*t"}, hold="free", duration=1.0, stops="file"
    )
    assert len(inside.impacts) == 0
    with pytest.raises(
        pinred.InputError, match=r"joint 'bend' runs into its upper stop at t = 0\.53"
    ):
        pinred.simulate(system, prescribed={"bend": "3*t"}, hold="free", duration=1.0, stops="file")


@pytest.mark.by_hand
def test_turns_within_the_limits_of_the_file_hit_no_stop() -> None:
    """Results of reorient respect the limits of the file."""
    cat = pinred.load("falling_cat")
    turn = pinred.reorient(cat, [0.4, 0.3, 0.2], limits=1.6)
    traj = pinred.simulate(turn.trajectory.scene, stops="file")
    assert len(traj.impacts) == 0
    assert np.abs(traj.x).max() > 0.5


@pytest.mark.by_hand
def test_gaits_within_the_limits_of_the_file_hit_no_stop() -> None:
    """Results of optimise_gait respect the limits of the file."""
    gait = pinred.optimise_gait(
        pinred.Connection.mechanical(pinred.load("falling_cat")), axis="x", harmonics=1, starts=1,
        limits=1.6,
    )  # fmt: skip
    assert len(pinred.simulate(gait.trajectory.scene, stops="file").impacts) == 0


@pytest.mark.parametrize(("height", "rests"), [(3e-11, True), (3e-10, False)])
def test_slow_rebound_rests_only_if_it_stays_within_the_tolerance(
    height: float, rests: bool
) -> None:
    """A rebound below rest_rate of more than atol + rtol is simulated."""
    rebound, e, mass = 0.75e-6, 0.5, 0.75
    g = rebound**2 / (2.0 * height)
    traj = pinred.simulate(
        bouncing_slide(), x0=[0.0], xdot0=[-rebound / e], xi0=[0.0], duration=1e-5,
        forces=[Torque(lambda *_: [-g * mass])], stops={"slide": pinred.Stop(0.0, restitution=e)},
    )  # fmt: skip
    np.testing.assert_allclose(traj.impacts.rate_after[0], 0.0 if rests else rebound, rtol=1e-12)
    assert (len(traj.motion.modes) == 1) is True
    assert traj.motion.modes[0][1].endswith("stop") is rests


def test_joint_without_force_stays_at_its_stop() -> None:
    """Round-off of a reaction that is zero does not release a joint."""
    traj = pinred.simulate(
        bouncing_slide(),
        x0=[0.1],
        xdot0=[-1.0],
        xi0=[0.3],
        duration=5.0,
        stops={"slide": (0.0, 1.0)},
    )
    assert len(traj.impacts) == 1
    assert traj.motion.modes[1:] == ((traj.impacts.t[0], "slide at its lower stop"),)
    assert np.abs(traj.x[traj.t > 0.1]).max() == 0.0


@pytest.mark.parametrize(("apart", "are_one"), [(5e-11, True), (2e-10, False)])
def test_impacts_within_the_tolerance_of_time_are_one(apart: float, are_one: bool) -> None:
    """Impacts closer than rtol times the duration, 1e-10 s, are one impact."""
    traj = pinred.simulate(
        pair_of_slides(), x0=[0.0, 0.0], xdot0=[1.0, -1.0], xi0=[0.0], duration=1.0,
        stops={"left": (-1.0, 0.5, 0.5), "right": (-0.5 - apart, 1.0, 0.5)},
    )  # fmt: skip
    assert (len(traj.impacts.times) == 1) is are_one


@pytest.mark.parametrize("after", [0.0, 1e-16, 1e-12])
def test_motion_that_ends_just_after_an_impact_exists(after: float) -> None:
    """The time that is left may be too short for a gap above round-off."""
    traj = pinred.simulate(
        bouncing_slide(), x0=[0.3], xdot0=[-1.0], xi0=[0.0], duration=0.3 + after,
        stops={"slide": (0.0, 1.0, 0.5)},
    )  # fmt: skip
    np.testing.assert_allclose(traj.impacts.t, [0.3], rtol=1e-12)
    np.testing.assert_allclose(traj.x[-1], 0.0, atol=1e-11)


def test_force_that_switches_releases_a_joint() -> None:
    """The reaction changes its sign at the switch: x = (t − 0.5)² F / 2m after it."""
    force = Torque(lambda t, *_: [ca.if_else(t < 0.5, -1.0, 1.0)])
    traj = pinred.simulate(
        bouncing_slide(), x0=[0.05], xdot0=[-0.1], xi0=[0.0], duration=1.0, forces=[force],
        stops={"slide": (0.0, 1.0)},
    )  # fmt: skip
    assert traj.motion.modes[-1] == (0.5, "no joint at rest")
    np.testing.assert_allclose(traj.x[-1], 0.5 * 0.5**2 / 0.75, rtol=1e-9)


def test_too_many_impacts_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """The message names the robot and a remedy."""
    monkeypatch.setattr(run_with_stops, "MOST_IMPACTS", 3)
    run: dict[str, Any] = {
        "x0": [0.5], "xdot0": [-1.0], "xi0": [0.0], "stops": {"slide": (0.0, 1.0, 1.0)},
    }  # fmt: skip
    assert len(pinred.simulate(bouncing_slide(), duration=3.2, **run).impacts) == 3
    with pytest.raises(IntegrationError, match="'slide' has more than 3 impacts"):
        pinred.simulate(bouncing_slide(), duration=5.0, **run)


def test_initial_position_at_a_stop_is_accepted_and_beyond_it_refused() -> None:
    """Only round-off may lie beyond a stop at the start."""
    run: dict[str, Any] = {
        "xdot0": [-1.0], "xi0": [0.0], "duration": 0.5, "stops": {"slide": (0.5, 1.0, 0.5)},
    }  # fmt: skip
    traj = pinred.simulate(bouncing_slide(), x0=[0.5 - 1e-13], **run)
    np.testing.assert_array_equal(traj.impacts.t, [0.0])
    np.testing.assert_allclose(traj.xdot[1:], 0.5, rtol=1e-12)
    with pytest.raises(pinred.InputError, match="beyond its lower stop"):
        pinred.simulate(bouncing_slide(), x0=[0.5 - 5e-12], **run)


def test_scene_file_and_command_take_stops(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A scene file and the command line give the motion of the Python call."""
    stops = {"bend": pinred.Stop(-0.6, 0.6), "sway": pinred.Stop(-0.5, 0.5, 0.6)}
    expected = pinred.simulate(
        pinred.load("falling_cat"), xdot0=[3.0, -2.0, 1.0], duration=0.5, stops=stops
    )
    assert len(expected.impacts) == 2
    file = tmp_path / "scene.toml"
    file.write_text(
        'robot = "falling_cat"\n[start]\nxdot0 = [3.0, -2.0, 1.0]\n[run]\nduration = 0.5\n'
        "[stops]\nbend = [-0.6, 0.6]\nsway = {lower = -0.5, upper = 0.5, restitution = 0.6}\n"
    )
    traj = pinred.simulate(pinred.load_scene(file))
    np.testing.assert_array_equal(traj.impacts.t, expected.impacts.t)
    assert main(["run", str(file), "--explain"]) == 0
    text = capsys.readouterr().out
    assert "2 at stops of bend, sway" in text
    assert "stops: bend, sway" in text
    out = tmp_path / "motion.npz"
    command = ["simulate", "falling_cat", "--xdot0", "3,-2,1", "--duration", "0.5"]
    stated = ["--stops", "bend=-0.6,0.6", "--stops", "sway=-0.5,0.5,0.6"]
    assert main([*command, *stated, "--out", str(out)]) == 0
    np.testing.assert_array_equal(pinred.read_recording(out).impacts.t, expected.impacts.t)
    assert main([*command, "--stops", "file", "--out", str(out)]) == 0
    assert main([*command, "--stops", "sway=1", "--out", str(out)]) == 2
    assert "JOINT=LOWER,UPPER" in capsys.readouterr().err
    file.write_text(file.read_text().replace("sway =", "swai ="))
    with pytest.raises(pinred.InputError, match=r"scene\.toml.*stops.*did you mean 'sway'"):
        pinred.load_scene(file)


@pytest.mark.by_hand("0.3-2.0-1e-12")
@pytest.mark.parametrize(
    ("position", "acceleration", "rest_rate"),
    [(0.0, 2.0, 1e-14), (0.3, 2.0, 1e-12), (0.3, 1e6, 1e-6), (100.0, 1e6, 1e-6)],
)
def test_accumulation_ends_where_round_off_would_sustain_it(
    position: float, acceleration: float, rest_rate: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A contact lifts a joint by round-off δ, so rebounds of the height δ e²/(1 − e²) never end."""
    monkeypatch.setattr(run_with_stops, "MOST_IMPACTS", 100)
    e, mass = 0.5, 0.75
    run: dict[str, Any] = {
        "x0": [position], "xdot0": [-1.0], "xi0": [0.0], "duration": 10.0 / acceleration,
        "forces": [Torque(lambda *_: [-acceleration * mass])],
    }  # fmt: skip
    stop = pinred.Stop(position, restitution=e, rest_rate=rest_rate)
    traj = pinred.simulate(bouncing_slide(), **run, stops={"slide": stop})
    assert traj.motion.modes[-1][1] == "slide at its lower stop"
    assert traj.impacts.rate_after[-1] == 0.0
    lift = max(4.0 * np.finfo(float).eps * position, 1e-18)
    heights = (e * traj.impacts.rate_before) ** 2 / (2.0 * acceleration)
    assert heights[-1] <= 2.0 * lift * e**2 / (1.0 - e**2)
    assert heights[-2] > 2.0 * lift * e**2 / (1.0 - e**2)
    if position == 0.3:
        report = pinred.compare(traj, budget=5.0)
        assert report.verdict is Verdict.PASSED, report


def test_contact_is_found_within_round_off_of_the_position() -> None:
    """At the time of an impact, the joint is beyond its stop by at most 4 units of round-off."""
    position = 1000.0
    traj = pinred.simulate(
        bouncing_slide(), x0=[position + 0.5], xdot0=[-1.0], xi0=[0.0], duration=1.0,
        stops={"slide": (position, np.inf, 0.5)},
    )  # fmt: skip
    beyond = position - traj(traj.impacts.t).x[0, 0]
    assert 0.0 <= beyond <= 5.0 * np.finfo(float).eps * position


@pytest.mark.parametrize(("rate", "hits"), [(5e-13, True), (5e-14, False)])
def test_rate_at_a_stop_within_round_off_of_the_fastest_is_zero(rate: float, hits: bool) -> None:
    """A joint that touches its stop hits it if it is faster than 1e-13 times the fastest joint."""
    traj = pinred.simulate(
        pair_of_slides(), x0=[0.0, -0.5], xdot0=[1.0, -rate], xi0=[0.0], duration=0.1,
        stops={"right": (-0.5, 1.0)},
    )  # fmt: skip
    assert (len(traj.impacts) == 1) is hits


def wheel_and_slide() -> pinred.System:
    """Return a wheel and a slide of 1 kg on a free planar base."""
    model = pin.Model()
    model.name = "wheel and slide"
    model.gravity.setZero()
    base = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, pin.Inertia(3.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    for name, joint in (("wheel", pin.JointModelRZ()), ("slide", pin.JointModelPX())):
        k = model.addJoint(base, joint, pin.SE3.Identity(), name)
        inertia = pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3))
        model.appendBodyToJoint(k, inertia, pin.SE3.Identity())
    return pinred.load(model)


def test_pull_of_a_stop_within_round_off_of_the_energy_does_not_release() -> None:
    """A fast wheel has the energy E, and the joint leaves where the pull exceeds 2e-14 E.

    At this speed, compare fails if its own limit of the pull is another one.
    """
    speed = 1e6
    traj = pinred.simulate(
        wheel_and_slide(), x0=[0.0, 0.0], xdot0=[speed, 0.0], xi0=[0.0, 0.0, 0.0], duration=2.0,
        forces=[Torque(lambda t, *_: [0.0, t - 1.0])], stops={"slide": (0.0, 9.0)},
    )  # fmt: skip
    (_, first), (release, second) = traj.motion.modes
    assert (first, second) == ("slide at its lower stop", "no joint at rest")
    energy = 0.5 * 0.1 * speed**2
    np.testing.assert_allclose(release - 1.0, 2e-14 * energy, rtol=1e-3)
    assert pinred.compare(traj)


def test_rest_reaction_and_release_agree_with_a_model_with_a_locked_joint() -> None:
    """While a joint rests, the robot is another one, whose reaction follows by inverse dynamics."""
    system = pinred.load("falling_cat")
    run: dict[str, Any] = {"duration": 1.0, "rtol": 1e-12, "atol": 1e-14}
    xi0 = [0.0, 0.0, 0.0, 0.4, -0.3, 0.2]
    traj = pinred.simulate(
        system, x0=[0.5, 0.1, -0.2], xdot0=[0.0, 1.0, -0.7], xi0=xi0, **run,
        forces=[Torque(lambda t, *_: [0.2 * (1.0 - 2.0 * t), 0.0, 0.0])],
        stops={"bend": (-0.5, 0.5)},
    )  # fmt: skip
    (_, label), (release, _) = traj.motion.modes[:2]
    assert label == "bend at its upper stop"
    other = pinred.simulate(
        pinred.load("falling_cat", lock={"bend": 0.5}), x0=[0.1, -0.2], xdot0=[1.0, -0.7], xi0=xi0,
        **run,
    )  # fmt: skip
    model, at = system.model, system.model.joints[system.model.getJointId("bend")].idx_v
    data = model.createData()

    def reaction(t: float, q: Array, v: Array) -> float:
        free = np.delete(np.arange(model.nv), at)
        upper = np.triu(pin.crba(model, data, q))
        H = upper + np.triu(upper, 1).T
        bias = np.array(pin.nonLinearEffects(model, data, q, v))
        a = np.linalg.solve(H[np.ix_(free, free)], -bias[free])
        return float(H[at, free] @ a + bias[at]) - 0.2 * (1.0 - 2.0 * t)

    def at_time(t: float) -> float:
        states = other(np.array([t]))
        q = system.q(states.pose[0], np.array([0.5, *states.x[0]]))
        return reaction(t, q, np.insert(states.v[0], at, 0.0))

    resting = traj.t < release
    expected = [at_time(t) for t in traj.t[resting]]
    np.testing.assert_allclose(traj.stop_reactions[resting, 0], expected, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(traj.x[resting][:, 1:], other.x[resting], rtol=0.0, atol=1e-9)
    found = brentq(at_time, release - 0.1, release + 0.1, xtol=1e-14)
    assert abs(release - found) <= 1e-9


def test_stop_of_a_joint_that_never_moves_is_refused() -> None:
    """A follower with the ratio 0 has a constant position."""
    system = make_case("SO2", 4, 16).system
    coupled = system.coupled
    assert coupled is not None
    constant = [joint.name for joint in system.tree.joints if not coupled.terms(joint.v.start)]
    with pytest.raises(pinred.InputError, match=f"'{constant[0]}' never moves.*Omit its stop"):
        pinred.simulate(system, seed=0, stops={constant[0]: (-9.0, 9.0)}, duration=0.1)
