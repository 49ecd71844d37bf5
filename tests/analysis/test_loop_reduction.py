"""The reduction and the connection of robots with loops, against differences and Pinocchio."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from loop_robots import five_bar, four_bar, planar_legs, random_loops
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

import pinred
from pinred.analysis.connections.loop_connection import ClosedPath
from pinred.common.arrays import Array
from pinred.common.errors import InputError, SingularInertiaError, UnsupportedOperationError
from pinred.system.loops.independent_joints import loop_chart
from pinred.system.loops.loop import Loop

ROBOTS: dict[str, Callable[[], tuple[pin.Model, list[Loop]]]] = {
    "five-bar": five_bar,
    "in space": lambda: random_loops(1, ("6d",), 4),
    "redundant": planar_legs,
    "with balls": lambda: random_loops(3, ("3d", "3d"), 3, balls=True),
}
INDEPENDENT = ("left_crank", "right_crank")


def linkage() -> pinred.System:
    """Return the five-bar linkage."""
    model, loops = five_bar()
    return pinred.load(model, loops=loops)


def circle(centre: Array, radius: float) -> pinred.Gait:
    """Return a circle in the plane of the two cranks."""
    return pinred.Gait.fourier(centre, [[radius, 0.0]], [[0.0, radius]])


def derivative(function: Callable[[Array], Array], u: Array, h: float = 2e-3) -> Array:
    """Return central differences of order 6 with the index of u last."""
    columns = []
    for unit in np.eye(len(u)):
        f = [function(u + k * h * unit) for k in (-3, -2, -1, 1, 2, 3)]
        columns.append((f[5] - f[0] + 9.0 * (f[1] - f[4]) + 45.0 * (f[3] - f[2])) / (60.0 * h))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("robot", ["five-bar", "in space", "redundant"])
@pytest.mark.sampled
def test_curvature_and_derivatives_equal_differences(robot: str) -> None:
    """GᵀBG is the curvature of A G, and all derivatives contain that of G."""
    model, loops = ROBOTS[robot]()
    system = pinred.load(model, loops=loops)
    red = pinred.LoopReduction(system)
    at = [system.shape_names.index(name) for name in red.independent]
    assert system.closure is not None
    u = system.closure.x[at] + 0.03 * np.random.default_rng(0).normal(size=len(at))
    here = red.at(red.shape(u))
    np.testing.assert_allclose(here.x[at], u, atol=1e-14)
    names = ("local_connection", "G", "reduced_metric", "locked_inertia")

    def values(u: Array) -> Array:
        at = red.at(red.shape(u))
        return np.concatenate([getattr(at, name).ravel() for name in names])

    changes = derivative(values, u)
    for name, change in zip(names, (here.dA, here.dG, here.dM, here.dI), strict=True):
        expected, changes = changes[: change[..., 0].size], changes[change[..., 0].size :]
        expected = expected.reshape(change.shape)
        np.testing.assert_allclose(change, expected, atol=1e-10 * max(1.0, np.abs(change).max()))
        if name == "local_connection":
            A, ad = here.local_connection, system.group.ad
            bracket = np.stack([ad(column) @ A for column in A.T], axis=1)
            B = expected.transpose(0, 2, 1) - expected - bracket
            np.testing.assert_allclose(here.curvature, B, atol=1e-10)


@pytest.mark.parametrize("robot", ["five-bar", "with balls"])
def test_rates_of_a_motion_are_those_of_the_independent_joints(robot: str) -> None:
    """Along a simulated motion ẋ = G u̇, and the kinetic energy is that of the reduced metric."""
    model, loops = ROBOTS[robot]()
    system = pinred.load(model, loops=loops)
    start = pinred.Scene(system=system, seed=1).start
    traj = pinred.simulate(
        system, x0=start.x, xdot0=start.xdot, momentum=0, duration=0.02, engine="pinocchio"
    )
    red = pinred.LoopReduction(system)
    here, xdot = red.at(traj.x[-1]), traj.xdot[-1]
    rates = xdot[[system.space.names.index(name) for name in red.independent]]
    np.testing.assert_allclose(here.G @ rates, xdot, atol=1e-9 * np.abs(xdot).max())
    xi = -here.local_connection @ rates
    np.testing.assert_allclose(xi, traj.xi[-1], atol=1e-9 * np.abs(traj.xi).max())
    energy = 0.5 * rates @ here.reduced_metric @ rates
    np.testing.assert_allclose(energy, traj.energy[-1], rtol=1e-9)
    assert here.amended_potential(np.zeros(system.r)) == 0.0


def test_phase_of_a_gait_equals_an_integration_with_pinocchio() -> None:
    """The couplers follow the cranks; SciPy closes the linkage, and CRBA gives the momentum."""
    system = linkage()
    connection = pinred.Connection.mechanical(system, independent=INDEPENDENT)
    red = pinred.LoopReduction(system, independent=INDEPENDENT)
    assert connection.joints == red.independent == INDEPENDENT
    centre, size = np.array([2.0, 1.0]), 0.4
    gait = circle(centre, size)
    model, data, frames = system.model, system.model.createData(), ("left_tip", "right_tip")
    names = [system.shape_names.index(name) for name in INDEPENDENT]
    others = [k for k in range(4) if k not in names]
    x = red.shape(gait.at(0.0)[0])

    def closed(u: Array) -> Array:
        def gap(couplers: Array) -> Array:
            q = np.concatenate([[0.0, 0.0, 1.0, 0.0], np.zeros(4)])
            q[[4 + k for k in names]], q[[4 + k for k in others]] = u, couplers
            pin.framesForwardKinematics(model, data, q)
            a, b = (data.oMf[model.getFrameId(name)].translation for name in frames)
            return np.asarray((a - b)[:2])

        x[names] = u
        x[others] = fsolve(gap, x[others], xtol=1e-11)
        return x

    def rate(t: float, pose: Array) -> Array:
        u, udot = gait.at(t)
        h = 1e-4
        ahead, behind = (closed(u + k * h * udot).copy() for k in (1, -1))
        q = np.concatenate([[0.0, 0.0, 1.0, 0.0], closed(u)])
        H = pin.crba(model, data, q)
        H = np.triu(H) + np.triu(H, 1).T
        v = -np.linalg.solve(H[:3, :3], H[:3, 3:] @ (ahead - behind) / (2.0 * h))
        c, s = np.cos(pose[2]), np.sin(pose[2])
        return np.array([c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]])

    end = solve_ivp(rate, (0.0, gait.period), np.zeros(3), "DOP853", rtol=1e-9, atol=1e-11).y[:, -1]
    pose = pinred.phase(connection, gait).pose
    assert abs(end[2]) > 1e-3
    np.testing.assert_allclose(pose, end, atol=1e-8)


@pytest.mark.by_hand
def test_legs_of_a_biped_turn_as_a_whole() -> None:
    """A turn of both hips of a leg closes the gait; it turns the torso backwards."""
    biped = pinred.load("parallel_biped", gravity=[0.0, 0.0, 0.0])
    motors = [f"{side}_{end}_hip" for side in ("left", "right") for end in ("front", "rear")]
    connection = pinred.Connection.mechanical(biped, independent=motors)
    mean, still = [-0.9, 0.9] * 2, np.zeros((1, 4))
    turn = pinred.phase(connection, pinred.Gait.fourier(mean, still, still, turns=[1] * 4))
    assert -110.0 < np.degrees(turn.log[4]) < -90.0


def test_slopes_of_horizontal_motions_equal_differences() -> None:
    """The derivative of the twist contains that of G."""
    connection = pinred.Connection.mechanical(linkage(), independent=INDEPENDENT)
    u, rate = np.array([2.0, 1.0]), np.array([0.5, -0.7])

    def values(y: Array) -> Array:
        xi, square = connection.horizontal(y[None, :2], y[None, 2:])
        return np.append(xi[0], square[0])

    slopes = connection.horizontal_slopes(u[None], rate[None])[0]
    np.testing.assert_allclose(slopes, derivative(values, np.append(u, rate)), atol=1e-10)
    terms = connection.grid(u[None])
    np.testing.assert_allclose(terms.curvature, terms.exterior - terms.bracket, atol=1e-15)


def test_torques_of_independent_joints_equal_those_of_virtual_work() -> None:
    """Forces by the reduced metric and its derivatives, and gradients by differences."""
    connection = pinred.Connection.mechanical(linkage(), independent=INDEPENDENT)
    red = pinred.LoopReduction(linkage(), independent=INDEPENDENT)
    motion, along = np.array([[2.0, 1.0], [0.5, -0.7], [0.3, 0.9]]), np.array([0.4, -1.1])

    def power(y: Array) -> Array:
        u, udot, uddot = y.reshape(3, 1, 2)
        forces, _ = connection.code.covariant_forces(u, udot, uddot, along[None])
        return np.asarray(forces @ along)

    u, udot, uddot = motion
    here = red.at(red.shape(u))
    dM = here.dM
    expected = here.reduced_metric @ uddot + np.einsum("abc,b,c->a", dM, udot, udot)
    expected -= 0.5 * np.einsum("bca,b,c->a", dM, udot, udot)
    states = (u[None], udot[None], uddot[None])
    values, gradient = connection.code.covariant_forces(*states, along[None])
    np.testing.assert_allclose(values[0], expected, atol=1e-12)
    slopes = derivative(power, motion.ravel())[0]
    np.testing.assert_allclose(gradient[0], slopes, atol=1e-9 * np.abs(slopes).max())


def swimming(system: pinred.System, kind: str) -> pinred.Connection:
    """Return a connection of the five-bar linkage, or of its tree, in a fluid or on wheels."""
    chosen = INDEPENDENT if system.loops else None
    names = ("left_crank", "right_coupler")
    if kind == "viscous":
        drag = {name: np.diag([1.0, 2.0, 3.0, 0.3, 0.2, 0.1]) for name in names}
        drag["base"] = np.diag([2.0, 3.0, 1.0, 0.1, 0.1, 0.5])
        return pinred.Connection.viscous(system, drag, independent=chosen)
    if kind == "fluid":
        bodies = {name: pinred.Ellipse(0.4, 0.1) for name in names}
        return pinred.Connection.fluid(system, 2.0, bodies, independent=chosen)
    wheels = [pinred.Wheel("base"), pinred.Wheel("left_crank"), pinred.Wheel("right_coupler")]
    return pinred.Connection.kinematic(system, wheels, independent=chosen)


@pytest.mark.parametrize(
    "kind", ["viscous", "kinematic", pytest.param("fluid", marks=pytest.mark.by_hand)]
)
def test_connections_of_fluids_and_wheels_are_pulled_back(kind: str) -> None:
    """A and M are those of the open tree along G, which differences of closed shapes give."""
    system = linkage()
    connection = swimming(system, kind)
    red, u = pinred.LoopReduction(system, independent=INDEPENDENT), np.array([2.0, 1.0])
    G, x = derivative(red.shape, u), red.shape(u)
    tree = swimming(system.open_tree(), kind)
    np.testing.assert_allclose(connection.local(u), tree.local(x) @ G, atol=1e-10)
    if kind != "kinematic":
        np.testing.assert_allclose(connection.metric(u), G.T @ tree.metric(x) @ G, atol=1e-10)
    dA, A = derivative(connection.local, u), connection.local(u)
    bracket = np.stack([system.group.ad(column) @ A for column in A.T], axis=1)
    B = dA.transpose(0, 2, 1) - dA - bracket
    np.testing.assert_allclose(connection.curvature(u), B, atol=1e-8 * np.abs(B).max())
    gait = circle(u, 0.3)
    moved = pinred.phase(connection, gait).pose
    assert np.abs(moved).max() > 1e-4


def test_inspection_reports_loops_rank_and_dimension() -> None:
    """The matrices are those of independent joints."""
    system = linkage()
    inspection = pinred.inspect(system)
    text = str(inspection)
    assert "tips: left_tip = right_tip (3d)" in text
    assert "3 equations of rank 2, closed shapes of dimension 2" in text
    assert inspection.at.local_connection.shape == (3, 2)
    assert not inspection.flat
    model, loops = four_bar()
    assert pinred.inspect(pinred.load(model, loops=loops)).flat


def test_coordinates_have_the_order_of_independent() -> None:
    """Exchanged coordinates exchange the columns of A and the sign of the curvature."""
    system = linkage()
    red, exchanged = (
        pinred.LoopReduction(system, independent=names)
        for names in (INDEPENDENT, INDEPENDENT[::-1])
    )
    assert exchanged.independent == INDEPENDENT[::-1]
    assert system.closure is not None
    x = system.closure.x
    a, b = red.at(x), exchanged.at(x)
    assert abs(a.local_connection[:, 0] - a.local_connection[:, 1]).max() > 1e-3
    np.testing.assert_allclose(b.local_connection, a.local_connection[:, ::-1], atol=1e-14)
    np.testing.assert_allclose(b.curvature, -a.curvature, atol=1e-13)
    u = x[[system.shape_names.index(name) for name in INDEPENDENT]]
    np.testing.assert_allclose(exchanged.shape(u[::-1] + 0.1), red.shape(u + 0.1), atol=1e-12)
    forms = [
        pinred.Connection.mechanical(system, independent=names).local(order)
        for names, order in ((INDEPENDENT, u), (INDEPENDENT[::-1], u[::-1]))
    ]
    np.testing.assert_allclose(forms[1], forms[0][:, ::-1], atol=1e-13)
    with pytest.raises(InputError, match="each once, got left_crank, left_crank"):
        pinred.LoopReduction(system, independent=["left_crank", "left_crank"])


def test_charts_that_do_not_fit_are_refused_by_name() -> None:
    """Unknown joints, a wrong number, dead points, open shapes, frames and robots without loops."""
    system = linkage()
    with pytest.raises(InputError, match="independent: no joint 'knee'"):
        pinred.LoopReduction(system, independent=["knee", "left_crank"])
    with pytest.raises(InputError, match="independent: expected 2 joints, each once, got"):
        pinred.LoopReduction(system, independent=["left_crank"])
    red = pinred.LoopReduction(system, independent=INDEPENDENT)
    with pytest.raises(InputError, match="expected a closed shape of 'five_bar', but loop 'tips'"):
        red.at(np.zeros(4))
    with pytest.raises(SingularInertiaError, match=r"the loops tips of.*independent="):
        red.shape([np.pi, 0.0])
    tree = pinred.load("planar_chain5")
    with pytest.raises(InputError, match="expected a robot with loops"):
        pinred.LoopReduction(tree)
    with pytest.raises(InputError, match="independent: expected none"):
        pinred.Connection.mechanical(tree, independent=["a"])
    connection = pinred.Connection.mechanical(system, independent=INDEPENDENT)
    for change in (
        lambda: connection.in_chart([0.1, 0.2]),
        lambda: connection.seen_from("left_crank"),
        lambda: connection.in_section(lambda x: x),
        lambda: pinred.Reduction(system),
    ):
        with pytest.raises(UnsupportedOperationError, match="closed loops are not supported here"):
            change()
    model, loops = four_bar()
    crank = pinred.LoopReduction(pinred.load(model, loops=loops), independent=["crank"])
    assert crank.at(crank.shape([3.0])).curvature.shape == (3, 1, 1)


@pytest.mark.parametrize(
    "robot", ["five-bar", "redundant", pytest.param("in space", marks=pytest.mark.by_hand)]
)
@pytest.mark.sampled
def test_shapes_of_a_batch_equal_those_followed_one_by_one(robot: str) -> None:
    """CasADi's loops agree with Pinocchio's, also for G and for its derivatives."""
    model, loops = ROBOTS[robot]()
    system = pinred.load(model, loops=loops)
    chart = loop_chart(system)
    path, rng = ClosedPath(chart), np.random.default_rng(0)
    assert system.closure is not None
    u = system.closure.x[chart.independent] + 0.1 * rng.normal(size=(8, system.shape_dim))
    shapes, rates = path.shapes(u), rng.normal(size=(8, system.shape_dim))
    np.testing.assert_allclose(shapes, chart.shapes(u), atol=1e-13)
    G = path.tangents(shapes)
    xdot = np.einsum("nma,na->nm", G, rates)
    turned = path.turned(shapes, G, xdot)
    for k, x in enumerate(shapes):
        expected = chart.tangent(x)
        np.testing.assert_allclose(G[k], expected, atol=1e-12 * np.abs(G).max())
        changes = [chart.tangent_rate(x, c, expected) @ rates[k] for c in expected.T]
        bound = 1e-11 * np.abs(turned).max()
        np.testing.assert_allclose(turned[k], np.stack(changes, axis=-1), atol=bound)


def test_shapes_of_a_batch_end_where_the_loops_do_not_close() -> None:
    """Lines to shapes that cannot be reached are an error, not another branch."""
    connection = pinred.Connection.mechanical(linkage(), independent=INDEPENDENT)
    with pytest.raises(SingularInertiaError, match="do not determine the other joints"):
        connection.grid([[2.0, 1.0], [3.3, -0.2]]).curvature  # noqa: B018


@pytest.mark.by_hand
def test_optimal_gait_of_a_five_bar_turns_further_than_random_ellipses() -> None:
    """Within limits and a path length, no ellipse of 40 turns the base further."""
    connection = pinred.Connection.mechanical(linkage(), independent=INDEPENDENT)
    limits = {"left_crank": (1.5, 2.5), "right_crank": (0.6, 1.5)}
    parts: list[float] = []
    best = pinred.optimise_gait(
        connection, most=0.6, harmonics=1, starts=1, limits=limits, progress=parts.append
    )
    assert parts[-1] == 1.0
    turn = abs(float(pinred.phase(connection, best.gait).pose[2]))
    rng, others = np.random.default_rng(0), []
    for _ in range(40):
        centre = rng.uniform([1.7, 0.8], [2.3, 1.3])
        ellipse = rng.normal(size=(2, 2))
        room = np.minimum(centre - [1.5, 0.6], [2.5, 1.5] - centre)
        ellipse *= (room / np.linalg.norm(ellipse, axis=0)).min() * rng.uniform(0.3, 1.0)
        gait = pinred.Gait.fourier(centre, ellipse[:1], ellipse[1:])
        s = np.linspace(0.0, 1.0, 65)[:-1]
        states = [gait.at(t * gait.period) for t in s]
        metrics = [connection.metric(u) for u, _ in states]
        speeds = [np.sqrt(v @ M @ v) for (_, v), M in zip(states, metrics, strict=True)]
        if np.mean(speeds) * gait.period <= 0.6:
            others.append(abs(float(pinred.phase(connection, gait).pose[2])))
    assert len(others) > 5
    assert turn >= max(others)
