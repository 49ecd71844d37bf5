"""Kernels of robots without loops do not depend on the code for loops."""

from __future__ import annotations

from typing import NoReturn

import pytest
from loop_robots import four_bar, random_loops

import pinred
from pinred.integrators.methods import Method
from pinred.kernels import reduced_graph
from pinred.kernels.machine.lowering import lower
from pinred.kernels.reduced_graph import ReducedGraph
from pinred.reduction.tree import loop_constraints
from pinred.reduction.tree.identical_branches import Lanes
from pinred.simulation.plan import plan_of


def code(system: pinred.System, method: Method) -> list[str]:
    """Return the LLVM code of rates and outputs, in lanes over limbs, for a random state."""
    scene = pinred.Scene(system=system, seed=1, duration=1.0, method=method)
    plan, lanes = plan_of(scene), Lanes()
    structure = plan.structure(zero_momentum=False)
    graph = ReducedGraph(plan.system, structure, plan.forces, lanes)
    functions = graph.rate(), graph.outputs()
    return [lower(f, f.name(), lanes.marks[f.name()], fma=True) for f in functions]


@pytest.mark.parametrize("method", [pinred.DOP853(), pinred.Gauss(0.01), pinred.Variational(0.01)])
@pytest.mark.parametrize("robot", ["planar_chain5", "satellite_two_arms"])
def test_code_of_robots_without_loops_is_built_without_the_code_for_loops(
    robot: str, method: Method, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The text is the same if no function for loops can be called."""
    expected = code(pinred.load(robot), method)

    def unreachable(*_: object, **__: object) -> NoReturn:
        raise AssertionError

    monkeypatch.setattr(reduced_graph, "solve_with_loops", unreachable)
    for name in ("constraint_values", "solve_with_loops", "rate_map"):
        monkeypatch.setattr(loop_constraints, name, unreachable)
    assert code(pinred.load(robot), method) == expected


def test_open_tree_of_a_robot_with_loops_has_the_code_of_the_tree() -> None:
    """Rates and outputs; the loops change both."""
    for model, loops in (four_bar(), random_loops(1, ("3d",), 3)):
        tree, looped = pinred.load(model), pinred.load(model, loops=loops)
        method = pinred.DOP853()
        assert code(looped.open_tree(), method) == code(tree, method)
        assert all(a != b for a, b in zip(code(looped, method), code(tree, method), strict=True))
