"""Momenta, centre of mass, speeds of points and freed bodies of the sweep, against Pinocchio."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from strategies import Case, cases
from trees import inertia, placement

import pinred
from pinred.common.arrays import Array
from pinred.reduction.tree.body_frames import Body, bodies_of
from pinred.reduction.tree.free_bodies import (
    NUMBERS,
    Freed,
    frame_map,
    link_numbers,
    link_slopes,
    of_bodies,
    other_placement,
    pattern_of,
    step_of_body,
    step_slopes,
    total_mass,
    with_free,
)
from pinred.reduction.tree.momenta import (
    bracket,
    centre_of_mass,
    inertia_tensors,
    locked,
    momenta,
    root_twist,
    speed_along,
    tensors_of,
)
from pinred.reduction.tree.momenta import twists_at as twists_of_bodies

CLOSE: Any = {"rel": 1e-9, "abs": 1e-9}


def number(expression: ca.SX) -> Array:
    """An expression without symbols, as an array."""
    return np.array(ca.evalf(ca.densify(ca.SX(expression))))


def of_pinocchio(model: pin.Model, case: Case) -> Array:
    """The momenta of a state, by RNEA without gravity."""
    still = model.copy()
    still.gravity.setZero()
    return np.asarray(pin.rnea(still, still.createData(), case.q, np.zeros(model.nv), case.v))


@settings(max_examples=8)
@given(cases(1, 6))
def test_momenta_and_locked_inertia_equal_rnea_and_crba(case: Case) -> None:
    """From inertias, and from twice the same as tensors; with and without rotors."""
    system, model = case.system, case.system.model
    x, v, r = ca.SX(case.x), ca.SX(case.v), system.r
    true = of_pinocchio(model, case)
    twice = tensors_of(system, [2.0 * tensor for tensor in inertia_tensors(system)])
    H = np.triu(pin.crba(model, model.createData(), case.q))
    H = H + np.triu(H, 1).T
    assert number(momenta(system, x, v))[:, 0] == pytest.approx(true, **CLOSE)
    assert number(locked(system, x)) == pytest.approx(H[:r, :r], **CLOSE)
    bare = true - model.armature * case.v
    assert number(momenta(system, x, v, rotors=False))[:, 0] == pytest.approx(bare, **CLOSE)
    found = momenta(system, x, v, twice, rotors=False)
    assert number(found)[:, 0] == pytest.approx(2.0 * bare, **CLOSE)
    inner = H[:r, :r] - np.diag(model.armature[:r])
    assert number(locked(system, x, rotors=False)) == pytest.approx(inner, **CLOSE)
    found = locked(system, x, twice, rotors=False)
    assert number(found) == pytest.approx(2.0 * inner, **CLOSE)


@settings(max_examples=8)
@given(cases(1, 6))
def test_centre_of_mass_and_point_speeds_equal_forward_kinematics(case: Case) -> None:
    """By forward kinematics: in the root body's frame, and along directions fixed to bodies."""
    system, model, rng = case.system, case.system.model, case.rng
    data, bodies = model.createData(), bodies_of(case.system)
    com = data.oMi[1].actInv(pin.centerOfMass(model, data, case.q))
    found = np.array(centre_of_mass(bodies, case.x.tolist()), dtype=float)
    assert found == pytest.approx(com, **CLOSE)
    assert float(total_mass(bodies)) == pytest.approx(pin.computeTotalMass(model), rel=1e-12)
    pin.forwardKinematics(model, data, case.q, case.v)
    twists = twists_of_bodies(system, ca.SX(case.x), ca.SX(case.v))
    for k, (body, twist) in enumerate(zip(bodies, twists, strict=True)):
        direction, point = rng.normal(size=(2, 3))
        moving = data.v[k + 1]
        speed = direction @ (moving.linear + np.cross(moving.angular, point))
        found_speed = number(speed_along(body, twist, direction, point)).item()
        assert found_speed == pytest.approx(speed, **CLOSE)


@settings(max_examples=8)
@given(cases(1, 6))
def test_bracket_and_root_twist(case: Case) -> None:
    """The bracket is that of se(3); the root's twist gives the twist of a frame on a body."""
    system, model, rng = case.system, case.system.model, case.rng
    axes = list(system.group.axes)
    a, b = np.zeros((2, 6))
    a[axes], b[axes] = case.rng.normal(size=(2, system.r))
    true = pin.Motion(a).cross(pin.Motion(b)).vector
    assert number(bracket(system.group, ca.SX(a[axes]), ca.SX(b[axes])))[:, 0] == pytest.approx(
        true[axes], **CLOSE
    )
    if system.group.name != "SE3":
        return  # elsewhere only some frames' motions are those of the group
    body, place = int(rng.integers(system.m + 1)), placement(rng)
    data = model.createData()
    pin.forwardKinematics(model, data, case.q, case.v)
    own = place.actInv(data.v[body + 1]).vector
    found = root_twist(system, ca.SX(case.x), body, place, ca.SX(own), ca.SX(case.xdot))
    assert number(found)[:, 0] == pytest.approx(case.xi, **CLOSE)


@settings(max_examples=8)
@given(cases(1, 6))
def test_variable_bodies_equal_bodies_of_other_model(case: Case) -> None:
    """Inertias by their linear map, placements by their parameters; momenta by RNEA."""
    system, model, rng = case.system, case.system.model.copy(), case.rng
    bodies, count = bodies_of(system), system.m + 1
    heavy = sorted(rng.choice(count, size=min(2, count), replace=False).tolist())
    moved = int(rng.integers(1, count))
    freed = Freed(tuple(heavy), ((moved, pattern_of(system, moved)),))
    numbers = np.array(of_bodies(bodies, freed), dtype=float)
    for i in heavy:
        other = inertia(rng)
        model.inertias[i + 1] = other
        h, about = other.mass * other.lever, other.matrix()[3:, 3:]
        moments = [other.mass, *h, *about[np.triu_indices(3)]]
        numbers[freed.of_inertia(i)] = frame_map(bodies[i]) @ moments
    parent = bodies[bodies[moved].parent]
    place = other_placement(parent, bodies[moved], pattern_of(system, moved), 1.0, rng)
    model.jointPlacements[moved + 1] = place
    there = parent.frame.inverse() * place * bodies[moved].frame
    step = step_of_body(bodies[moved])
    step[5:] = there.translation
    numbers[freed.of_step(moved)] = step
    (c, s), turn = bodies[moved].beta, there.rotation
    R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ turn
    sine = R[0, 2]
    cosine = np.hypot(R[1, 2], R[2, 2])
    numbers[freed.of_step(moved)][:4] = [R[2, 2] / cosine, -R[1, 2] / cosine, cosine, sine]
    changed = with_free(bodies, freed, numbers.tolist())
    found = momenta(system, ca.SX(case.x), ca.SX(case.v), bodies=changed)
    assert len(numbers) == freed.size == NUMBERS * len(heavy) + 8
    assert number(found)[:, 0] == pytest.approx(of_pinocchio(model, case), rel=1e-8, abs=1e-8)


@pytest.mark.parametrize("name", ["planar_chain5", "satellite_two_arms", "falling_cat"])
def test_constants_of_step_pattern_are_not_read(name: str) -> None:
    """The zeros and ones of a step are those of its pattern, whatever the input."""
    system = pinred.load(name)
    bodies = bodies_of(system)
    steps = tuple((i, pattern_of(system, i)) for i in range(1, len(bodies)))
    freed = Freed((), steps)
    assert any("+" in pattern for _, pattern in steps)
    words = "".join(pattern for _, pattern in steps)
    own = np.array(of_bodies(bodies, freed), dtype=float)
    given = [value if word == "x" else np.nan for word, value in zip(words, own, strict=True)]
    changed = of_bodies(with_free(bodies, freed, given), freed)
    assert np.array(changed, dtype=float).tolist() == own.tolist()
    assert Freed((0, 1), steps[:1], (2, 3)).size == 20 + 8 + 24


@settings(max_examples=8)
@given(cases(1, 6))
def test_derivatives_of_placements_equal_differences(case: Case) -> None:
    """For the parameters of links and steps, by central differences of moved placements."""
    system, rng, h = case.system, case.rng, 1e-6
    bodies, place = bodies_of(system), placement(rng)
    i = int(rng.integers(1, system.m + 1))
    body, parent = bodies[i], bodies[bodies[i].parent]

    def moved(twist: Array, frame: pin.SE3) -> pin.SE3:
        return pin.exp6(pin.Motion(twist)) * frame

    twists = rng.normal(size=(6, 3))
    differences = np.column_stack([
        link_numbers(body, moved(h * t, place)) - link_numbers(body, moved(-h * t, place))
        for t in twists.T
    ])  # fmt: skip
    slopes = link_slopes(body, place, twists)
    assert slopes == pytest.approx(differences / (2.0 * h), abs=1e-8)
    # Of the numbers of the step, moved along their slopes, the placement again.
    twist, step = rng.normal(size=6), step_of_body(body)
    change = step_slopes(parent, body) @ twist
    spun = system.model.jointPlacements[i + 1].inverse() * parent.frame * at_step(body, step)
    ahead, behind = (
        parent.frame * at_step(body, step + sign * h * change) * spun.inverse()
        for sign in (1.0, -1.0)
    )
    found = pin.log6(ahead * behind.inverse()).vector / (2.0 * h)
    assert found == pytest.approx(twist, abs=1e-7)


def at_step(body: Body, numbers: Array) -> pin.SE3:
    """The step Rz(β) Rx(α) Ry(δ) Rz(ε) after a shift, with these numbers."""
    pairs: Any = [(body.beta[0], body.beta[1]), numbers[:2], numbers[2:4]]
    angles = [float(np.arctan2(sine, cosine)) for cosine, sine in pairs]
    R = np.eye(3)
    for angle, axis in zip([*angles, float(numbers[4])], "zxyz", strict=True):
        R = R @ pin.utils.rotate(axis, angle)
    return pin.SE3(R, numbers[5:])
