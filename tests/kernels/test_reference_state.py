"""Tests of random states, and of the magnitudes of summed terms for a cart and pole."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from ball_trees import ball_tree
from loop_robots import five_bar
from trees import random_model

import pinred
from pinred import forces
from pinred.common.arrays import Array
from pinred.kernels.flow_functions import Row, initial_conditions_of, outcome_of, sizes_of
from pinred.kernels.kernel import Kernel, Structure, layout_of
from pinred.kernels.reduced_graph import ReducedGraph
from pinred.kernels.reference_state import ReferenceState, random_state
from pinred.reduction.tree.free_bodies import STEP, Freed, free_numbers
from pinred.simulation.compiled.compiled_flow import kernel_of
from pinred.simulation.plan import plan_of

CART, POLE, LEVER, MOMENT, G = 2.0, 1.0, 0.5, 0.09, 9.81  # of robots/cartpole.urdf, SI
REACH = LEVER + np.sqrt(0.19 / POLE)  # of the pole: its centre of mass and radius of gyration


def random_cartpole_state() -> ReferenceState:
    """Return a random state of the cart and pole, with momentum along the slide."""
    system = pinred.load("cartpole")
    kernel = kernel_of(plan_of(pinred.Scene(system=system, seed=0)), zero_momentum=False)
    at = random_state(kernel, np.random.default_rng(3), 1.0)
    assert at is not None
    return at


def test_terms_equal_closed_form() -> None:
    """Terms of momenta, velocities, forces and gravity, before cancellation."""
    at = random_cartpole_state()
    coupled = -POLE * LEVER * np.cos(at.x[0])
    H = np.array([[CART + POLE, coupled], [coupled, MOMENT + POLE * LEVER**2]])
    assert pytest.approx(H) == at.H
    assert at.reach == pytest.approx(REACH)
    v = np.abs(at.v)
    momentum = np.abs(H) @ v
    assert at.momentum_terms == pytest.approx(momentum)
    inverse = np.abs(np.linalg.inv(H))
    assert at.velocity_terms == pytest.approx(inverse @ momentum + v)
    assert at.solved_terms(np.array([2.0, 3.0])) == pytest.approx(inverse @ [2.0, 3.0])
    speed = v[0] + REACH * v[1]
    moving = np.array([(CART + POLE) * speed * v[1], POLE * speed**2])
    assert at.force_terms == pytest.approx(v[1] * momentum + moving)
    assert at.gravity_terms == pytest.approx([(CART + POLE) * G, POLE * G * REACH])


def test_random_states_cover_shapes_and_velocities() -> None:
    """Joints rotate fully, and the base has zero linear momentum."""
    system = pinred.load("planar_chain5")
    kernel = kernel_of(plan_of(pinred.Scene(system=system, seed=0)), zero_momentum=False)
    rng = np.random.default_rng(0)
    states = [random_state(kernel, rng, 1.0) for _ in range(20)]
    x = np.array([at.x for at in states if at is not None])
    v = np.array([at.v for at in states if at is not None])
    assert 1.9 < np.abs(x).max() <= 2.0
    assert 0.5 < v[:, 3:].std() < 2.0
    turns = np.array([at.pose[2] for at in states if at is not None])
    assert 0.3 < np.abs(turns).max() <= 1.0
    # The linear momentum is zero, and its components share the largest terms.
    at = states[0]
    assert at is not None
    assert at.mu[:2] == pytest.approx([0.0, 0.0])
    terms = np.abs(at.H) @ np.abs(at.v)
    terms[:2] = (terms[:2] + system.mass * at.reach * abs(at.v[2])).max()
    assert at.momentum_terms == pytest.approx(terms)


def test_terms_scale_with_velocity() -> None:
    """Momenta scale linearly and forces quadratically, however small they are."""
    at = random_cartpole_state()
    slow = replace(at, v=1e-6 * at.v)
    assert slow.momentum_terms == pytest.approx(1e-6 * at.momentum_terms, rel=1e-9, abs=0.0)
    assert slow.velocity_terms == pytest.approx(1e-6 * at.velocity_terms, rel=1e-9, abs=0.0)
    assert slow.force_terms == pytest.approx(1e-12 * at.force_terms, rel=1e-9, abs=0.0)


def test_reach_is_largest_distance_from_root() -> None:
    """The reach is that of the farthest joint with its body, for any position of the root."""
    model = random_model("SE3", 4, 2)
    system = pinred.load(model)
    kernel = kernel_of(plan_of(pinred.Scene(system=system, seed=0)), zero_momentum=False)
    at = random_state(kernel, np.random.default_rng(3), 1.0)
    assert at is not None
    pin.forwardKinematics(
        at.model, at.data, pin.neutral(at.model)
    )  # other functions overwrite this data
    whole, data = [], system.model.createData()
    pin.forwardKinematics(system.model, data, at.q)
    for joint, body in list(zip(data.oMi, system.model.inertias, strict=True))[1:]:
        size = np.linalg.norm(body.lever) + np.sqrt(np.trace(body.inertia) / body.mass)
        whole.append(np.linalg.norm(joint.translation - data.oMi[1].translation) + size)
    assert at.reach == pytest.approx(max(whole))


def test_random_state_scales_shape_and_velocity() -> None:
    """A smaller state has proportionally smaller shape and velocity."""
    system = pinred.load("planar_chain5")
    kernel = kernel_of(plan_of(pinred.Scene(system=system, seed=0)), zero_momentum=False)
    whole, part = (random_state(kernel, np.random.default_rng(0), size) for size in (1.0, 0.1))
    assert whole is not None
    assert part is not None
    assert part.x == pytest.approx(0.1 * whole.x)
    assert part.v[3:] == pytest.approx(0.1 * whole.v[3:])


def test_random_states_cover_both_signs_and_the_time_span() -> None:
    """Angles and shapes have both signs; times cover 0 to 1 s or the span of a table."""
    system = pinred.load("planar_chain5")
    name = system.shape_names[0]

    def drawn(**options: Any) -> list[ReferenceState]:
        scene = pinred.Scene(system=system, seed=0, duration=0.5, **options)
        kernel, rng = kernel_of(plan_of(scene), zero_momentum=False), np.random.default_rng(0)
        return [at for _ in range(60) if (at := random_state(kernel, rng, 1.0)) is not None]

    states = drawn()
    x, turns = np.array([at.x for at in states]), np.array([at.pose[2] for at in states])
    times = np.array([at.time for at in states])
    for values, low, high in ((x, -2.0, 2.0), (turns, -1.0, 1.0), (times, 0.0, 1.0)):
        margin = 0.07 * (high - low)
        assert low <= values.min() < low + margin
        assert high - margin < values.max() <= high
    # Tables of one kind share a kernel, whose states belong to the first of them.
    for table, first, last in (
        (pinred.signals.Spline, -3.0, 0.7),
        (pinred.signals.Linear, 0.0, 0.6),
    ):
        knots = np.linspace(first, last, 5)
        torque = forces.Torque({name: table(knots, np.sin(knots))})
        times = np.array([at.time for at in drawn(forces=torque)])
        assert 0.0 <= times.min() < 0.1
        assert 0.8 * last < times.max() <= last


def test_random_state_undefined_prescription_returns_none() -> None:
    """States at which a prescribed motion is undefined are skipped."""
    system = pinred.load("planar_chain5")
    plan = {system.shape_names[1]: pinred.signals.Expression("sqrt(0.3 - t)")}
    scene = pinred.Scene(system=system, seed=0, prescribed=plan, duration=0.1)
    kernel, rng = kernel_of(plan_of(scene), zero_momentum=False), np.random.default_rng(0)
    states = [random_state(kernel, rng, 1.0) for _ in range(30)]
    found = [at for at in states if at is not None]
    assert 5 < len(found) < 25
    for at in found:
        assert at.time < at.force_parameters[0] if at.force_parameters.size else at.time < 0.3
        assert np.isfinite([*at.x, *at.v, *at.accelerations]).all()


def draw(kernel: Kernel, seed: int = 3, **options: Any) -> ReferenceState:
    """Return the random state of a seed."""
    at = random_state(kernel, np.random.default_rng(seed), 1.0, **options)
    assert at is not None
    return at


def cartpole(gravity: float = 0.0, **options: Any) -> Kernel:
    """Return the kernel of the cart and pole, with other gravity."""
    model = pinred.load("cartpole").model.copy()
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    scene = pinred.Scene(system=pinred.load(model), seed=0, duration=1.0, **options)
    return kernel_of(plan_of(scene), zero_momentum=False)


def test_sizes_equal_closed_form() -> None:
    """Lengths from joints and bodies, momenta from the mass matrix, times from gravity."""
    at = draw(cartpole(G))
    sizes, period = at.sizes, np.sqrt(REACH / G)
    assert sizes.length == pytest.approx(REACH)
    assert sizes.mass == pytest.approx(CART + POLE)
    assert sizes.steps == pytest.approx([REACH, 1.0])
    assert sizes.time == pytest.approx(period)
    moved = np.array([(CART + POLE) * REACH, MOMENT + POLE * LEVER**2])
    assert sizes.momenta == pytest.approx(moved / period)


def test_time_is_that_of_forces() -> None:
    """Springs, dampers, prescribed joints, time-dependent forces and free fall determine it."""
    inertia = (CART + POLE) * REACH**2 + MOMENT + POLE * LEVER**2
    pole, slow = "pole_pivot", pinred.signals.Expression("1e-9*sin(t)")
    assert draw(cartpole()).sizes.time == 1.0
    at = draw(cartpole(forces=forces.Spring(pole, 3.0)))
    stiffness = np.abs(at.force_parameters).max()
    assert at.sizes.time == pytest.approx(np.sqrt(inertia / (stiffness * abs(at.x[0]))))
    at = draw(cartpole(forces=forces.Damper(pole, 3e3)))
    assert at.sizes.time == pytest.approx(inertia / np.abs(at.force_parameters).max())
    assert draw(cartpole(forces=forces.Torque({pole: slow}))).sizes.time == 1.0
    at = draw(cartpole(prescribed={pole: pinred.signals.Expression("0.3*sin(40*t)")}))
    assert abs(at.v[1]) > 1.5
    assert at.sizes.time == pytest.approx(1.0 / abs(at.v[1]))
    falling = random_model("SE3", 3, 1)
    falling.gravity.linear = np.array([0.0, 0.0, -8.0])
    scene = pinred.Scene(system=pinred.load(falling), seed=0)
    sizes = draw(kernel_of(plan_of(scene), zero_momentum=False)).sizes
    assert sizes.time == pytest.approx(np.sqrt(sizes.length / 8.0))


def test_time_of_conditions_is_kept() -> None:
    """Conditions on time were evaluated at the time that was drawn; other times have the unit."""
    stepped = pinred.signals.Expression("0.1 + 0.1*(t < 0.5)")
    kernel = cartpole(forces=forces.Torque({"pole_pivot": stepped}))
    assert kernel.forces is not None
    assert not kernel.layout.clock
    for seed in range(5):
        at = draw(kernel, seed)
        assert abs(at.sizes.time - 1.0) > 0.1
        assert at.force_parameters[kernel.forces.within] == pytest.approx(at.time)
    at, period = draw(cartpole(G)), np.sqrt(REACH / G)
    other = draw(cartpole(100.0 * G))
    assert at.time == pytest.approx(10.0 * other.time)
    assert at.time < period


def test_numbers_that_are_zero_have_the_size_of_their_effect() -> None:
    """A force, a number in a formula, and a prescribed position, in the robot's own units."""
    formula = pinred.signals.Expression("0.1*(t + 0.0)")
    pulls = [forces.Wrench([0.0]), forces.Torque({"pole_pivot": formula})]
    kernel = cartpole(G, forces=pulls)
    assert kernel.forces is not None
    at = draw(kernel)
    force = at.sizes.momenta / at.sizes.time
    zeros = np.flatnonzero(kernel.forces.numbers == 0.0)
    assert at.sizes.numbers[zeros] == pytest.approx([force[0], force[1] / abs(at.parameters[-2])])
    first = zeros[0] - len(kernel.forces.numbers)
    drawn = [draw(kernel, seed).force_parameters[zeros] for seed in range(60)]
    assert np.std(drawn, axis=0) == pytest.approx([force[0], 0.0], rel=0.2)
    sizes = at.sizes.of_parameters(kernel.layout, 1, at.parameters)
    assert sizes[first] == abs(at.parameters[first])
    assert sizes[-1] == at.sizes.numbers[-1]
    system = pinred.load(random_model("SE3", 4, 3))
    slide = next(n for n, unit in zip(system.shape_names, system.units, strict=True) if unit == "m")
    offset = pinred.Parameter("offset", 0.0)
    plan = {slide: pinred.signals.Constant(offset)}
    scene = pinred.Scene(system=system, seed=0, prescribed=plan)
    kernel = kernel_of(plan_of(scene), zero_momentum=False)
    own, k = draw(kernel).sizes, system.shape_names.index(slide)
    assert own.numbers == pytest.approx([own.length])
    drawn = [draw(kernel, seed).x[k] for seed in range(60)]
    assert np.std(drawn) == pytest.approx(own.length, rel=0.2)


def own_units(kernel: Kernel) -> dict[str, list[Array]]:
    """Return random states, parameters and paths relative to their sizes."""
    rng, r, k = np.random.default_rng(1), kernel.system.r, kernel.system.group.linear
    values: dict[str, list[Array]] = {"y": [], "parameters": [], "path": []}
    for at in filter(None, (random_state(kernel, rng, 1.0) for _ in range(60))):
        sizes = at.sizes.of_parameters(kernel.layout, r, at.parameters)
        values["y"].append(at.y / at.sizes.of_state(kernel.layout, r))
        values["parameters"].append(at.parameters / sizes)
        values["path"].append((at.com_path / at.sizes.of_path(k))[: 2 * k])
    return values


def heavy_pivot() -> Kernel:
    """Return the kernel of a tree on a pivot under gravity, without its attitude."""
    model = random_model("SO3", 3, 1)
    model.gravity.linear = np.array([1.0, -2.0, 3.0])
    scene = pinred.Scene(system=pinred.load(model), seed=0, outputs="shape")
    return kernel_of(plan_of(scene), zero_momentum=False)


def pushed_tree() -> Kernel:
    """Return the kernel of a tree with a thruster whose force depends on time."""
    thrust = forces.Wrench([0.3, pinred.signals.Expression("0.1*sin(t)"), 0.0, 0.2, 0.0, 0.1])
    scene = pinred.Scene(system=pinred.load(random_model("SE3", 3, 1)), seed=0, forces=thrust)
    return kernel_of(plan_of(scene), zero_momentum=False)


def satellite(**options: Any) -> Kernel:
    """Return the kernel of a satellite with reaction wheels, which are cyclic."""
    scene = pinred.Scene(system=pinred.load("reaction_wheel_satellite"), seed=0, **options)
    return kernel_of(plan_of(scene), zero_momentum=False)


def balls(**options: Any) -> Kernel:
    """Return the kernel of a tree with balls."""
    scene = pinred.Scene(system=ball_tree(1, 3, balls=0.3), seed=0, **options)
    return kernel_of(plan_of(scene), zero_momentum=False)


@pytest.mark.by_hand("pushed")
@pytest.mark.parametrize(
    "make",
    [heavy_pivot, pushed_tree, satellite, balls, lambda: balls(method=pinred.Gauss(0.1))],
    ids=["pivot", "pushed", "wheels", "balls", "lifted"],
)
def test_random_states_have_the_size_one(make: Callable[[], Kernel]) -> None:
    """In own units, the root mean square of each entry is near one."""
    for what, values in own_units(make()).items():
        spread = np.sqrt(np.mean(np.square(values), axis=0))
        assert ((spread > 0.17) & (spread < 2.5)).all(), what


def test_samples_of_flow_functions_have_the_size_one() -> None:
    """Inputs and results of initial conditions and outcomes, in own units."""
    kernel = satellite()
    graph = ReducedGraph(kernel.system, kernel.structure, kernel.forces)
    rows: tuple[Row, ...] = ("x", "xdot", "pose", "xi", "body_momentum", "energy", "pose_numbers")
    counts = [sizes_of(kernel.system)[row] for row in rows]
    for function, ends in (
        (initial_conditions_of(kernel, "xi"), None),
        (initial_conditions_of(kernel, "mu"), None),
        (outcome_of(kernel, rows), np.cumsum(counts)[:-1]),
    ):
        rng, columns = np.random.default_rng(1), []
        compute = function.write(graph)
        for at in filter(None, (function.sample(rng) for _ in range(40))):
            result = np.array(compute(at.a, at.b)).ravel()
            columns.append(np.concatenate([at.a / at.sizes_a, result / at.sizes]))
        spread = np.sqrt(np.mean(np.square(columns), axis=0))
        inputs, results = np.split(spread, [len(at.a)])
        assert ((inputs > 0.12) & (inputs < 2.5)).all()
        blocks = results[:, None] if ends is None else np.split(results, ends)
        sizes = np.array([np.sqrt(np.mean(np.square(block))) for block in blocks])
        assert ((sizes > 0.12) & (sizes < 2.5)).all()


def test_sizes_of_body_parameters_equal_closed_form() -> None:
    """Small parameters of a body count with a thousandth of the size of its others."""
    model = random_model("SE3", 2, 1)
    model.inertias[2] = pin.Inertia(4.0, np.array([0.0, 0.3, 0.0]), np.diag([0.2, 0.0, 0.2]))
    model.jointPlacements[2] = pin.SE3.Identity()
    system = pinred.load(model)
    model.addFrame(pin.Frame("tip", 2, 0, pin.SE3.Identity(), pin.FrameType.BODY), False)
    system = pinred.load(model)
    link = system.sorted_model.getFrameId("tip")
    freed = Freed(inertias=(1,), steps=((1, "x" * STEP),), links=(link,))
    structure = Structure(zero_momentum=False, freed=freed)
    layout = layout_of(system, structure, None)
    numbers = free_numbers(system, freed)
    sizes = draw(cartpole()).sizes
    sizes = replace(sizes, length=0.7, momenta=np.ones(system.n))
    parameters = np.zeros(layout.parameters)
    bodies = slice(layout.bodies_at, layout.bodies_at + freed.size)
    parameters[bodies] = numbers
    found = sizes.of_parameters(layout, system.r, parameters)[bodies]
    mass, moments, inertia = np.split(np.abs(numbers[freed.of_inertia(1)]), [1, 4])
    largest = inertia.max()
    expected = [mass, np.maximum(moments, 1e-3 * np.sqrt(mass * largest))]
    expected.append(np.maximum(inertia, 1e-3 * largest))
    assert found[freed.of_inertia(1)] == pytest.approx(np.concatenate(expected))
    assert moments.min() < 1e-3
    for where, turns in ((freed.of_step(1), 4), (freed.of_link(link), 9)):
        least = np.repeat([1e-3, 0.7e-3], [turns, where.stop - where.start - turns])
        assert np.abs(numbers[where]).min() == 0.0
        assert found[where] == pytest.approx(np.maximum(np.abs(numbers[where]), least))


def test_open_loops_are_nearly_closed() -> None:
    """Shapes at which loops are compared are up to 0.2 own units from a closed shape."""
    model, loops = five_bar()
    scene = pinred.Scene(system=pinred.load(model, loops=loops), seed=0)
    kernel = kernel_of(plan_of(scene), zero_momentum=False)
    closure = kernel.system.closure
    assert closure is not None
    apart = [np.abs(draw(kernel, k, is_closed=False).x - closure.x).max() for k in range(20)]
    assert 0.15 < max(apart) <= 0.2
