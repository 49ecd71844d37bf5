"""Each row of the table from concept to code, on a robot with balls."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.common.arrays import Array

CONCEPTS = (Path(__file__).parents[1] / "docs/concepts.md").read_text(encoding="utf-8")


@dataclass(frozen=True)
class Diver:
    """The diver, with a state.

    Attributes:
        system: The robot.
        red: Its reduction.
        x: A shape.
        xdot: A rate.
        xi: A body twist.
        pose: A pose.
        traj: A short motion.
    """

    system: Any
    red: Any
    x: Array
    xdot: Array
    xi: Array
    pose: Array
    traj: Any

    @property
    def q(self) -> Array:
        """Pinocchio's configuration."""
        return np.asarray(self.system.q(self.pose, self.x))

    @property
    def v(self) -> Array:
        """Pinocchio's velocity."""
        return np.asarray(self.system.v(self.xi, self.xdot))

    @property
    def mu(self) -> Array:
        """The body momentum."""
        return np.asarray(self.red.body_momentum(self.x, self.xdot, self.xi))


@pytest.fixture(scope="module")
def diver() -> Diver:
    """Return the diver at a random state."""
    rng = np.random.default_rng(3)
    system = pinred.load("diver")
    x, xdot, xi = system.space.random(rng, 0.8), rng.normal(size=9), rng.normal(size=6)
    pose = np.array([0.1, 0.2, 0.3, 0.5, -0.5, 0.5, 0.5])
    traj = pinred.simulate(system, seed=1, duration=0.2)
    return Diver(system, pinred.Reduction(system), x, xdot, xi, pose, traj)


def close(a: Any, b: Any, size: float = 1.0) -> None:
    """Require agreement to round-off of terms of a size."""
    np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-11 * size)


def mass_matrix(d: Diver) -> None:
    """It is Pinocchio's."""
    model = d.system.model
    H = pin.crba(model, model.createData(), d.q)
    close(d.red.mass_matrix(d.x), np.triu(H) + np.triu(H, 1).T)


def locked_inertia(d: Diver) -> None:
    """It is the inertia of the composite body at the base."""
    model = d.system.model
    data = model.createData()
    pin.ccrba(model, data, d.q, d.v)
    about_com = data.Ig.se3Action(pin.SE3(np.eye(3), data.com[0]))
    close(d.red.locked_inertia(d.x), data.oMi[1].actInv(about_com).matrix(), 100.0)


def local_connection(d: Diver) -> None:
    """Horizontal motion has no momentum in Pinocchio's sense."""
    model = d.system.model
    v = d.system.v(-d.red.local_connection(d.x) @ d.xdot, d.xdot)
    h = pin.computeCentroidalMomentum(model, model.createData(), d.q, v)
    close(h.vector, 0.0, 100.0)


def reduced_metric(d: Diver) -> None:
    """It is the kinetic energy of horizontal motion."""
    model = d.system.model
    v = d.system.v(-d.red.local_connection(d.x) @ d.xdot, d.xdot)
    energy = pin.computeKineticEnergy(model, model.createData(), d.q, v)
    close(0.5 * d.xdot @ d.red.reduced_metric(d.x) @ d.xdot, energy)


def curvature(d: Diver) -> None:
    """Differences along the frame give it (structure equation with the frame's constants)."""
    space, A, h = d.system.space, d.red.local_connection(d.x), 1e-4

    def slope(k: int) -> Array:
        e = h * np.eye(space.m)[k]
        ends = [d.red.local_connection(space.integrate(d.x, s * e)) for s in (-2, -1, 1, 2)]
        return np.asarray((ends[0] - 8.0 * ends[1] + 8.0 * ends[2] - ends[3]) / (12.0 * h))

    for a, b in ((0, 1), (3, 5), (4, 8)):
        expected = slope(a)[:, b] - slope(b)[:, a]
        expected -= d.system.group.ad(A[:, a]) @ A[:, b] + A @ space.structure[:, a, b]
        np.testing.assert_allclose(d.red.curvature(d.x)[:, a, b], expected, atol=1e-9)


def locked_velocity(d: Diver) -> None:
    """Locked inertia times locked velocity is the momentum."""
    omega = d.red.locked_velocity(d.x, d.xdot, d.xi)
    close(d.red.locked_inertia(d.x) @ omega, d.mu, 100.0)


def body_momentum(d: Diver) -> None:
    """It is the base rows of Pinocchio's mass matrix times v."""
    close(d.mu, (d.red.mass_matrix(d.x) @ d.v)[:6], 100.0)


def spatial_momentum(d: Diver) -> None:
    """The motion conserves its angular part about the centre of mass."""
    model, parts = d.system.model, []
    for q, v in zip(d.traj.q, d.traj.v, strict=True):
        parts.append(pin.computeCentroidalMomentum(model, model.createData(), q, v).angular)
    close(parts, np.broadcast_to(parts[0], (len(parts), 3)), 1e3)
    placed = pin.XYZQUATToSE3(d.pose).actInv(pin.Force.Zero())
    assert placed.vector.shape == d.red.spatial_momentum(d.pose, d.mu).shape


def potential(d: Diver) -> None:
    """Gravity only moves the centre of mass, so V = 0."""
    close(d.red.potential(d.x), 0.0)
    amended = 0.5 * d.mu @ np.linalg.solve(d.red.locked_inertia(d.x), d.mu)
    close(d.red.amended_potential(d.x, d.mu), amended, 100.0)


def forms(d: Diver) -> None:
    """The connection form maps the velocity of a rigid motion to its spatial twist."""
    Ad = pin.XYZQUATToSE3(d.pose).toActionMatrix()
    form = d.red.connection_form(d.pose, d.x)
    close(form @ np.concatenate([d.xi, np.zeros(9)]), Ad @ d.xi, 10.0)
    close(d.red.curvature_form(d.pose, d.x)[:, 6, 7], Ad @ d.red.curvature(d.x)[:, 0, 1], 10.0)
    dual = np.linalg.inv(Ad)
    inertia = dual.T @ d.red.locked_inertia(d.x) @ dual
    close(d.red.locked_inertia_in_space(d.pose, d.x), inertia, 1e3)


def parts(d: Diver) -> None:
    """The vertical and horizontal parts add up to the velocity."""
    split = d.red.split_velocity(d.x, d.xdot, d.xi)
    lift = d.red.horizontal_lift(d.x, d.xdot)
    close(split.vertical.xi + lift.xi, d.xi)
    close(lift.xdot, d.xdot)


def section(d: Diver) -> None:
    """A constant change of section acts by Ad of its inverse."""
    moved = d.red.change_section(lambda _: (d.pose, np.zeros((6, 9)), np.zeros((6, 9, 9))))
    Ad = pin.XYZQUATToSE3(d.pose).inverse().toActionMatrix()
    close(moved.local_connection(d.x), Ad @ d.red.local_connection(d.x), 10.0)


def levi_civita(d: Diver) -> None:
    """The torsion is that of the frame, and the curvature is antisymmetric in each pair."""
    christoffel, riemann = d.red.christoffel(d.x), d.red.riemann(d.x)
    close(christoffel - np.swapaxes(christoffel, 1, 2), d.system.space.structure, 100.0)
    size = float(np.abs(riemann).max())
    close(riemann, -np.swapaxes(riemann, 2, 3), size)
    close(riemann, np.einsum("abcd->cdab", riemann), size)
    assert np.isfinite(d.red.sectional_curvature(d.x, np.eye(9)[0], np.eye(9)[4]))


def poisson(d: Diver) -> None:
    """The tensor is antisymmetric, its Casimirs are degenerate, {x, p} is the frame."""
    p = d.red.reduced_metric(d.x) @ d.xdot
    tensor = pinred.poisson.tensor(d.red, d.x, p, d.mu)
    close(tensor, -tensor.T, 100.0)
    space = pinred.poisson.phase_space(d.system)
    function = pinred.poisson.bracket(space.x[0], space.p[0])
    assert function.shape == (1, 1)
    assert len(pinred.poisson.casimirs(d.system)) == 2


def at_shape(d: Diver) -> None:
    """All objects at a shape at once equal those one by one."""
    at = d.red.at(d.x)
    close(at.local_connection, d.red.local_connection(d.x))
    assert (at.dA.shape, at.dI.shape, at.dM.shape) == ((6, 9, 9), (6, 6, 9), (9, 9, 9))


def grid(d: Diver) -> None:
    """The grid at two shapes equals the objects at each."""
    shapes = np.array([d.x, d.system.space.neutral])
    expected = [d.red.curvature(x) for x in shapes]
    close(d.red.grid(shapes).curvature, expected, 10.0)


def accelerations(d: Diver) -> Array:
    """Return the accelerations of ABA with gravity off."""
    model = d.system.model.copy()
    model.gravity.setZero()
    return np.asarray(pin.aba(model, model.createData(), d.q, d.v, np.zeros(15)))


def lagrange_poincare(d: Diver) -> None:
    """The accelerations are ABA's."""
    omega = d.red.locked_velocity(d.x, d.xdot, d.xi)
    terms = pinred.equations.lagrange_poincare(d.red, d.x, d.xdot, omega)
    close(terms.xddot, accelerations(d)[6:], 100.0)


def hamilton_poincare(d: Diver) -> None:
    """The rate is that of the momentum."""
    p = d.red.reduced_metric(d.x) @ d.xdot
    terms = pinred.equations.hamilton_poincare(d.red, d.x, p, d.mu)
    close(terms.xdot, d.xdot, 10.0)
    close(terms.energy, d.red.kinetic_energy(d.x, d.xdot, d.xi), 100.0)


def euler_poincare(d: Diver) -> None:
    """At a fixed shape the momentum obeys μ̇ = ad*_ξ μ."""
    terms = pinred.equations.euler_poincare(d.red, d.x, d.xi)
    mu = d.red.locked_inertia(d.x) @ d.xi
    close(terms.momentum.total, pin.Motion(d.xi).action.T @ mu, 100.0)


def simulate(d: Diver) -> None:
    """The motion agrees with ABA."""
    assert pinred.compare(d.traj).passed


def forces(d: Diver) -> None:
    """Energy and momentum balance with a spring, a damper and a torque along an axis."""
    acting = [
        pinred.forces.BallSpring("hips", 20.0, law="cosine"),
        pinred.forces.Damper("hips.x", 1.0),
        pinred.forces.Torque(lambda t, *_: {"left_shoulder.y": ca.sin(t)}),
    ]
    traj = pinred.simulate(d.system, seed=1, duration=0.2, forces=acting)
    assert np.abs(traj.energy_balance.residual).max() <= 1e-7
    assert traj.energy_balance.work.shape == (len(traj.t), len(traj.energy_balance.labels))
    assert np.isfinite(traj.momentum_balance.residual).all()
    assert pinred.compare(traj).passed


def pivoted(_: Diver) -> None:
    """A diver on a pivot falls as a heavy top with limbs."""
    top = pinred.load("diver", group="SO3")
    traj = pinred.simulate(top, seed=1, duration=0.1)
    assert pinred.compare(traj).passed


def closed_loops(_: Diver) -> None:
    """A gripper on closed loops moves as by ABA with multipliers, which it reports."""
    traj = pinred.simulate(pinred.load("gripper"), seed=1, duration=0.1)
    assert pinred.compare(traj).passed
    assert all(np.isfinite(force).all() for force in traj.loop_forces.values())


def loop_reduction(_: Diver) -> None:
    """Joint rates along G keep the loops closed, and their base motion has no momentum."""
    four_bar = pinred.load("four_bar")
    traj = pinred.simulate(four_bar, seed=1, duration=0.1)
    at = pinred.LoopReduction(four_bar).at(traj.x[0])
    xdot = at.G[:, 0]
    v = four_bar.v(-at.local_connection[:, 0], xdot)
    model, q = four_bar.model, traj.q[0]
    close(pin.computeCentroidalMomentum(model, model.createData(), q, v).vector, 0.0, 10.0)


def shape_alone(d: Diver) -> None:
    """The shape does not depend on whether the base is reconstructed."""
    alone = pinred.simulate(d.system, seed=1, duration=0.2, outputs="shape")
    np.testing.assert_allclose(alone.x, d.traj.x, atol=1e-8)


def many(d: Diver) -> None:
    """Members of a batch equal single motions."""
    batch = pinred.simulate_many(d.system, seeds=range(2), duration=0.2)
    np.testing.assert_allclose(batch.x[1][-1], d.traj.x[-1], atol=1e-7)


def skipped(d: Diver) -> None:
    """The reports name what is skipped."""
    assert "translation of the base" in str(pinred.inspect(d.system))
    assert pinred.simulate(d.system, duration=0.1, explain=True) is not None


def casadi(d: Diver) -> None:
    """The function of A equals the method."""
    functions = pinred.casadi_functions(d.system)
    close(functions.local_connection(d.x), d.red.local_connection(d.x))


def equilibria(d: Diver) -> None:
    """A diver with sprung joints rotates steadily, and the simulation keeps the shape."""
    springs = [pinred.forces.BallSpring(j.name, 500.0) for j in d.system.space.balls]
    found = pinred.relative_equilibria(d.system, momentum=5.0, forces=springs, starts=8, limit=8)
    traj = pinred.simulate(found[0].scene(duration=0.2))
    np.testing.assert_allclose(traj.x, np.broadcast_to(found[0].x, traj.x.shape), atol=1e-9)


def stability(d: Diver) -> None:
    """The linearised motion has two rows for each pair of momentum and coordinate."""
    assert len(pinred.linearise(d.traj, 0.1).names) >= 18


def flow(d: Diver) -> None:
    """The derivative by the rate of a ball equals a difference of two runs."""
    how: dict[str, Any] = {"x0": d.x, "momentum": 0, "duration": 0.1, "rtol": 1e-12}
    run, h = pinred.flow(d.system, wrt=["xdot0"], of=["xdot"], **how), 1e-5
    slope = run.jacobian(xdot0=d.xdot)["xdot0"][:, 4]
    ahead, behind = (run(xdot0=d.xdot + step * np.eye(9)[4]) for step in (h, -h))
    np.testing.assert_allclose(slope, (ahead.xdot - behind.xdot) / (2.0 * h), atol=1e-7)


def figures(d: Diver) -> None:
    """A figure of the motion can be drawn."""
    pytest.importorskip("matplotlib")
    assert pinred.plot(d.traj, "shape") is not None


ROWS: dict[str, Callable[[Diver], None]] = {
    "mass matrix, base rows first": mass_matrix,
    "locked inertia": locked_inertia,
    "mechanical connection, local form": local_connection,
    "reduced metric": reduced_metric,
    "curvature, body form": curvature,
    "locked velocity": locked_velocity,
    "body momentum": body_momentum,
    "spatial momentum": spatial_momentum,
    "potential, amended potential": potential,
    "connection form, curvature form, locked inertia in space": forms,
    "vertical and horizontal parts": parts,
    "another section g h(x)": section,
    "Levi-Civita connection and curvature of M": levi_civita,
    "Poisson bracket, Casimirs": poisson,
    "all of the above, and dI, dA, dM": at_shape,
    "I, A, M, B, V at thousands of shapes": grid,
    "Lagrange–Poincaré, term by term": lagrange_poincare,
    "Hamilton–Poincaré": hamilton_poincare,
    "Euler–Poincaré": euler_poincare,
    "reduced simulation and reconstruction": simulate,
    "forces, prescribed joints, balances, driving torques": forces,
    "heavy tops, pinned chains": pivoted,
    "closed loops: four-bars, grippers, parallel legs": closed_loops,
    "the same in independent joints, ẋ = G u̇": loop_reduction,
    "the shape alone": shape_alone,
    "batches over states, parameters, gravity, scenes": many,
    "skipped terms of a scene": skipped,
    "I, A, M, B and the vector field for CasADi": casadi,
    "steady motions, their stability, branches over the momentum": equilibria,
    "stability along a motion": stability,
    "the flow with derivatives; parameters that vary without a new kernel": flow,
    "figures (extra `plots`)": figures,
    "comparison": simulate,
}


def test_each_row_is_listed() -> None:
    """A new row of docs/concepts.md needs an entry."""
    table = CONCEPTS.split("# From concept to code")[1].split("\n## ")[0]
    lines = [line for line in table.splitlines() if line.startswith("| ")]
    assert [line.split(" | ")[0].removeprefix("| ") for line in lines[1:]] == list(ROWS)


@pytest.mark.parametrize("row", ROWS.values(), ids=ROWS)
@pytest.mark.sampled(4)
def test_row_works_with_balls(diver: Diver, row: Callable[[Diver], None]) -> None:
    """The row's calls work on the diver, and obey the row's formula."""
    row(diver)
