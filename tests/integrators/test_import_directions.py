"""Subpackages of the integrators import each other in one direction."""

from __future__ import annotations

from collections.abc import Iterable
from graphlib import CycleError, TopologicalSorter

import pytest
import rooms
from rooms import Import

ROOM = "pinred.integrators"


def folders(imports: Iterable[Import]) -> dict[str, set[str]]:
    """Return the subpackages and the subpackages that each imports."""
    modules = rooms.modules()
    graph: dict[str, set[str]] = {}
    for imported in imports:
        if imported.by.startswith(ROOM) and imported.of.startswith(ROOM):
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
    graph = folders(rooms.imports())
    order = list(TopologicalSorter(graph).static_order())
    assert order[0] == f"{ROOM}.stepping"
    assert {by for by in graph if f"{ROOM}.methods" in graph[by]} == {ROOM, f"{ROOM}.lanes"}
    assert len(order) > 5


@pytest.mark.slow
def test_import_cycle_is_detected() -> None:
    """A stepper that imports a constant from `methods` closes a cycle."""
    back = Import(f"{ROOM}.gauss.stages", 1, f"{ROOM}.methods.gauss")
    with pytest.raises(CycleError):
        TopologicalSorter(folders([*rooms.imports(), back])).prepare()
