"""How fast the chosen method is, compared with the fastest method that is at least as accurate.

Each method integrates each scene with the scene's tolerance.  The error is the largest difference
of the final reduced state from that of a method with a much smaller tolerance.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import process_time

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, read_only
from ...common.errors import PinredError
from ...common.progress import Progress, one_by_one
from ...integrators.methods.default_tolerances import ATOL, RTOL
from ...scene.scene import Scene
from ...simulation.compiled.compiled_flow import CompiledFlow
from ...simulation.compiled.integrator import integrator
from ...simulation.plan import Plan, plan_of
from .held_robots import held_robot
from .scenes import SCENES, problems_named

METHODS = ("DOP853", "Tsit5", "AdaptiveGauss", "Radau")
GOOD, WORST = 1.3, 3.0  # requested ratio of most scenes, and of all scenes
HELD_ROBOTS = 200  # default number of random robots
_ROUNDS = 5
_SPAN = 2e-3  # least duration of a timed loop [s]
_PATIENCE = 3.0  # longest run of a method [s]
_TIGHTER = 1e-4  # tolerance of the reference divided by that of the scene


class _TooSlowError(Exception):
    """A method needs more time than _PATIENCE."""


@checks_arguments
@dataclass(frozen=True)
class MethodChoice:
    """Times and errors of all methods for one scene.

    Attributes:
        scene: Name of the scene.
        chosen: Name of the method that pinred chooses.
        cpu: CPU time of an integration by method [s]; infinity if the method fails or is too slow.
        error: Largest error of the final reduced state by method.
    """

    scene: str
    chosen: str
    cpu: Mapping[str, float]
    error: Mapping[str, float]

    @property
    def best(self) -> str:
        """The fastest method whose error is at most that of the chosen method."""
        most = self.error[self.chosen]
        accurate = [name for name in self.cpu if self.error[name] <= most]
        return min(accurate, key=lambda name: self.cpu[name])

    @property
    def ratio(self) -> float:
        """Time of the chosen method divided by that of the best method."""
        return self.cpu[self.chosen] / self.cpu[self.best]

    def __str__(self) -> str:
        cells = (f"{1e3 * self.cpu[n]:>9.3g} {self.error[n]:>7.0e}" for n in METHODS)
        return f"{self.scene:<26}{self.chosen:<14}{self.ratio:>6.2f}" + "".join(cells)

    @staticmethod
    def header() -> str:
        """Return the titles of the columns."""
        columns = "".join(f"{name + ' [ms]':>17}" for name in METHODS)
        return f"{'scene':<26}{'chosen':<14}{'ratio':>6}{columns}"


def summary(choices: Sequence[MethodChoice]) -> str:
    """Return the table of all scenes, with the share of good choices."""
    ratios = np.array([choice.ratio for choice in choices])
    share = 100.0 * float((ratios <= GOOD).mean())
    last = (
        f"{share:.1f} % of {len(choices)} scenes within {GOOD:g} times the fastest method that is "
        f"at least as accurate; largest ratio {ratios.max():.2f} (bars: 95 %, {WORST:g})"
    )
    return "\n".join([MethodChoice.header(), *map(str, choices), last])


@checks_arguments
def bench_methods(
    scenes: Sequence[str] | None = None,
    *,
    held: int = HELD_ROBOTS,
    progress: Progress | bool | None = None,
) -> list[MethodChoice]:
    """Time all methods on bench scenes, bundled robots and random robots with held joints.

    Args:
        scenes: Names in SCENES; all scenes of up to 20 joints if None.
        held: Number of random robots with springs, dampers and held joints.
        progress: As in `simulate`.
    Returns:
        The result of each scene with a reference.
    """
    cases = list(_cases(scenes, held))
    results = one_by_one(cases, lambda case: measure(*case), progress, "methods")
    return [result for result in results if result is not None]


def _cases(names: Sequence[str] | None, held: int) -> Iterator[tuple[str, Scene]]:
    """Yield the names and scenes to measure."""
    problems, _ = problems_named(list(SCENES) if names is None else names)
    for problem in problems:
        if names is not None or problem.system.m <= 20:
            yield problem.name, problem.scene()
    for seed in range(held):
        yield f"held robot {seed}", held_robot(seed)


def measure(name: str, scene: Scene) -> MethodChoice | None:
    """Return times and errors of all methods for a scene; None without a reference.

    Args:
        name: Name of the scene in the table.
        scene: The scene, which requests no method.
    Returns:
        The result.
    """
    plans = {method: plan_of(replace(scene, method=method)) for method in METHODS}
    times: dict[str, float] = dict.fromkeys(METHODS, np.inf)
    ends: dict[str, Array] = {}
    for method, plan in plans.items():
        try:
            ends[method], times[method] = _run(plan, _ROUNDS)
        except (PinredError, _TooSlowError):
            continue
    try:
        reference = _reference(scene, min(ends, key=lambda method: times[method]))
    except (PinredError, _TooSlowError, ValueError):
        return None
    errors = dict.fromkeys(METHODS, np.inf)
    for method, end in ends.items():
        errors[method] = float(np.max(np.abs(end - reference) / (1.0 + np.abs(reference))))
    return MethodChoice(name, plan_of(scene).method.name, times, errors)


def _reference(scene: Scene, fastest: str) -> Array:
    """Return an accurate final state, by the method that is the fastest at the own tolerance."""
    rtol, atol = max(1e-13, _TIGHTER * RTOL), _TIGHTER * ATOL
    return _run(plan_of(replace(scene, method=fastest, rtol=rtol, atol=atol)), 0)[0]


def _run(plan: Plan, rounds: int) -> tuple[Array, float]:
    """Return the final state, (k,), and the least CPU time of an integration [s]."""
    flow = CompiledFlow.of_plan(plan)
    parameters, began = read_only(flow.parameters.copy()), np.inf

    def watch(_: float) -> None:
        if process_time() - began > _PATIENCE:
            raise _TooSlowError

    once, end = integrator(flow, plan, watch), plan.scene.end
    once(0.0, 1e-9 * end, flow.y0, parameters)  # compiles the method and the kernel's derivative
    began = process_time()
    solution = once(0.0, end, flow.y0, parameters)
    first = process_time() - began
    run = partial(integrator(flow, plan, None), 0.0, end, flow.y0, parameters)
    count, times = max(1, int(_SPAN / first)), [first]
    for _ in range(rounds if rounds * first < _PATIENCE else 0):
        began = process_time()
        for _ in range(count):
            run()
        times.append((process_time() - began) / count)
    return solution.at(np.array([end]))[0], min(times)
