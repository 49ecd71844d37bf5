"""Audits of states by Pinocchio, and errors of the equations of motion of a cart and pole."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from tampering import offset, tampered
from trees import random_model

import pinred
from pinred import forces
from pinred.common.arrays import Array
from pinred.judge import audit as module
from pinred.judge.audit import (
    Accelerations,
    Audit,
    accelerations,
    audit_states,
    audit_trajectory,
    equation_errors,
)
from pinred.judge.reference_solution import FullState


@cache
def tree() -> pinred.System:
    """Return a tree on a free base, without gravity."""
    return pinred.load(random_model("SE3", 3, 1, armature=False))


def repeated_state(speed: float = 1.0, fall: float = 0.0) -> pinred.State:
    """Return one state at three times.

    speed: factor of all its rates.  fall: upward velocity of the whole system [m/s].
    """
    state = pinred.simulate(tree(), seed=0, times=[0.0, 0.1]).states
    rates = {"xi", "xdot", "v", "body_momentum", "spatial_momentum"}
    values = {
        item.name: np.repeat(getattr(state, item.name)[:1], 3, axis=0)
        * (speed if item.name in rates else 1.0)
        for item in fields(state)
    }
    q, turn = values["q"][0], pin.Quaternion(state.q[0, 3:7]).matrix()
    values["v"][:, :3] += turn.T @ [0.0, 0.0, fall]
    values["xi"] = values["v"][:, :6].copy()
    inertia = pin.crba(tree().model, tree().data, q)
    H = np.triu(inertia) + np.triu(inertia, 1).T
    values["energy"] = 0.5 * np.einsum("ti,ij,tj->t", values["v"], H, values["v"])
    values["body_momentum"] = values["v"] @ H[:6].T
    to_root = pin.SE3(turn, q[:3]).toDualActionMatrix()
    values["spatial_momentum"] = values["body_momentum"] @ to_root.T
    return pinred.State(**values)


def audit(state: pinred.State, work: float = 0.0, impulse: Array | None = None) -> Audit:
    """Audit a state as if work and impulse had been added at the second time."""
    values = None if impulse is None else np.array([0.0 * impulse, impulse, 0.0 * impulse])
    scene = pinred.Scene(system=tree(), seed=0)
    return audit_states(FullState(scene), state, np.array([0.0, work, 0.0]), values)


def measures(state: pinred.State) -> tuple[float, float, float, float]:
    """Return mass, radius of gyration, kinetic energy, and its part about the centre of mass."""
    model, data, q, v = tree().model, tree().data, state.q[0], state.v[0]
    kinetic = pin.computeKineticEnergy(model, data, q, v)
    pin.ccrba(model, data, q, v)
    mass = data.Ig.mass
    carried = 0.5 * data.hg.linear @ data.hg.linear / mass
    return mass, np.sqrt(np.trace(data.Ig.inertia) / mass), kinetic, kinetic - carried


def test_fields_of_right_states_agree() -> None:
    """Fields of a simulated state agree with Pinocchio at its q and v."""
    result = audit(repeated_state())
    assert result.energy == 0.0
    assert result.momentum == 0.0
    assert result.fields < 1e-14


def test_fields_of_slow_states_are_compared_relative_to_their_size() -> None:
    """A twist of 1e-4 with an error of 10 % has a relative error of 10 %."""
    state = repeated_state(speed=1e-4)
    xi = state.xi.copy()
    xi[1] *= 1.1
    result = audit(replace(state, xi=xi)).fields
    assert result == pytest.approx(0.1 * np.abs(xi[0]).max() / np.abs(state.v).max())


def test_state_at_rest_has_no_drift() -> None:
    """Without kinetic energy, momenta have no unit and no change."""
    state = repeated_state(speed=0.0)
    result = audit(state)
    assert result.momentum == result.energy == 0.0
    momenta = state.body_momentum.copy()
    momenta[1, 2] = 1e-3  # without motion, the unit is kg m/s
    assert audit(replace(state, body_momentum=momenta)).fields == pytest.approx(1e-3)


@pytest.mark.parametrize("part", [1e-9, 0.3])
def test_energy_drift_is_relative_to_internal_kinetic_energy(part: float) -> None:
    """The unit is the kinetic energy about the centre of mass, however fast that moves."""
    for fall in (0.0, 20.0):
        state = repeated_state(fall=fall)
        internal = measures(state)[3]
        assert audit(state, part * internal).energies == pytest.approx([0.0, -part, 0.0])


@pytest.mark.parametrize(("part", "seen"), [(0.5, False), (1.6, True)])
def test_energy_drift_ignores_round_off(part: float, seen: bool) -> None:
    """Changes of 1e-14 of the energies count as zero."""
    state = repeated_state(fall=20.0)
    kinetic = measures(state)[2]
    assert (audit(state, part * 1e-14 * 3.0 * kinetic).energy > 0.0) is seen


@pytest.mark.parametrize(("ratio", "of_all"), [(3e-9, False), (0.6e-9, True)])
def test_energy_drift_of_falling_body_is_relative_to_total_energy(
    ratio: float, of_all: bool
) -> None:
    """Without internal motion the unit is the kinetic energy of the fall."""
    state = repeated_state()
    mass, _, kinetic, internal = measures(state)
    state = repeated_state(fall=np.sqrt(2.0 * internal / (ratio * mass)))
    _, _, kinetic, internal = measures(state)
    scale = kinetic if of_all else internal
    assert audit(state, 0.1 * kinetic).energies[1] * scale == pytest.approx(-0.1 * kinetic, rel=0.1)


@pytest.mark.parametrize(("energy", "relative"), [(3e-290, True), (0.2e-290, False)])
def test_energy_drift_of_tiny_energies_is_in_joules(energy: float, relative: bool) -> None:
    """Energies near the smallest floating-point numbers are not divided."""
    state = repeated_state()
    state = repeated_state(speed=np.sqrt(energy / measures(state)[3]))
    internal = measures(state)[3]
    assert internal == pytest.approx(energy, rel=0.3)
    result = audit(state, 0.5 * internal).energies[1]
    assert result == pytest.approx(-0.5 if relative else -0.5 * internal, rel=1e-3, abs=0.0)
    unit = float(state.energy[0])
    doubled = audit(replace(state, energy=2.0 * state.energy)).fields
    assert doubled == pytest.approx(unit / max(unit, 1e-290))


@pytest.mark.parametrize("axis", range(6))
def test_momentum_drift_is_relative_to_momentum_of_internal_motion(axis: int) -> None:
    """The unit is √(2mT), times the radius of gyration for angular momentum."""
    state = repeated_state()
    mass, radius, _, internal = measures(state)
    scale = np.sqrt(2.0 * mass * internal) * (1.0 if axis < 3 else radius)
    model, data = tree().model, tree().data
    of_v = pin.computeCentroidalMap(
        model, data, state.q[0]
    )  # about the centre of mass, in world axes
    of_v = np.kron(np.eye(2), model.jointPlacements[1].rotation.T) @ of_v
    v = state.v.copy()
    v[1] += np.linalg.pinv(of_v)[:, axis] * 1e-6 * scale
    result = audit(replace(state, v=v)).momenta[1]
    assert result == pytest.approx(1e-6 * np.eye(6)[axis], rel=1e-4, abs=1e-10)


@pytest.mark.parametrize("axis", range(6))
def test_momentum_drift_subtracts_impulse(axis: int) -> None:
    """With impulses, momenta are taken about the origin, in units of the largest momentum."""
    impulse = 1e-3 * np.eye(6)[axis]
    for fall in (0.0, 20.0):
        state = repeated_state(fall=fall)
        mass, radius, _, internal = measures(state)
        unit = np.sqrt(2.0 * mass * internal) * (1.0 if axis < 3 else radius)
        scale = max(unit, np.abs(state.spatial_momentum).max())
        assert audit(state, 0.0, impulse).momenta[1] * scale == pytest.approx(-impulse)


def test_energy_drift_under_wrenches_is_relative_to_work() -> None:
    """The work of wrenches is the unit if it exceeds the internal kinetic energy."""
    state = repeated_state()
    work = 5.0 * measures(state)[3]
    assert audit(state, work, np.zeros(6)).energies == pytest.approx([0.0, -1.0, 0.0])
    assert audit(state, work).energies == pytest.approx([0.0, -5.0, 0.0])


@pytest.mark.parametrize("impulse", [None, np.zeros((3, 6))])
def test_work_before_first_state_is_ignored(impulse: Array | None) -> None:
    """Work done before the first state changes neither the drift nor its unit."""
    state = repeated_state()
    work = measures(state)[3] * np.array([3.0, 3.5, 3.0])
    scene = pinred.Scene(system=tree(), seed=0)
    result = audit_states(FullState(scene), state, work, impulse)
    assert result.energies == pytest.approx([0.0, -0.5, 0.0])


@pytest.mark.parametrize(
    "name", ["pose", "xi", "xdot", "body_momentum", "spatial_momentum", "energy"]
)
def test_wrong_field_is_detected(name: str) -> None:
    """Each field is compared relative to the largest number of its kind."""
    state = repeated_state()
    mass, radius, _, internal = measures(state)
    of_momentum = np.sqrt(2.0 * mass * internal) * max(1.0, radius)
    least = {"pose": 1.0, "energy": internal, "xi": 0.0, "xdot": 0.0}.get(name, of_momentum)
    kind = state.v if name in ("xi", "xdot") else getattr(state, name)
    largest = max(least, float(np.abs(kind).max()))
    for change, seen in ((1e-6 * largest, 1e-6), (np.nan, np.nan)):
        values = getattr(state, name).copy()
        values[1] += change
        result = audit(replace(state, **{name: values})).fields
        assert result == pytest.approx(seen, rel=1e-3, nan_ok=True)


def test_small_angles_are_compared_in_radians() -> None:
    """For hinges that hardly move, the error is absolute."""
    model = pin.Model()
    for i, joint in enumerate((pin.JointModelRZ(), pin.JointModelRX())):
        at = model.addJoint(i, joint, pin.SE3.Identity(), f"hinge{i}")
        model.appendBodyToJoint(at, pin.Inertia.FromSphere(1.0, 0.2), pin.SE3(1))
    model.gravity.setZero()
    traj = pinred.simulate(pinred.load(model), x0=[0.02], xdot0=[0.01], xi0=[0.0], times=[0.0, 0.1])
    wrong = replace(traj.states, pose=traj.states.pose + 1e-5)
    result = audit_states(FullState(traj.scene), wrong, np.zeros(2), None).fields
    assert result == pytest.approx(1e-5, rel=1e-6)


def pushed() -> pinred.Trajectory:
    """Simulate a tree with a thruster."""
    thruster = forces.Wrench([0.3, 0.1, 0.0, 0.2, 0.0, 0.1])
    return pinred.simulate(tree(), seed=0, duration=1.0, forces=thruster)


def hanging() -> pinred.Trajectory:
    """Simulate a tree on a pivot next to its centre of mass, in gravity."""
    model = random_model("SO3", 2, 1)
    model.gravity.linear = np.array([1.0, -2.0, 3.0])
    return pinred.simulate(pinred.load(model), seed=0, duration=1.0)


def falling() -> pinred.Trajectory:
    """Simulate a falling tree on a planar base, with springs."""
    model = random_model("SE2", 2, 3)
    model.gravity.linear = np.array([1.0, -2.0, 3.0])
    system = pinred.load(model)
    springs = dict.fromkeys(system.shape_names, (3.0, 0.2))
    return pinred.simulate(system, seed=1, duration=1.0, springs=springs)


@pytest.mark.parametrize("make", [pushed, hanging, falling])
def test_audit_subtracts_work_impulse_and_fall(make: object) -> None:
    """Effects of forces and gravity are no drift; a changed velocity is."""
    assert callable(make)
    traj = make()
    result = audit_trajectory(traj, traj.states)
    assert max(result.energy, result.momentum, result.fields) < 1e-9
    wrong = tampered(traj, offset("v", traj.system.r - 1, 1e-4))
    result = audit_trajectory(wrong, wrong(traj.t))
    assert min(result.energy, result.momentum) > 1e-6


CART, POLE, LEVER, MOMENT, G = (
    2.0,
    1.0,
    0.5,
    0.09,
    9.81,
)  # constants of robots/cartpole.urdf in SI units
TIMES = np.linspace(0.0, 0.5, 4)


@cache
def swinging(driven: bool, heavy: bool = True) -> pinred.Trajectory:
    """Simulate the cart and pole.

    driven: with a prescribed pole.  heavy: in gravity.
    """
    system = pinred.load("cartpole") if heavy else pinred.load("cartpole", gravity=np.zeros(3))
    if not driven:
        return pinred.simulate(system, x0=[0.7], xdot0=[0.5], xi0=[0.3], duration=0.5)
    plan = {system.shape_names[0]: pinred.signals.Expression("0.7 + 0.3*sin(2*t)")}
    return pinred.simulate(system, prescribed=plan, xi0=[0.3], duration=0.5)


def mass_matrix(angle: float) -> Array:
    """Compute the mass matrix of cart and pole; the pole hangs at angle 0."""
    coupled = -POLE * LEVER * np.cos(angle)
    return np.array([[CART + POLE, coupled], [coupled, MOMENT + POLE * LEVER**2]])


def closed_form(angle: float, rate: float, heavy: bool = True) -> Array:
    """Compute the accelerations of cart and pole."""
    centrifugal = POLE * LEVER * np.sin(angle) * rate**2
    weight = heavy * POLE * G * LEVER * np.sin(angle)
    return np.linalg.solve(mass_matrix(angle), [-centrifugal, -weight])


def driven_accelerations(t: float, angle: float, rate: float) -> Array:
    """Compute the accelerations with a prescribed pole."""
    turned = -4.0 * 0.3 * np.sin(2.0 * t)
    force = POLE * LEVER * (np.cos(angle) * turned - np.sin(angle) * rate**2)
    return np.array([force / (CART + POLE), turned])


def errors(
    monkeypatch: pytest.MonkeyPatch, off: Any, *, spread: Any = (0.0, 0.0), pace: float = 0.0,
    driven: bool = False, speed: Any = 1.0, heavy: bool = True,
) -> Array:  # fmt: skip
    """Compute the errors of a route with wrong accelerations.

    off: error of the accelerations.  spread, pace: see Accelerations.  speed: factor of all rates,
    at all times or at each; 0 is at rest, hanging.
    """
    traj = swinging(driven, heavy)
    states = traj(TIMES)
    speeds = np.broadcast_to(speed, TIMES.shape)[:, None]
    states = replace(states, **{k: speeds * getattr(states, k) for k in ("x", "xdot", "xi")})
    v = np.hstack([states.xi, states.xdot])
    a = [
        driven_accelerations(t, x, xdot) if driven else closed_form(x, xdot, heavy)
        for t, x, xdot in zip(TIMES, states.x[:, 0], states.xdot[:, 0], strict=True)
    ]
    paces = np.full(len(TIMES), pace)
    values = Accelerations(states, v, np.array(a) + off, np.broadcast_to(spread, v.shape), paces)
    monkeypatch.setattr(module, "accelerations", lambda *_: values)
    return equation_errors(traj, FullState(traj.scene), TIMES)


def terms(*, pace: float = 0.0, driven: bool = False, heavy: bool = True) -> tuple[Array, Array]:
    """Return the sums of magnitudes of force terms (T, 2) and the mass matrices (T, 2, 2)."""
    states, sums, inertias = swinging(driven, heavy)(TIMES), [], []
    between = 2.0 * CART * POLE / (CART + POLE) * LEVER**2
    radius = np.sqrt((0.3 + 0.19 + between) / (CART + POLE))
    weights = heavy * G * np.array([CART + POLE, POLE * LEVER])  # independent of the angle
    for t, x, xdot, xi in np.hstack([TIMES[:, None], states.x, states.xdot, states.xi]):
        H, a = (
            mass_matrix(x),
            driven_accelerations(t, x, xdot) if driven else closed_form(x, xdot, heavy),
        )
        changes = np.abs(a) + pace * np.abs([xi, xdot])
        carried = np.array([CART + POLE, POLE * radius]) * (changes[0] + radius * changes[1])
        sums.append(np.abs(H) @ changes + weights + 1e-5 * carried)
        inertias.append(H)
    return np.array(sums), np.array(inertias)


OFF = np.array([1e-3, -2e-3])


@pytest.mark.parametrize("pace", [0.0, 3.0])
def test_equation_error_is_relative_to_terms_of_forces(
    monkeypatch: pytest.MonkeyPatch, pace: float
) -> None:
    """Terms: inertial forces, changes of rates, gravity loads, 1e-5 of forces on moved bodies."""
    sums, H = terms(pace=pace)
    result = errors(monkeypatch, OFF, pace=pace)
    assert result == pytest.approx(np.abs(H @ OFF) / sums, rel=1e-8)


def test_equation_error_ignores_spread_of_derivatives(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten times the spread of the route's accelerations is subtracted."""
    sums, H = terms()
    spread = np.array([2e-5, 1e-5])
    result = errors(monkeypatch, OFF, spread=spread)
    remaining = np.maximum(np.abs(H @ OFF) - 10.0 * np.abs(H) @ spread, 0.0)
    assert result == pytest.approx(remaining / sums, rel=1e-8)
    assert (result > 0.0).all()
    assert not errors(monkeypatch, OFF, spread=20.0 * spread).any()


def test_spread_is_largest_of_five_times(monkeypatch: pytest.MonkeyPatch) -> None:
    """The spread of all joints includes two neighbouring times on each side."""
    sums, H = terms(driven=True)
    spread = np.zeros((len(TIMES), 2))
    spread[3] = 30.0 * np.array([2e-5, 1e-5])
    result = errors(monkeypatch, OFF, spread=spread, driven=True)
    expected = np.column_stack([np.abs(H @ OFF)[:, 0], H[:, 1, 1] * 2e-3]) / sums
    assert result[0] == pytest.approx(expected[0], rel=1e-8)
    assert not result[1:].any()


def test_equation_error_of_drive_compares_accelerations(monkeypatch: pytest.MonkeyPatch) -> None:
    """The force of a prescribed joint is free, so only its acceleration is compared."""
    sums, H = terms(driven=True)
    spread = np.array([2e-5, 1e-5])
    result = errors(monkeypatch, OFF, spread=spread, driven=True)
    assert result[:, 1] == pytest.approx(H[:, 1, 1] * (2e-3 - 1e-4) / sums[:, 1], rel=1e-8)
    remaining = np.abs(H @ OFF) - 10.0 * np.abs(H) @ spread
    assert result[:, 0] == pytest.approx(remaining[:, 0] / sums[:, 0], rel=1e-8)


def test_error_of_other_joint_does_not_appear_in_row_of_drive(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The rows of other joints show their errors."""
    system = pinred.load("planar_chain5")
    r, names = system.r, system.shape_names
    plan = {names[k]: pinred.signals.Expression(f"{0.2 * k} + 0.3*sin(2*t)") for k in (1, 3)}
    traj = pinred.simulate(system, prescribed=plan, xi0=[0.3, 0.1, 0.5], duration=0.5)

    def off(*of: Any) -> Accelerations:
        result = accelerations(*of)
        return replace(result, a=result.a + 1e-3 * (np.arange(r + system.m) == r - 1))

    monkeypatch.setattr(module, "accelerations", off)
    result = equation_errors(traj, FullState(traj.scene), TIMES).max(axis=0)
    assert result[[r + 1, r + 3]] == pytest.approx(0.0, abs=1e-9)
    assert (np.delete(result, [r + 1, r + 3]) > 1e-6).all()


def test_equation_error_at_rest_has_smallest_unit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without forces the unit is 1e-290 N."""
    off = 1e-297 * OFF
    result = errors(monkeypatch, off, speed=0.0, heavy=False)
    assert result == pytest.approx(np.abs([mass_matrix(0.0) @ off] * len(TIMES)) / 1e-290)


def test_equation_error_at_rest_is_relative_to_largest_forces(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The least unit is 1e-2 of the largest forces of the row."""
    sums, H = terms(heavy=False)
    result = errors(monkeypatch, OFF, speed=[1.0, 1.0, 1.0, 0.0], heavy=False)
    assert result[:3] == pytest.approx((np.abs(H @ OFF) / sums)[:3], rel=1e-8)
    least = 1e-2 * sums[:3].max(axis=0)
    assert result[3] == pytest.approx(np.abs(mass_matrix(0.0) @ OFF) / least, rel=1e-8)


class FullStateWithRoundOff(FullState):
    """Full simulation with an artificial error of ABA in world axes at one time."""

    left = np.array([3e-6, 1e-6])

    def rate(self, t: float, y: Array, axes: pin.Convention = pin.Convention.LOCAL) -> Array:
        """Add the artificial error."""
        rate = super().rate(t, y, axes)
        if axes == pin.Convention.WORLD and t == TIMES[2]:
            rate[-2:] += self.left
        return rate


def test_equation_error_ignores_round_off_of_aba(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten times the largest difference between two evaluations of ABA is subtracted."""
    sums, H = terms()
    errors(monkeypatch, OFF)  # replaces the route's accelerations
    traj = swinging(False)
    result = equation_errors(traj, FullStateWithRoundOff(traj.scene), TIMES)
    remaining = 10.0 * np.abs(H[2] @ FullStateWithRoundOff.left) / sums[2]
    assert result == pytest.approx(np.abs(H @ OFF) / sums - remaining, rel=1e-8)
    assert (result > 0.0).all()
    monkeypatch.setattr(FullStateWithRoundOff, "left", 1e3 * FullStateWithRoundOff.left)
    assert not equation_errors(traj, FullStateWithRoundOff(traj.scene), TIMES).any()


def test_size_is_that_of_the_initial_configuration(monkeypatch: pytest.MonkeyPatch) -> None:
    """Other report times do not change the size that scales the steps and the units."""
    sizes: list[float] = []

    def record(traj: Any, times: Array, size: float) -> Accelerations:
        sizes.append(size)
        return accelerations(traj, times, size)

    monkeypatch.setattr(module, "accelerations", record)
    system = pinred.load("planar_chain5")
    full = None
    for second in (0.01, 0.4):
        traj = pinred.simulate(
            system,
            x0=[0.3, -0.2, 0.4, 0.1, 0.0],
            xdot0=[2.0, -1.0, 3.0, 1.0, -2.0],
            times=[0.0, second, 0.5],
        )
        full = FullState(traj.scene)
        equation_errors(traj, full, TIMES[TIMES <= 0.5])
    assert full is not None
    q = traj.system.sort_q(traj.q)
    radii = [full.totals.radius_of_gyration(q_t) for q_t in q]
    assert abs(radii[1] / radii[0] - 1.0) > 1e-3
    assert sizes == [radii[0], radii[0]]
