"""Problems of the benchmarks, and the interface of the solvers that run them.

A problem is a system with its initial state and duration; SCENES contains one entry for each named
problem. A solver prepares runs of a problem, or of a batch of members, at a tolerance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, freeze
from ...common.errors import InputError
from ...common.names import nearest
from ...judge.reference_solution import FullMotion, FullState
from ...scene.initial_state import random_state
from ...scene.scene import Scene
from ...simulation.compiled.compiled_flow import CompiledFlow, flows_of
from ...simulation.plan import of_scenes, plan_of
from ...system.coordinates import InitialState
from ...system.find_robot_files import INSTALL_ROBOTS, bundled_robots, has_example_robots
from ...system.load import load
from ...system.state_fields import State, with_base
from ...system.system import System

FAMILIES = ("planar", "spatial")
_LENGTH, _WIDTH, _MASS = 0.2, 0.05, 1.0  # length [m], width [m] and mass [kg] of a link


def chain(family: str, joints: int) -> System:
    """Build a chain of `joints` + 1 equal links without gravity.

    Args:
        family: "planar": SE(2) base with joints about the plane's normal. "spatial": SE(3) base
            with joints alternating about two axes normal to the link.
        joints: Number of joints.
    Returns:
        The chain.
    Raises:
        InputError: Unknown family, or no joint.
    """
    if family not in FAMILIES or joints < 1:
        raise InputError(
            f"a chain is {' or '.join(FAMILIES)} and has at least one joint, "
            f"got {family!r} with {joints}"
        )
    planar, offset = family == "planar", np.array([_LENGTH, 0.0, 0.0])
    link = pin.Inertia.FromBox(_MASS, _LENGTH, _WIDTH, _WIDTH)
    link.lever = 0.5 * offset
    root = pin.JointModelPlanar() if planar else pin.JointModelFreeFlyer()
    across = (pin.JointModelRZ(), pin.JointModelRZ() if planar else pin.JointModelRY())
    links = [(across[k % 2], offset, link) for k in range(1, joints + 1)]
    return build_tree(f"{family}-chain-{joints}", [(root, np.zeros(3), link), *links])


Link = tuple[pin.JointModel, ArrayLike, pin.Inertia]


def build_tree(name: str, links: Sequence[Link], parents: Sequence[int] | None = None) -> System:
    """Build a tree of links without gravity.

    Args:
        name: Name of the robot.
        links: For each link, its joint, the position of the joint on the parent [m], and the body.
            The first joint is the root.
        parents: Number of each link's parent, -1 for the first; by default the preceding link.
    Returns:
        The robot, whose joints are joint0, joint1 and so on.
    """
    model = pin.Model()
    model.name, model.gravity = name, pin.Motion.Zero()
    for k, (joint, position, body) in enumerate(links):
        parent = k if parents is None else parents[k] + 1
        placement = pin.SE3(np.eye(3), np.asarray(position, dtype=float))
        added = model.addJoint(parent, joint, placement, f"joint{k}")
        model.appendBodyToJoint(added, body, pin.SE3.Identity())
    return load(model)


@checks_arguments
@dataclass(frozen=True)
class End:
    """The final state of a motion.

    Attributes:
        x: Shape, unwrapped, (m,) [rad | m].
        q: Pinocchio's configuration, (nq,).
        v: Pinocchio's velocity, (n,).
        evaluations: Number of evaluations of the vector field, of steps for Taylor methods; NaN
            if unknown.
    """

    x: Array
    q: Array
    v: Array
    evaluations: float

    @property
    def motion(self) -> FullMotion:
        """The state as a motion with one time."""
        return FullMotion(x=self.x[None], q=self.q[None])


@checks_arguments
@dataclass(frozen=True)
class Problem:
    """An initial value problem with the base at the identity; only its final state is compared.

    Attributes:
        name: Name of the problem.
        about: Description in one line.
        system: The system.
        start: Initial shape x, initial shape rate, initial body twist, and the duration [s].
    """

    name: str
    about: str
    system: System
    start: InitialState

    def __post_init__(self) -> None:
        freeze(self.start)
        if self.system.model is not self.system.sorted_model:  # the peers need depth-first order
            vars(self)["system"] = replace(self.system, model=self.system.sorted_model)

    @property
    def times(self) -> Array:
        """The final time, (1,) [s]; no other state is requested."""
        return np.array([self.start.duration])

    @property
    def q0(self) -> Array:
        """Pinocchio's configuration at the start, (nq,)."""
        return self.system.q(self.system.group.identity(), self.start.x)

    @property
    def v0(self) -> Array:
        """Pinocchio's velocity at the start, (n,)."""
        return self.system.v(self.start.xi, self.start.xdot)

    def scene(self, **options: Any) -> Scene:
        """Return the problem as a Scene.

        Args:
            **options: Further options of Scene.
        Returns:
            The scene.
        """
        start = self.start
        return Scene(
            system=self.system,
            x0=start.x,
            xdot0=start.xdot,
            xi0=start.xi,
            times=self.times,
            **options,
        )

    @cached_property
    def full(self) -> FullState:
        """Full simulation by Pinocchio's ABA, which also measures distances of motions."""
        return FullState(self.scene())

    def full_start(self) -> Array:
        """Return the initial full state, see FullState."""
        start = self.start
        return self.full.state(self.system.group.identity(), start.x, start.xi, start.xdot)

    @cached_property
    def flow(self) -> CompiledFlow:
        """The reduced initial value problem that pinred compiles."""
        return CompiledFlow.of_plan(plan_of(self.scene()))

    def end(self, y: Array, evaluations: float = np.nan) -> End:
        """Reconstruct the full final state.

        Args:
            y: Reduced final state of `flow`, (k,).
            evaluations: Number of evaluations of the vector field.
        Returns:
            The final state.
        """
        return self.end_of(with_base(self.flow.states(self.times, y[None]), self.name), evaluations)

    @staticmethod
    def end_of(states: State, evaluations: float) -> End:
        """Return the only state of a motion as its final state.

        Args:
            states: States at one time.
            evaluations: Number of evaluations of the vector field.
        Returns:
            The final state.
        """
        return End(states.x[0], states.q[0], states.v[0], evaluations)

    def apart(self, a: FullMotion, b: FullMotion) -> float:
        """Return the largest of shape, rotation and position error between two final states.

        Args:
            a: Motion with one time.
            b: Motion with one time.
        Returns:
            The distance [rad | m].
        """
        d = self.full.distance(a, b)
        return float(np.max([d.shape[0], d.rotation[0], d.position[0]]))


BARS = ("planar1", "planar5", "satellite", "solo12", "talos")
CHAINS = {"planar": (2, 3, 5, 10, 20, 50), "spatial": (2, 3, 5, 10, 20, 50)}
CHAIN_TIME = 2.0  # duration [s]; long chains become chaotic a few seconds later
_EXAMPLES = {"solo12": (4.0, 1.0), "talos": (2.0, 2.0)}  # duration [s], factor of initial rates
# Scene name → bundled robot, and the factor by which its initial rates are multiplied.
_FASTER = {"planar5": ("planar_chain5", 2.0), "satellite": ("satellite_two_arms", 3.0)}


def planar_joint() -> Problem:
    """Return two coupled planar bodies whose locked inertia depends on the joint angle."""
    system = load("planar_chain5", lock=("joint2", "joint3", "joint4", "joint5"))
    start = InitialState(
        x=np.array([0.3]), xdot=np.array([1.2]), xi=np.array([0.1, 0.2, -0.3]), duration=10.0
    )
    return Problem("planar1", "planar_chain5 with all joints but the first locked", system, start)


def bundled(name: str, robot: str, factor: float = 1.0) -> Problem:
    """Return a bundled robot with its default initial state, and its rates scaled by a factor."""
    system = load(robot)
    if (start := system.initial) is None:
        raise InputError(f"'{robot}' has no default initial state")
    about = f"{bundled_robots()[robot].description}, default initial state"
    if factor != 1.0:
        about = f"{robot} from its default state with rates times {factor:g}"
    return Problem(name, about, system, _scaled(start, factor, start.duration))


def example(name: str) -> Problem:
    """Return a robot of example-robot-data without gravity, from a random initial state."""
    system = load(name, gravity=(0.0, 0.0, 0.0))
    duration, factor = _EXAMPLES[name]
    about = f"{name} tumbling without torque or gravity, seed 0"
    about += f", rates times {factor:g}" if factor != 1.0 else ""
    return Problem(name, about, system, _scaled(random_state(system, 0), factor, duration))


def _scaled(state: InitialState, factor: float, duration: float) -> InitialState:
    return InitialState(state.x, factor * state.xdot, factor * state.xi, duration)


def chained(family: str, joints: int) -> Problem:
    """Return a chain of equal links, from a random initial state."""
    system = chain(family, joints)
    start = _scaled(random_state(system, 0), 1.0, CHAIN_TIME)
    name = f"{family}-{joints}"
    return Problem(name, f"a {family} chain of {joints} joints, seed 0", system, start)


def _factories() -> dict[str, Callable[[], Problem]]:
    factories: dict[str, Callable[[], Problem]] = {"planar1": planar_joint}
    # The peers of the benchmark have no ball joints in pinred's coordinates, and no closed loops.
    robots = [name for name, robot in bundled_robots().items() if not (robot.balls or robot.loops)]
    factories |= {name: partial(bundled, name, name) for name in robots}
    factories |= {name: partial(bundled, name, *case) for name, case in _FASTER.items()}
    factories |= {name: partial(example, name) for name in _EXAMPLES}
    for family, sizes in CHAINS.items():
        factories |= {f"{family}-{n}": partial(chained, family, n) for n in sizes}
    return factories


SCENES = _factories()


T = TypeVar("T")


def select_named(names: Sequence[str] | None, table: Mapping[str, T], what: str) -> dict[str, T]:
    """Select the entries of a table with the given names.

    Args:
        names: Names; all names of the table if there are none.
        table: Entries by name.
        what: Word for an entry, such as "scene".
    Returns:
        The entries by name, each once.
    Raises:
        InputError: Unknown name.
    """
    for name in names or ():
        if name not in table:
            hint = nearest(name, list(table))
            raise InputError(f"no {what} '{name}'; {hint}the {what}s are {', '.join(table)}")
    return {name: table[name] for name in names or table}


@checks_arguments
def problems_named(names: Sequence[str] | None = None) -> tuple[list[Problem], list[str]]:
    """Build the problems with the given names.

    Args:
        names: Names in SCENES; BARS if there are none.
    Returns:
        The problems, and one message for each problem that needs a missing package.
    Raises:
        InputError: Unknown name.
    """
    factories = select_named(names or BARS, SCENES, "scene")
    unavailable = [] if has_example_robots() else [name for name in factories if name in _EXAMPLES]
    missing = [f"{name} is left out: {INSTALL_ROBOTS}" for name in unavailable]
    return [make() for name, make in factories.items() if name not in unavailable], missing


_SPREAD = 0.05  # standard deviation of the members' rates (relative) and shapes [rad | m]


def generate_members(problem: Problem, count: int) -> list[Problem]:
    """Generate members with random initial states near the initial state of a problem."""
    rng, start, members = np.random.default_rng(0), problem.start, []
    for _ in range(count):
        factors = [1.0 + _SPREAD * rng.normal(size=len(v)) for v in (start.xdot, start.xi)]
        state = InitialState(
            x=start.x + _SPREAD * rng.normal(size=len(start.x)),
            xdot=start.xdot * factors[0],
            xi=start.xi * factors[1],
            duration=start.duration,
        )
        members.append(Problem(problem.name, problem.about, problem.system, state))
    return members


def compile_members(members: Sequence[Problem]) -> CompiledFlow:
    """Return the reduced initial states and the parameters of members with momentum."""
    (group,) = of_scenes([member.scene(method="DOP853") for member in members]).groups
    ((_, flows),) = flows_of(group.plan, group.given)
    return flows


def compute_drift(problem: Problem, q: Array, v: Array) -> tuple[float, float]:
    """Compute the relative changes of conserved quantities from the start to a final state.

    Args:
        problem: The problem.
        q: Final configuration, (nq,).
        v: Final velocity, (n,).
    Returns:
        The change of energy relative to the initial kinetic energy T, which excludes the uniform
        motion of the centre of mass; and the largest change of a conserved component of momentum,
        relative to √(2mT), or for angular components to √(2mT) times the radius of gyration.
        Angular momentum is taken about the centre of mass if the group translates, else about the
        pivot.
    """
    full, system, start = problem.full, problem.system, problem.start
    k = system.group.linear
    q0, v0 = problem.q0, problem.v0
    total = full.totals.kinetic_energy(q0, v0)
    internal = total - full.totals.com_kinetic_energy(full.totals.centroidal(q0, v0))
    scale = internal if internal > 1e-9 * total else total
    fall = system.mass * system.gravity * start.duration
    about_pivot = not system.group.turns_about_com
    before = full.totals.momentum(q0, v0, np.zeros(3), about_pivot=about_pivot)
    after = full.totals.momentum(q, v, fall, about_pivot=about_pivot)
    unit = np.full(system.r, np.sqrt(2.0 * system.mass * scale))
    unit[k:] *= full.totals.radius_of_gyration(q0)
    energy = total + full.totals.potential_energy(q0)
    gained = full.totals.kinetic_energy(q, v) + full.totals.potential_energy(q) - energy
    drift = abs(gained) / scale if scale > 0.0 else abs(gained)
    return float(drift), float(np.max(np.abs(after - before) / np.where(unit > 0.0, unit, 1.0)))


ATOL = 0.01  # ratio of absolute to relative tolerance, for methods with both


@checks_arguments
@dataclass(frozen=True)
class PreparedRun:
    """A method that is ready to solve a problem at a tolerance.

    Attributes:
        run: Timed function: integrates from the initial to the final state. Raises
            IntegrationError if it fails.
        end: Converts the result of `run` to the final state (not timed). For a batch, the second
            argument is the number of a member.
        build: Time of preparation, once [s].
    """

    run: Callable[[], Any]
    end: Callable[..., End]
    build: float = 0.0


@checks_arguments
@dataclass(frozen=True)
class Solver:
    """A method of the accuracy benchmark, or of batches.

    Attributes:
        name: Name of the method.
        about: Description of the timed work.
        tolerances: Relative tolerances from coarse to fine; if `fixed`, step lengths relative to
            the duration.
        prepare: Prepares a run of a problem, or of the members of a batch, at a tolerance.
        missing: Returns why the method cannot run a problem; "" if it can.
        fixed: Whether the method has fixed steps.
        most: Largest number of members that the method is timed with.
    """

    name: str
    about: str
    tolerances: tuple[float, ...]
    prepare: Callable[[Any, float], PreparedRun]
    missing: Callable[[Problem], str] = field(default_factory=lambda: lambda _: "")
    fixed: bool = False
    most: int = 10**9


def decades(first: int, last: int, by: int = 1) -> tuple[float, ...]:
    """Return the tolerances 10⁻ᵏ for k from first to last."""
    return tuple(float(f"1e-{k}") for k in range(first, last + 1, by))


def halvings(first: int, count: int) -> tuple[float, ...]:
    """Return step lengths relative to the duration: 1/first, then repeatedly halved."""
    return tuple(1.0 / (first * 2**k) for k in range(count))


def steps_of(fraction: float) -> int:
    """Return the number of steps whose length is this fraction of the duration."""
    return round(1.0 / fraction)
