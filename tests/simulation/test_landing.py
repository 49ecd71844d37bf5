"""Landings against multipliers on the full mass matrix, and a closed form."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from ball_trees import ball_tree
from meeting_pairs import LOCAL, Full, frame_of, framed, make_pair, stop
from trees import random_model

import pinred
from pinred import InputError, Scene, UnsupportedOperationError
from pinred.common.arrays import Array
from pinred.lie import GROUPS

REST = (0.0, 0.0, 0.0)


@pytest.mark.by_hand("loops-point")
@pytest.mark.parametrize("contact", ["point", "flat"])
@pytest.mark.parametrize("kind", ["trees", "balls", "followers", "loops", "flat"])
def test_landing_of_random_robots_equals_constrained_impulse(kind: str, contact: str) -> None:
    """Velocities, impulse, energy and stance follow from multipliers on the full mass matrix."""
    rows = 3 if contact == "point" else 6
    for seed in range(4):
        scene = make_pair(kind, 200 + seed).a
        landing = pinred.land(scene, "tip", contact=contact)  # type: ignore[arg-type]
        full, after = Full(scene), Full(landing.scene)
        J = full.rows("tip")[:rows]
        v, multipliers = stop(full.H, np.vstack([J, full.inner]), full.v)
        speed = max(np.abs(w).max() for w in full.twists(full.v).values())
        assert np.abs(after.v - v).max() <= 1e-13 * max(np.abs(full.v).max(), speed)
        assert np.abs(J @ after.v).max() <= 1e-13 * speed
        size = np.abs(full.momentum(full.v)).max()
        error = landing.impulse.ravel() - multipliers[:rows]
        assert np.abs(error).max() <= 1e-12 * max(size, np.abs(multipliers).max())
        energy = 0.5 * full.v @ full.H @ full.v
        assert landing.energy_before == pytest.approx(energy, rel=1e-13)
        assert abs(landing.energy_lost - (energy - 0.5 * v @ full.H @ v)) <= 1e-13 * energy
        jump = after.momentum(after.v) - full.momentum(full.v)
        group = GROUPS[scene.system.group.name]
        place = scene.system.model.jointPlacements[1]
        on_root = place.actInv(pin.Force(jump)).vector[list(group.axes)]
        assert np.abs(landing.momentum_jump - on_root).max() <= 1e-12 * max(
            size, np.abs(jump).max()
        )
        if landing.stance is None:
            assert contact == "flat"
            assert "flat foot" in landing.why_no_stance
            continue
        assert landing.stance.system.group.name == ("SO2" if kind == "flat" else "SO3")
        stance = Full(landing.stance.scene)
        assert 0.5 * stance.v @ stance.H @ stance.v == pytest.approx(
            0.5 * v @ full.H @ v, rel=1e-12
        )
        expected, found = full.twists(v), stance.twists(stance.v)
        assert max(np.abs(found[n] - expected[n]).max() for n in expected) <= 1e-13 * speed


def test_rod_that_lands_on_its_end_equals_closed_form() -> None:
    """A rod at angle θ turns about its end by ω = 3 v cos θ / 2l; ½mv²(1 − ¾cos²θ) is lost."""
    m, l, v, angle = 2.0, 0.8, 1.5, 0.4
    rod = pinred.Model("rod").body("rod", mass=m, inertia=m * l**2 / 12.0)
    rod = rod.fixed("end", parent="rod", at=[-l / 2, 0, 0])
    system = pinred.load(rod, group="SE2", gravity=REST)
    c, s = np.cos(angle), np.sin(angle)
    body_rate = [-v * s, -v * c, 0.0]  # v downwards, in the axes of the rod
    landing = pinred.land(Scene(system=system, pose0=[0, 1, angle], xi0=body_rate), "end")
    rate = -1.5 * v * c / l
    np.testing.assert_allclose(
        landing.instant.xi, [0.0, rate * l / 2, rate], rtol=1e-14, atol=1e-15
    )
    lost = 0.5 * m * v**2 * (1.0 - 0.75 * c**2)
    assert landing.energy_lost == pytest.approx(lost, rel=1e-14)
    up = m * (rate * l / 2 * c + v)
    np.testing.assert_allclose(
        landing.impulse, [[-m * rate * l / 2 * s, up, 0.0]], rtol=1e-13, atol=1e-15
    )
    assert landing.stance is not None
    assert landing.stance.system.group.name == "SO2"
    np.testing.assert_allclose(landing.stance.instant.xi, [rate], rtol=1e-14)
    motion = pinred.simulate(landing.stance.system, **landing.stance.start, duration=1.0)
    assert motion.pose[-1] - motion.pose[0] == pytest.approx(rate, rel=1e-12)


def falling_robot(seed: int) -> pinred.System:
    """Return a random tree with balls under gravity along a random direction."""
    system = framed(ball_tree(seed, 4), np.random.default_rng(seed))
    system.model.gravity.linear = np.array([1.0, -2.0, -9.0])
    return pinred.System(system.model, system.name)


def test_stance_under_gravity_is_a_pivot_about_the_vertical() -> None:
    """Root SO2 along gravity with two tilts: the foot stays, ABA agrees, energy is that left."""
    system = falling_robot(1)
    scene = Scene(
        system=system, seed=5, pose0=pin.SE3ToXYZQUAT(pin.SE3(pin.exp3(np.ones(3)), np.ones(3)))
    )
    landing = pinred.land(scene, "tip")
    stance = landing.stance
    assert stance is not None
    assert stance.system.shape_names[:2] == ("tilt_x", "tilt_y")
    down = np.array([1.0, -2.0, -9.0]) / np.sqrt(86.0)
    axis = stance.system.model.jointPlacements[1].rotation[:, 2]
    np.testing.assert_allclose(axis, -down, atol=1e-15)
    motion = pinred.simulate(stance.system, **stance.start, duration=0.2)
    assert pinred.compare(motion)
    start, end = (frame_of(stance.system, motion.pose[k], motion.x[k]).translation for k in (0, -1))
    place = frame_of(system, scene.start.pose, scene.start.x).translation
    np.testing.assert_allclose([start, end], [place, place], atol=1e-13)
    flight = pinred.simulate(system, **landing.start, duration=0.1)
    assert motion.energy[0] == pytest.approx(flight.energy[0], rel=1e-12)


def test_landing_on_several_frames_stops_all() -> None:
    """Frames that land at once all stop; redundant contacts have the smallest impulse."""
    system = framed(ball_tree(3, 5), np.random.default_rng(3))
    scene = Scene(system=system, seed=1)
    full = Full(scene)
    frames = ["link 1", "link 3", "tip"]
    landing = pinred.land(scene, frames, contact="flat")
    J = np.vstack([full.rows(frame) for frame in frames])
    v, multipliers = stop(full.H, J, full.v)
    assert np.abs(Full(landing.scene).v - v).max() <= 1e-12 * np.abs(full.v).max()
    assert np.abs(landing.impulse.ravel() - multipliers).max() <= 1e-11 * np.abs(multipliers).max()
    assert landing.impulse.shape == (3, 6)
    assert "several contact points" in pinred.land(scene, frames).why_no_stance


def test_contacts_close_to_each_other_are_independent() -> None:
    """Two points 1e-9 m apart stop the rotation across their line; equal points do not."""
    for distance, stops in ((1e-9, True), (0.0, False)):
        model = pinred.Model("rock").body("rock", mass=1.0, inertia=1.0)
        model = model.fixed("a", parent="rock").fixed("b", parent="rock", at=[distance, 0, 0])
        rock = pinred.load(model, gravity=REST)
        landing = pinred.land(Scene(system=rock, xi0=[0, 0, -1, 0, 0, 2.0]), ["a", "b"])
        assert landing.instant.xi[5] == pytest.approx(0.0 if stops else 2.0, abs=1e-5)


def test_landing_says_where_the_ground_would_pull() -> None:
    """A foot that rises when it lands needs an impulse towards the ground."""
    rock = pinred.load(pinred.Model("rock").body("rock", mass=1.0, inertia=1.0), group="SE3")
    for rate, pulled in ((-1.0, ()), (1.0, ("rock",))):
        scene = Scene(system=rock, xi0=[0, 0, rate, 0, 0, 0])
        landing = pinred.land(scene, "rock")
        assert landing.pulled == pulled
        assert ("would pull" in str(landing)) is bool(pulled)


@pytest.mark.parametrize(
    ("group", "gravity", "words"),
    [
        ("SE2", (0.0, -9.81, 0.0), "leaves no symmetry"),
        ("SO3", REST, "leaves no symmetry"),
        ("SE2", (0.0, 0.0, -9.81), ""),
        ("SE2", (5e-8, 0.0, -9.81), "leaves no symmetry"),
        ("RxSE2", REST, ""),
    ],
)
def test_stance_exists_where_a_symmetry_is_left(
    group: str, gravity: tuple[float, float, float], words: str
) -> None:
    """Gravity in the plane, or a pivot, leaves no motion that keeps the contact."""
    rock = pinred.Model("rock").body("rock", mass=1.0, inertia=1.0, com=[0.1, 0.0, 0.0])
    system = pinred.load(rock, group=group, gravity=gravity)
    landing = pinred.land(Scene(system=system, xi0=np.ones(system.r)), "rock")
    assert words in landing.why_no_stance
    assert (landing.stance is None) is bool(words)
    if landing.stance:
        assert landing.stance.system.group.name == "SO2"


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda s: pinred.land(s, "foot"), "frame: 'rock' has no link 'foot'"),
        (lambda s: pinred.land(s, []), "frame: expected one or several frames"),
        (lambda s: pinred.land(s, ["rock", "rock"]), "each once"),
        (
            lambda s: pinred.land(s, "rock", contact="line"),  # type: ignore[arg-type]
            "contact: expected point or flat",
        ),
    ],
)
def test_impossible_landing_is_refused_by_name(call: Callable[[Scene], object], words: str) -> None:
    """The message names the argument and the valid values."""
    rock = pinred.load(pinred.Model("rock").body("rock", mass=1.0, inertia=1.0))
    with pytest.raises((InputError, UnsupportedOperationError), match=words):
        call(Scene(system=rock, xi0=np.zeros(6)))


def height_by_pinocchio(system: pinred.System, pose: Array, x: Array) -> float:
    """Return the height of the frame "tip" against gravity."""
    gravity = system.model.gravity.linear
    up = -gravity / np.linalg.norm(gravity) if gravity.any() else np.array([0.0, 0.0, 1.0])
    return float(up @ frame_of(system, pose, x).translation)


@pytest.mark.by_hand("SO2")
@pytest.mark.sampled
@pytest.mark.parametrize("group", ["SE3", "SO3", "SE2", "SO2", "R", "RxSE2"])
def test_height_in_formulas_equals_kinematics(group: str) -> None:
    """Events that watch height['tip'] end where Pinocchio's kinematics have this height."""
    system = framed(pinred.System(random_model(group, 4, 7)), np.random.default_rng(2))
    system.model.gravity.setZero()
    system = pinred.System(system.model, "robot")
    scene = Scene(system=system, seed=4, duration=0.6)
    middle = pinred.simulate(scene)(0.3)
    level = height_by_pinocchio(system, middle.pose, middle.x)
    event = pinred.Event(f"height['tip'] - ({level!r})", "level")
    crossings = pinred.simulate(scene, events=[event]).events["level"]
    assert np.abs(crossings.t - 0.3).min() <= 1e-8


def test_flight_that_ends_where_a_foot_lands() -> None:
    """A formula of the height, against gravity, stops a fall; the landing follows from its end."""
    system = falling_robot(2)
    level = (
        height_by_pinocchio(system, system.group.identity(), Scene(system=system, seed=5).start.x)
        - 0.5
    )
    event = pinred.Event(f"height['tip'] + {-level!r}", "touch", terminal=True, direction=-1)
    flight = pinred.simulate(system, seed=5, duration=5.0, events=event)
    assert flight.ended_by == "touch"
    assert height_by_pinocchio(system, flight.pose[-1], flight.x[-1]) == pytest.approx(
        level, abs=1e-9
    )
    landing = pinred.land(flight, "tip")
    model, data = system.sorted_model, system.sorted_model.createData()
    state = landing.instant
    q, v = system.sorted_q(state.pose, state.x), system.sorted_v(state.xi, state.xdot)
    pin.forwardKinematics(model, data, q, v)
    velocity = pin.getFrameVelocity(model, data, model.getFrameId("tip"), LOCAL).linear
    np.testing.assert_allclose(velocity, 0.0, atol=1e-13)
    assert landing.pulled == ()
