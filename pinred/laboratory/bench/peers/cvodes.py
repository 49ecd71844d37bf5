"""CVODES (Adams) through CasADi, on C that it has generated and gcc has compiled."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import casadi as ca
import numpy as np

from ....common.arrays import Array
from ....common.errors import IntegrationError, UnsupportedOperationError
from ....system.state_fields import with_base
from ....system.system import System
from ..problems import Problem
from ..solver import ATOL, End, PreparedRun, Solver, decades
from ..taylor import reduced_graph
from .equality import missing_unless_equal, no_mass_matrix
from .first_principles import full_graph

_FLAGS = ("-O2", "-march=native", "-ffp-contract=fast", "-fPIC", "-shared")
_MOST = 100_000_000  # steps
_NO_COMPILER = "no C compiler; install gcc"


@dataclass(frozen=True)
class Compiled:
    """A Function of CasADi in machine code.  build: s.  folder: where it lies, while it does."""

    function: ca.Function
    build: float
    folder: Any


def compiled(function: ca.Function) -> Compiled:
    """Return a Function compiled by gcc.  Raises UnsupportedOperationError without one."""
    compiler = _compiler()
    if compiler is None:
        raise UnsupportedOperationError(_NO_COMPILER)
    folder = TemporaryDirectory(prefix="pinred-cvodes-")
    began, name, here = time.perf_counter(), function.name(), Path.cwd()
    library = Path(folder.name, f"{name}.so")
    try:
        os.chdir(folder.name)  # the generator takes no folder
        function.generate(f"{name}.c")
        subprocess.run([compiler, *_FLAGS, f"{name}.c", "-o", library.name], check=True)
    finally:
        os.chdir(here)
    # CVODES is set up with a Jacobian, which Adams with functional iteration never asks for.
    return Compiled(
        ca.external(name, str(library), {"enable_fd": True}), time.perf_counter() - began, folder
    )


def _compiler() -> str | None:
    return shutil.which("gcc") or shutil.which("cc")


class FullModel:
    """The full dynamics in C, told and asked in Pinocchio's coordinates."""

    def __init__(self, system: System) -> None:
        """Make and compile the graph."""
        self.system = system
        self.compiled = compiled(full_graph(system))

    def mass_matrix(self, q: Array) -> Array:  # noqa: ARG002
        """Say that there is none."""
        return no_mass_matrix(self.system)

    def acceleration(self, q: Array, v: Array) -> Array:
        """Return Pinocchio's dv/dt without torques, (n,)."""
        at = self.system.configuration(q)
        rate = self.compiled.function(np.concatenate([at.pose, at.x, v]))
        return np.array(rate).ravel()[-self.system.n :]


def full_model(system: System) -> FullModel:
    """Return the compiled full dynamics, made once for a thread."""
    return system.workspace("full C", lambda: FullModel(system))


def _integrator(function: ca.Function, duration: float, tolerance: float) -> ca.Function:
    dae: dict[str, Any] = {"x": ca.MX.sym("y", function.numel_in(0))}
    if function.n_in() > 1:
        dae["p"] = ca.MX.sym("p", function.numel_in(1))
    dae["ode"] = function(*dae.values())
    options: dict[str, Any] = {
        "linear_multistep_method": "adams",
        "nonlinear_solver_iteration": "functional",
        "reltol": tolerance,
        "abstol": ATOL * tolerance,
        "max_num_steps": _MOST,
        "disable_internal_warnings": True,
        "show_eval_warnings": False,
    }
    return ca.integrator("cvodes", "cvodes", dae, 0.0, duration, options)


def _run(integrator: ca.Function, given: dict[str, Array]) -> Array:
    try:
        return np.array(integrator(**given)["xf"]).ravel()
    except RuntimeError as error:
        text = " ".join(str(error).split())
        raise IntegrationError(f"CVODES: {text[-200:]}") from None


def _full(problem: Problem, tolerance: float) -> PreparedRun:
    code, y0 = full_model(problem.system).compiled, problem.full_start()
    size, m = problem.system.group.size, problem.system.m
    integrator = _integrator(code.function, problem.start.duration, tolerance)

    def end(y: Array) -> End:
        count = float(integrator.stats()["nfevals"])
        return End(y[size : size + m], problem.full.q(y), y[size + m :], count)

    return PreparedRun(lambda: _run(integrator, {"x0": y0}), end, code.build)


def _reduced(problem: Problem, tolerance: float) -> PreparedRun:
    from ....simulation.compiled.compiled_flow import CompiledFlow
    from ....simulation.plan import plan_of

    scene = problem.scene()
    flow = CompiledFlow.of_plan(plan_of(scene))
    code = problem.system.workspace(
        ("reduced C", problem.name), lambda: compiled(reduced_graph(problem))
    )
    integrator = _integrator(code.function, scene.end, tolerance)
    given = {"x0": flow.y0, "p": flow.parameters}

    def end(y: Array) -> End:
        count = float(integrator.stats()["nfevals"])
        states = with_base(flow.states(scene.report_times, y[None]), problem.name)
        return End(states.x[0], states.q[0], states.v[0], count)

    return PreparedRun(lambda: _run(integrator, given), end, code.build)


CVODES = (
    Solver(
        "cvodes",
        "CVODES with Adams through CasADi, on the full dynamics in C compiled by gcc",
        decades(2, 13),
        _full,
        missing_unless_equal("casadi", "CVODES", full_model),
    ),
    Solver(
        "cvodes-reduced",
        "the same on pinred's reduced equations, integration alone",
        decades(2, 13),
        _reduced,
        lambda _: "" if _compiler() else f"CVODES is left out: {_NO_COMPILER}",
    ),
)
