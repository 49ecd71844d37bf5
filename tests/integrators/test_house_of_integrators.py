"""Folders inside the room: imports between them go one way."""

from __future__ import annotations

from collections.abc import Iterable
from graphlib import CycleError, TopologicalSorter

import pytest
import rooms
from rooms import Import

ROOM = "pinred.integrators"


def folders(found: Iterable[Import]) -> dict[str, set[str]]:
    """The folders of the room, and those that each imports."""
    known = rooms.modules()
    graph: dict[str, set[str]] = {}
    for each in found:
        if each.by.startswith(ROOM) and each.of.startswith(ROOM):
            by, of = (
                name if known[name].name == "__init__.py" else name.rpartition(".")[0]
                for name in (each.by, each.of)
            )
            if by != of:
                graph.setdefault(by, set()).add(of)
    return graph


@pytest.mark.slow
def test_no_circle_of_folders() -> None:
    """Machine code knows no method, no method its value, no value who runs it."""
    graph = folders(rooms.imports())
    order = list(TopologicalSorter(graph).static_order())
    assert order[0] == f"{ROOM}.stepping"
    assert {by for by in graph if f"{ROOM}.methods" in graph[by]} == {ROOM, f"{ROOM}.lanes"}
    assert len(order) > 5


@pytest.mark.slow
def test_a_circle_of_folders_is_seen() -> None:
    """A constant that a stepper takes from the values is one."""
    back = Import(f"{ROOM}.gauss.stages", 1, f"{ROOM}.methods.gauss")
    with pytest.raises(CycleError):
        TopologicalSorter(folders([*rooms.imports(), back])).prepare()
