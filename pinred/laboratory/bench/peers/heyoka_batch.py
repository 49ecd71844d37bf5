"""heyoka's batch mode: Taylor's method for several members at once, on pinred's equations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np

from ....common.arrays import Array
from ....common.errors import IntegrationError
from ..member_batch import BatchSolver, PreparedBatch, compile_members, final_states
from ..problems import Problem
from ..solver import decades
from ..taylor import has_heyoka, reduced_graph, taylor_expressions
from .equality import INSTALL
from .heyoka import MOST_UNROLLED

_TOLERANCES = decades(7, 14)


def _prepare(members: Sequence[Problem], tolerance: float, *, unrolled: bool) -> PreparedBatch:
    hy = import_module("heyoka")
    flows, end = compile_members(members), members[0].start.duration
    width = hy.recommended_simd_size()
    parameters = [hy.par[k] for k in range(flows.parameters.shape[1])]
    expressions = taylor_expressions(reduced_graph(members[0]), parameters)
    order = np.arange(-(-len(members) // width) * width).clip(max=len(members) - 1)
    starts = [np.ascontiguousarray(flows.y0[order[k : k + width]].T) for k in order[::width]]
    numbers = [
        np.ascontiguousarray(flows.parameters[order[k : k + width]].T) for k in order[::width]
    ]
    ta = hy.taylor_adaptive_batch(
        expressions, starts[0].copy(), tol=tolerance, compact_mode=not unrolled,
        pars=numbers[0].copy(),
    )  # fmt: skip

    def run() -> Array:
        final_states_of_groups = []
        for y0, pars in zip(starts, numbers, strict=True):
            ta.set_time(0.0)
            ta.state[:], ta.pars[:] = y0, pars
            ta.propagate_until(end)
            if any(outcome[0].name != "time_limit" for outcome in ta.propagate_res):
                raise IntegrationError("heyoka did not integrate all members to their end")
            final_states_of_groups.append(ta.state.T.copy())
        return np.concatenate(final_states_of_groups)[: len(members)]

    return PreparedBatch(run, lambda y, count: final_states(members, flows, y, count))


def _not_installed(_: Problem) -> str:
    return "" if has_heyoka() else f"heyoka is left out: {INSTALL}"


def _long_to_unroll(problem: Problem) -> str:
    if has_heyoka() and reduced_graph(problem).n_instructions() > MOST_UNROLLED:
        return "heyoka-batch-unrolled is left out: it takes minutes to compile"
    return _not_installed(problem)


def _batch(name: str, about: str, missing: Callable[[Problem], str], **how: Any) -> BatchSolver:
    return BatchSolver(name, about, _TOLERANCES, partial(_prepare, **how), missing)


HEYOKA_BATCH = (
    _batch("heyoka-batch", "Taylor in batch mode, compact", _not_installed, unrolled=False),
    _batch("heyoka-batch-unrolled", "the same, unrolled", _long_to_unroll, unrolled=True),
)
