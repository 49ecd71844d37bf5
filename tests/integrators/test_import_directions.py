"""Subpackages of the integrators import each other in one direction."""

from __future__ import annotations

from collections.abc import Iterable
from graphlib import CycleError, TopologicalSorter

import package_graph
import pytest
from package_graph import Import

INTEGRATORS = "pinred.integrators"


def folders(imports: Iterable[Import]) -> dict[str, set[str]]:
    """Return the subpackages and the subpackages that each imports."""
    modules = package_graph.list_modules()
    graph: dict[str, set[str]] = {}
    for imported in imports:
        if imported.by.startswith(INTEGRATORS) and imported.of.startswith(INTEGRATORS):
            by, of = (
                name if modules[name].name == "__init__.py" else name.rpartition(".")[0]
                for name in (imported.by, imported.of)
            )
            if by != of:
                graph.setdefault(by, set()).add(of)
    return graph


@pytest.mark.slow
def test_subpackages_have_no_import_cycle() -> None:
    """Machine code imports no method, and methods import no function that runs them."""
    graph = folders(package_graph.list_imports(INTEGRATORS))
    order = list(TopologicalSorter(graph).static_order())
    assert order[0] == f"{INTEGRATORS}.stepping"
    assert {by for by in graph if f"{INTEGRATORS}.methods" in graph[by]} == {
        INTEGRATORS,
        f"{INTEGRATORS}.lanes",
    }
    assert len(order) > 5


@pytest.mark.slow
def test_import_cycle_is_detected() -> None:
    """A stepper that imports a constant from `methods` closes a cycle."""
    back = Import(f"{INTEGRATORS}.implicit.gauss_stages", 1, f"{INTEGRATORS}.methods.method")
    with pytest.raises(CycleError):
        TopologicalSorter(folders([*package_graph.list_imports(INTEGRATORS), back])).prepare()
