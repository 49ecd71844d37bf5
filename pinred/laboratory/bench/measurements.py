"""Measurements by name: the text to print, and the tables to write as csv.

Modules that need much memory or time to import are imported by the measurement that needs them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeAlias

Records: TypeAlias = Sequence[dict[str, object]]
Result: TypeAlias = tuple[str, Mapping[str, Records]]  # text to print, and {csv name: records}


def _columns(result: Any, names: Iterable[str]) -> dict[str, object]:
    return {name: getattr(result, name) for name in names}


def _entries(result: Any, names: Iterable[str], k: int) -> dict[str, object]:
    return {name: getattr(result, name)[k] for name in names}


def _table(header: str, timings: Iterable[object]) -> str:
    return "\n".join([header, *map(str, timings)])


def _blocks(results: Iterable[object]) -> str:
    return "\n\n".join(map(str, results))


def _kernels(robots: Sequence[str]) -> Result:
    from .kernel_timing import KernelTiming, bench_kernels

    timings = bench_kernels(robots, progress=True)
    records = [{**vars(timing), "ratio": timing.ratio} for timing in timings]
    return _table(KernelTiming.header(), timings), {"kernels": records}


def _forces(robots: Sequence[str]) -> Result:
    from .force_timing import ForcesTiming, bench_forces

    timings = bench_forces(robots, progress=True)
    names = ("robot", "free", "torque", "wrench", "full")
    records = [_columns(timing, names) for timing in timings]
    return _table(ForcesTiming.header(), timings), {"forces": records}


def _compare(scenes: Sequence[str]) -> Result:
    from .compare_timing import CompareTiming, bench_compare

    timings = bench_compare(scenes, progress=True)
    records = [dict(vars(timing)) for timing in timings]
    return _table(CompareTiming.header(), timings), {"compare": records}


def _first(calls: Sequence[str]) -> Result:
    from .first_calls import FirstCall, bench_first_calls

    timings = bench_first_calls(calls, progress=True)
    records = [dict(vars(timing)) for timing in timings]
    return _table(FirstCall.header(), timings), {"first_calls": records}


def _evaluations(scenes: Sequence[str]) -> Result:
    from .evaluations import ERRORS, FEW_SCENES, bench_evaluations

    results = bench_evaluations(scenes or FEW_SCENES, progress=True)
    records: Records = [
        {"problem": result.problem, "method": name, "error": error, "evaluations": count}
        for result in results
        for name, counts in result.counts.items()
        for error, count in zip(ERRORS, counts, strict=True)
    ]
    return _blocks(results), {"evaluations": records}


def _flow(robots: Sequence[str]) -> Result:
    from .flow_timing import FlowTiming, bench_flow

    timings = bench_flow(robots, progress=True)
    records = [dict(vars(timing)) for timing in timings]
    return _table(FlowTiming.header(), timings), {"flow": records}


def _derivatives(robots: Sequence[str]) -> Result:
    from .derivative_timing import DerivativeTiming, bench_derivatives

    timings = bench_derivatives(robots, progress=True)
    records = [dict(vars(timing)) for timing in timings]
    return _table(DerivativeTiming.header(), timings), {"derivatives": records}


def _scaling() -> Result:
    from .scaling import bench_scaling

    results = bench_scaling(progress=True)
    names = ("joints", "instructions", "build", "kernel")
    records = [
        {"family": result.family, **_entries(result, names, k)}
        for result in results
        for k in range(len(result.joints))
    ]
    return _blocks(results), {"scaling": records}


def _floquet() -> Result:
    from .floquet_timing import ROUTES, bench_floquet

    results = bench_floquet(progress=True)
    records: Records = [
        {"robot": result.robot, "route": name, "wall": wall, "error": error}
        for result in results
        for name, wall, error in zip(ROUTES, result.wall, result.error, strict=True)
    ]
    return _blocks(results), {"floquet": records}


def _many(scenes: Sequence[str], members: int) -> Result:
    from .batch_timing import bench_many

    results = bench_many(scenes or None, members=members, progress=True)
    records: Records = [
        {"problem": result.problem, "members": result.members, **vars(rate)}
        for result in results
        for rate in result.rates
    ]
    return _blocks(results), {"many": records}


def _threads(robot: str, members: int) -> Result:
    from ...system.load import load
    from .threads import bench_threads

    system = load(robot, gravity=(0.0, 0.0, 0.0))
    result = bench_threads(system, members=members, progress=True)
    times: Records = [
        {"robot": result.robot, "members": result.members, "threads": k + 1, "wall": wall}
        for k, wall in enumerate(result.wall)
    ]
    names = ("sizes", "results", "kept", "extra")
    memory: Records = [
        {"robot": result.robot, **_entries(result, names, k)} for k in range(len(result.sizes))
    ]
    return str(result), {"threads": times, "threads_memory": memory}


def _methods(scenes: Sequence[str], held: int) -> Result:
    from .method_choice import METHODS, bench_methods, summary

    results = bench_methods(scenes or None, held=held, progress=True)
    records: Records = [
        {
            "scene": result.scene, "chosen": result.chosen, "ratio": result.ratio,
            **{f"{name} cpu": result.cpu[name] for name in METHODS},
            **{f"{name} error": result.error[name] for name in METHODS},
        }
        for result in results
    ]  # fmt: skip
    return summary(results), {"methods": records}


def _loops() -> Result:
    from .soft_loops import bench_loops

    results = bench_loops(progress=True)
    records: Records = [
        {"robot": result.robot, "duration": result.duration, **vars(row)}
        for result in results
        for row in result.rows
    ]
    return _blocks(results), {"loops": records}


MEASUREMENTS: dict[str, Callable[..., Result]] = {
    "kernels": _kernels,
    "forces": _forces,
    "compare": _compare,
    "first": _first,
    "evaluations": _evaluations,
    "flow": _flow,
    "derivatives": _derivatives,
    "scaling": _scaling,
    "floquet": _floquet,
    "loops": _loops,
    "many": _many,
    "threads": _threads,
    "methods": _methods,
}
