"""Commands about the installation: doctor and cache, which also compiles ahead of use."""

from __future__ import annotations

import argparse
import os
import platform
import re
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from importlib.metadata import PackageNotFoundError, distribution, version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ..common.errors import InputError, PinredError, __version__, install_command

if TYPE_CHECKING:
    from ..system.system import System

_GROUPS = ("all", "dev")  # extras that only collect others, or serve development
_REQUIREMENT = re.compile(r"([A-Za-z0-9._-]+)(\[[^]]*\])?([^;]*)(?:;\s*extra == ['\"](.*)['\"])?")


class Requirement(NamedTuple):
    """A package that pinred needs.

    Attributes:
        name: Name of the package.
        lowest: Lowest version, or "".
        extra: Name of the extra that needs the package; "" for every installation.
    """

    name: str
    lowest: str
    extra: str


class Finding(NamedTuple):
    """One line of the report.

    Attributes:
        subject: Name of the checked part.
        state: "ok", "missing" (optional) or "FAULT" (pinred does not work).
        text: Version, path, or the remedy.
    """

    subject: str
    state: str
    text: str


def add_doctor_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command, which has none."""


def run_doctor(arguments: argparse.Namespace) -> int:  # noqa: ARG001
    """Print the report.  Returns 0, or 1 if a required part is missing or broken."""
    findings = list(examine())
    for subject, state, text in findings:
        print(f"{subject:20} {state:8} {text}")
    faults = sum(finding.state == "FAULT" for finding in findings)
    print(f"{faults} faults" if faults else "pinred is installed correctly")
    return 1 if faults else 0


def examine() -> Iterator[Finding]:
    """Yield the findings: versions, CPU, cache, and the packages of the extras."""
    yield Finding("pinred", "ok", __version__)
    system = f"{platform.python_version()}, {platform.system()} {platform.machine()}"
    yield Finding("Python", "ok", system)
    requirements = read_requirements()
    for requirement in requirements:
        if not requirement.extra:
            yield _check_required(requirement)
    for subject, check in (("CPU", _check_cpu), ("machine code", _check_machine_code)):
        yield _guard(subject, check)
    yield _guard("cache", _check_cache)
    for extra in dict.fromkeys(requirement.extra for requirement in requirements):
        if extra and extra not in _GROUPS:
            yield _check_extra(extra, [r for r in requirements if r.extra == extra])


def read_requirements() -> list[Requirement]:
    """Return the requirements in the metadata of the installed package, or none in a checkout."""
    try:
        lines = distribution("pinred").requires or []
    except PackageNotFoundError:
        return []
    requirements = []
    for line in lines:
        name, _, bounds, extra = _REQUIREMENT.fullmatch(line).groups()  # type: ignore[union-attr]
        lowest = re.search(r">=\s*([\w.]+)", bounds)
        requirements.append(Requirement(name, lowest[1] if lowest else "", extra or ""))
    return requirements


def _installed(requirement: Requirement) -> tuple[str, str]:
    """Return the version of a package, or "", and the fault, or ""."""
    try:
        installed = version(requirement.name)
    except PackageNotFoundError:
        return "", "not installed"
    if _release(installed) < _release(requirement.lowest):
        return installed, f"version {installed} is older than {requirement.lowest}"
    return installed, ""


def _release(text: str) -> list[int]:
    """Return the numbers of a release, without trailing zeros and additions such as rc1."""
    head = re.match(r"\d+(?:\.\d+)*", text)
    numbers = [int(number) for number in head[0].split(".")] if head else []
    while numbers and not numbers[-1]:
        numbers.pop()
    return numbers


def _check_required(requirement: Requirement) -> Finding:
    installed, fault = _installed(requirement)
    if not fault:
        return Finding(requirement.name, "ok", installed)
    name, lowest, _ = requirement
    specifier = f"{name}>={lowest}" if lowest else name
    return Finding(name, "FAULT", f'{fault}; pip install "{specifier}"')


def _check_extra(extra: str, requirements: list[Requirement]) -> Finding:
    checked = [(requirement.name, *_installed(requirement)) for requirement in requirements]
    faults = [f"{name}: {fault}" for name, _, fault in checked if fault]
    if faults:
        text = f"{', '.join(faults)}; {install_command(extra)}"
        return Finding(f"extra {extra}", "missing", text)
    return Finding(f"extra {extra}", "ok", ", ".join(f"{name} {v}" for name, v, _ in checked))


def _guard(subject: str, check: Callable[[], str]) -> Finding:
    """Run a check of a required part; any error is a finding."""
    try:
        return Finding(subject, "ok", check())
    except (PinredError, ImportError, OSError) as error:
        return Finding(subject, "FAULT", f"{error}")


def _check_cpu() -> str:
    from ..common.machine_code import CPU_VARIABLE, cpu_target

    name = cpu_target().name
    return f"{name}, set by {CPU_VARIABLE}" if os.environ.get(CPU_VARIABLE) else name


def _check_machine_code() -> str:
    """Compile and load a function.  Returns a description; raises as the compiler does."""
    import casadi

    from ..common.machine_code import load_object
    from ..kernels.machine.native import compile_object

    x = casadi.SX.sym("x", 2)
    code = compile_object(casadi.Function("doctor", [x], [casadi.sin(x)]), "doctor")
    load_object(code, "doctor")
    return "compiles and loads"


def _check_cache() -> str:
    """Describe the cache of compiled code.  Raises OSError if it cannot be written."""
    from ..common.object_cache import ObjectCache

    cache = ObjectCache()
    existing = next(p for p in (cache.folder, *cache.folder.absolute().parents) if p.exists())
    if not (existing.is_dir() and os.access(existing, os.W_OK | os.X_OK)):
        raise OSError(
            f"'{existing}' cannot be written, so each process compiles again; "
            "set PINRED_CACHE_DIR to a private folder"
        )
    entries = cache.entries()
    size = sum(entry.size for entry in entries) / 1e6
    return f"{len(entries)} compiled objects, {size:.2f} MB, in {Path(cache.folder)}"


_LISTED = 20  # largest number of objects that are listed


def add_cache_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    sub.add_argument(
        "warm", nargs="*", metavar="warm ROBOT", help="compile what calls on a robot need"
    )
    sub.add_argument("--clear", action="store_true", help="remove all kernels and integrators")


def run_cache(arguments: argparse.Namespace) -> int:
    """List the objects, remove them, or compile the code of a robot.  Returns 0."""
    from ..common.object_cache import ObjectCache

    if arguments.warm:
        _warm(arguments.warm)
        return 0
    cache = ObjectCache()
    if arguments.clear:
        print(f"{cache.clear()} compiled objects removed from {cache.folder}")
        return 0
    entries = cache.entries()
    size = sum(entry.size for entry in entries)
    print(
        f"{len(entries)} compiled objects, {size / 1e6:.2f} MB of {cache.limit / 1e6:.0f}, "
        f"in {cache.folder}"
    )
    for entry in entries[: -_LISTED - 1 : -1]:  # The most recently used object comes first.
        print(f"  {entry.key[:16]}  {entry.size / 1e3:8.1f} kB")
    if len(entries) > _LISTED:
        print(f"  … and {len(entries) - _LISTED} more")
    return 0


def _warm(words: list[str]) -> None:
    """Compile the code of a robot, and print what was prepared."""
    from ..system.load import load

    if words[0] != "warm" or len(words) != 2:
        raise InputError(f"expected `pinred cache warm ROBOT`, got {' '.join(words)!r}")
    system = load(words[1])
    total = 0.0
    for call, seconds in warm_caches(system):
        print(f"{seconds:7.2f} s  {call}", flush=True)
        total += seconds
    print(f"{total:7.2f} s in all; further processes find the code of '{system.name}' in the cache")


_DURATION = 1e-3  # of all simulations [s]


def warm_caches(system: System) -> Iterator[tuple[str, float]]:
    """Compile and cache the code of simulations, batches, flows and fields of a robot.

    Scenes with forces, prescribed joints or variable parameters have code of their own.

    Args:
        system: The robot.
    Yields:
        A call that is prepared, and the time that it took [s].
    """
    for name, call in _calls(system):
        began = time.perf_counter()
        with suppress(InputError):  # a method or a derivative that this robot does not have
            call()
            yield name, time.perf_counter() - began


def _calls(system: System) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield the calls that compile code, and their names."""
    import numpy as np

    from ..analysis.full_reduction import Reduction
    from ..integrators.methods import METHODS
    from ..scene.scene import Scene
    from ..simulation.flow_map.flow import flow
    from ..simulation.simulate import simulate
    from ..simulation.simulate_many import simulate_many

    two_shapes: Any = np.tile(system.space.neutral, (2, 1))
    uses: dict[str, Callable[[Any], Any]] = {
        "flow": lambda end: end(),
        "flow.jacobian": lambda end: end.jacobian(),
        "flow.vjp": lambda end: end.vjp({"pose": np.ones(system.group.dim)}),
    }

    def use_flow(use: Callable[[Any], Any], scene: Scene) -> Any:
        return use(flow(scene))

    scenes = {
        "": Scene(system=system, seed=0, duration=_DURATION),
        " at zero momentum": Scene(system=system, momentum=0, duration=_DURATION),
    }
    methods: dict[str, Any] = dict(METHODS)
    for kind, method in methods.items():
        integrator = kind if method.adaptive else method(_DURATION)
        yield f"simulate(method={kind})", partial(simulate, scenes[""], method=integrator)
    yield "simulate_many", partial(simulate_many, system, seeds=[0, 1], duration=_DURATION)
    still = partial(simulate_many, system, x0=two_shapes, momentum=0, duration=_DURATION)
    yield "simulate_many at zero momentum", still
    for words, scene in scenes.items():
        yield f"simulate{words}", partial(simulate, scene)
        for name, use in uses.items():
            yield f"{name}{words}", partial(use_flow, use, scene)
    yield "Reduction.grid", partial(Reduction(system).grid, two_shapes)
