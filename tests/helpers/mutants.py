"""Mutants of modules, and the tests that kill them: `python tests/helpers/mutants.py MODULE …`.

Each mutant is one small change of one module (see mutations.py), in a copy of the package.  Of
the tests of the module's room, those that run the changed line are run, the quickest first and
further cases of the same later, until one fails (killed) or all pass (survived: the tests do not
see it, or there is nothing to see).
Where none runs the line, it is "not run", which is no better.  Options: --table FILE.csv, --sample
N (so many of each module, at random by --seed), --seconds of a mutant's tests, --budget (seconds
of tests without a mutant, of which the others are left out), --tests (these instead of the
room's), --only LINE … (mutants of these lines), --keep FOLDER (works there, and keeps which test
runs which line, and what is compiled, for the next time).  Tests marked slow are left out, unless
--slow is given.

Tests run in forks of a session that has imported everything (mutant_session.py); where a mutant
is of what runs at import, in one that imports the package anew.  Compiled kernels and integrators
are kept in a cache of the run's own; where a mutant may be part of what was compiled, there is
none.
"""

from __future__ import annotations

import argparse
import csv
import importlib
import os
import pickle
import shutil
import signal
import sys
import tempfile
import time
import traceback
from contextlib import suppress
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from random import Random
from typing import TextIO

import numba
import pytest
from mutant_session import MutantSession
from mutations import Mutant, mutants

ROOT = Path(__file__).parents[2]
# The tests that most likely kill a mutant.
TESTS: dict[str, list[str]] = {
    "judge": [
        "judge/test_audit.py", "judge/test_compare.py",
        "judge/test_bounds_of_compare.py", "judge/test_error_bounds.py",
        "judge/test_coupling_constraints.py", "judge/test_step_defects.py",
        "judge/test_distances.py", "judge/test_equation_errors.py",
        "judge/test_gravity_loads.py", "simulation/test_balances.py",
        "views/test_notebook_cards.py",
    ],
    "kernels/validation": [
        "kernels/test_velocity_validation.py", "kernels/test_kernel_validation.py",
        "kernels/test_validation_tolerances.py", "kernels/test_force_validation.py",
        "kernels/test_term_magnitudes.py", "forces/test_refused_forces.py",
    ],
    "kernels/reference_state": [
        "kernels/test_reference_state.py", "kernels/test_velocity_validation.py",
        "kernels/test_kernel_validation.py", "kernels/test_validation_tolerances.py",
        "kernels/test_force_validation.py", "kernels/test_term_magnitudes.py",
        "kernels/test_perturbed_parameters.py", "forces/test_refused_forces.py",
    ],
    "reduction": [
        "reduction", "kernels/test_identical_branches.py", "simulation/test_varied_inertias.py",
        "system/test_refusals.py", "views/test_notebook_cards.py", "simulation/test_skipping.py",
    ],
    "lie": ["lie", "system/test_root_chain.py"],
    "forces": [
        "forces", "scene/test_odd_values.py", "simulation/test_balances.py",
        "views/test_notebook_cards.py",
    ],
    "integrators/explicit/forward_sensitivities": [
        "simulation/test_step_map.py", "simulation/test_flow_map.py",
    ],
    "integrators/explicit/adjoint_sweep": [
        "simulation/test_flow_map.py", "simulation/test_adapters.py",
    ],
    "integrators/explicit": [
        "integrators/test_steppers.py", "integrators/test_measured_orders.py",
        "integrators/test_tableaux.py", "integrators/test_rotation_tolerance.py",
        "integrators/test_step_control.py",
    ],
    "integrators/gauss/stage_sensitivities": [
        "simulation/test_step_map.py", "simulation/test_flow_map.py",
    ],
    "integrators/gauss/adjoint_steps": [
        "simulation/test_flow_map.py", "simulation/test_adapters.py",
    ],
    "integrators/gauss": [
        "integrators/test_counted_evaluations.py", "integrators/test_step_control.py",
        "integrators/test_gauss.py", "integrators/test_newton_in_gauss.py",
    ],
    "integrators/radau": [
        "integrators/test_counted_evaluations.py", "integrators/test_step_control.py",
        "integrators/test_radau.py",
    ],
    "integrators/variational": [
        "integrators/test_counted_evaluations.py", "integrators/test_variational.py",
    ],
    "integrators/lanes": ["integrators/test_lanes.py", "integrators/test_measured_orders.py"],
    "integrators/methods": [
        "integrators/test_equal_steps.py", "integrators/test_further_method.py",
        "integrators/test_tableaux.py", "integrators/test_steppers.py",
        "integrators/test_batches.py",
    ],
    "integrators/run_derivatives": ["simulation/test_step_map.py", "simulation/test_flow_map.py"],
    "integrators": [
        "integrators/test_counted_evaluations.py", "integrators/test_step_control.py",
        "integrators/test_steppers.py", "integrators/test_batches.py",
        "integrators/test_measured_orders.py", "integrators/test_further_method.py",
        "integrators/test_work_rows.py", "integrators/test_radau.py",
    ],
    "simulation": [
        "simulation/test_balances.py", "judge/test_audit.py", "forces/test_forces.py",
        "judge/test_bounds_of_compare.py", "judge/test_small_faults.py",
        "views/test_notebook_cards.py",
    ],
}  # fmt: skip


def tests_of(module: str) -> list[str]:
    """Return the tests that most likely kill a mutant of a module of the package."""
    mirrored = [module.rsplit("/", 1)[0] + "/test_" + module.rsplit("/", 1)[-1]]
    known = [tests for start, tests in TESTS.items() if module.startswith(start)]
    tests = [*(known[0] if known else [module.split("/", maxsplit=1)[0]]), *mirrored]
    found = [f"tests/{name}" for name in dict.fromkeys(tests) if (ROOT / "tests" / name).exists()]
    folders = [name for name in found if not name.endswith(".py")]
    return [
        name for name in found if name in folders or Path(name).parent.as_posix() not in folders
    ]


class Copy:
    """A copy of the project in which modules are changed and tests run, one run after the other.

    What pinred stands on is imported once, in this process; each run is a fork of it that takes
    pinred from the copy.
    """

    def __init__(self, place: Path, *, slow: bool) -> None:
        """Copy the project to a folder.  slow: run tests that are marked so, too."""
        self.root, self._cache = place / "project", place / "cache"
        self._said, self._writes, self._slow = place / "said", 0, slow
        ignored = shutil.ignore_patterns("__pycache__")
        if self.root.exists():
            shutil.rmtree(self.root)
        self.root.mkdir(parents=True)
        for name in ("pinred", "tests", "robots", "docs", "examples", "pyproject.toml"):
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, self.root / name, ignore=ignored)
            else:
                shutil.copy(ROOT / name, self.root / name)
        for name in (
            "casadi", "llvmlite.binding", "meshcat", "mujoco", "numba.typed", "numpy.testing",
            "pinocchio", "scipy.integrate", "scipy.interpolate", "scipy.optimize", "scipy.sparse",
            "scipy.spatial.transform",
        ):  # fmt: skip
            with suppress(ImportError):
                importlib.import_module(name)

    def path_of_covering(self, tests: list[str], modules: list[str]) -> Path:
        """Return where it is kept what tests cover of modules, as all of them are now."""
        digest = sha256(" ".join([*tests, "of", *modules]).encode())
        for folder in ("pinred", "tests"):
            for path in sorted((self.root / folder).rglob("*.py")):
                digest.update(path.read_bytes())
        return self.root.parent / f"{digest.hexdigest()[:16]}.json"

    def session(self, tests: list[str], plugin: MutantSession) -> None:
        """Run a session of tests with a plugin; raise SystemExit if it fails."""
        if self._forked(tests, plugin, {}, 1e6):
            said = self._said.read_text(errors="replace")
            raise SystemExit(f"the session of tests has failed:\n{said[-3000:]}")

    def outcome(self, module: str, mutant: Mutant, tests: list[str], seconds: float) -> str:
        """Return what tests say of a mutant when the package is imported with it."""
        target = self.root / "pinred" / module
        text = target.read_text()
        self._write(target, mutant.text)
        with tempfile.TemporaryDirectory() as own_cache:
            files = list(dict.fromkeys(test.split("::")[0] for test in tests))
            own = "NUMBA" if module.startswith("integrators") else "PINRED"
            places = {f"{own}_CACHE_DIR": own_cache}
            code = self._forked(files, Chosen(tests), places, seconds)
        self._write(target, text)
        if code == 0:
            return "survived"
        said = self._said.read_text(errors="replace").splitlines()
        failed = [line for line in said if line.startswith(("FAILED", "ERROR"))]
        if code is None or not failed:
            return f"killed by {'time' if code is None else 'an error'}"
        return f"killed by {failed[0].split(' - ')[0].split(maxsplit=1)[1]}"

    def _write(self, target: Path, text: str) -> None:
        """Write a module with a time of its own, by which compiled ones are told from others."""
        target.write_text(text)
        self._writes += 1
        os.utime(target, (self._writes, self._writes))

    def _forked(
        self, tests: list[str], plugin: object, places: dict[str, str], seconds: float
    ) -> int | None:
        """Run tests in a fork until one fails and return its exit code; None if it took longer."""
        child = os.fork()
        if not child:
            try:
                os.setsid()
                with self._said.open("w") as said:
                    os.dup2(said.fileno(), 1)
                    os.dup2(said.fileno(), 2)
                os.chdir(self.root)
                own = {"PINRED_CACHE_DIR": self._cache, "NUMBA_CACHE_DIR": self._cache}
                os.environ.update({name: str(path) for name, path in own.items()} | places)
                os.environ["PYTHONPATH"] = str(self.root)
                numba.config.reload_config()  # type: ignore[no-untyped-call]
                sys.path.insert(0, str(self.root))
                slow = [] if self._slow else ["-m", "not slow"]
                options = ["-q", "-x", "-s", *slow, "-p", "no:cacheprovider"]
                code = int(pytest.main([*options, *tests], plugins=[plugin]))
                sys.stdout.flush()
                os._exit(code)
            except BaseException:
                traceback.print_exc()
            finally:
                sys.stderr.flush()
                os._exit(70)
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            found, status = os.waitpid(child, os.WNOHANG)
            if found:
                return os.waitstatus_to_exitcode(status)
            time.sleep(0.02)
        os.killpg(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return None


class Chosen:
    """The plugin that runs these tests only, in this order."""

    def __init__(self, tests: list[str]) -> None:
        """Take the names of tests as pytest prints them."""
        self._rank = {test: k for k, test in enumerate(tests)}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(
        self, config: pytest.Config, items: list[pytest.Item]
    ) -> None:
        """Leave the others out."""
        left_out = [item for item in items if item.nodeid not in self._rank]
        items[:] = sorted(
            (item for item in items if item.nodeid in self._rank),
            key=lambda item: self._rank[item.nodeid],
        )
        config.hook.pytest_deselected(items=left_out)


@dataclass(frozen=True)
class Row:
    """What became of a mutant.  tests: those to be run, where it has to be imported."""

    module: str
    mutant: int
    line: int
    change: str
    outcome: str
    tests: list[str]
    seconds: float


def main(arguments: list[str]) -> int:
    """Run the mutants of modules; return how many survived, at most 1."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("modules", nargs="+", help="such as judge/compare.py")
    parser.add_argument("--table", type=Path)
    parser.add_argument("--sample", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tests", nargs="+", default=[])
    parser.add_argument("--seconds", type=float, default=180.0)
    parser.add_argument("--budget", type=float, default=1e6)
    parser.add_argument("--only", nargs="+", type=int)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--slow", action="store_true")
    options = parser.parse_args(arguments)
    groups: dict[tuple[str, ...], list[str]] = {}
    for module in options.modules:
        groups.setdefault(tuple(options.tests or tests_of(module)), []).append(module)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as place:
        copied = Copy((options.keep or Path(place)).resolve(), slow=options.slow)
        for tests, modules in groups.items():
            every = {name: list(mutants((ROOT / "pinred" / name).read_text())) for name in modules}
            if options.sample is not None:  # a larger sample holds a smaller one
                for each in every.values():
                    Random(options.seed).shuffle(each)
            rows += _found(copied, list(tests), every, options)
            for module, each in every.items():
                of = [row for row in rows if row.module == module]
                killed = sum(row.outcome.startswith("killed") for row in of)
                print(
                    f"{module:<40} {len(of):4d} of {len(each):4d}: {killed:4d} killed", flush=True
                )
            if options.table is not None:
                with options.table.open("w", newline="") as file:
                    table = csv.writer(file)
                    table.writerow(["module", "line", "change", "outcome", "seconds"])
                    table.writerows(
                        [r.module, r.line, r.change, r.outcome, r.seconds] for r in rows
                    )
    return int(any(not row.outcome.startswith("killed") for row in rows))


def _found(
    copied: Copy, tests: list[str], every: dict[str, list[Mutant]], options: argparse.Namespace
) -> list[Row]:
    """Return what became of mutants of modules that have the same tests."""
    covering, kept = copied.path_of_covering(tests, list(every)), copied.root.parent / "rows"
    told = os.fdopen(os.dup(1), "w")

    def asked(session: MutantSession) -> None:
        session.cover(covering)
        rows = []
        for module, each in every.items():
            for k, mutant in enumerate(each[: options.sample]):
                if options.only is not None and mutant.line not in options.only:
                    continue
                began = time.monotonic()
                found = session.outcome(module, mutant) or ""
                took = round(time.monotonic() - began, 1)
                left = [] if found else session.tests(module, mutant)
                rows.append(Row(module, k, mutant.line, mutant.what, found, left, took))
                _tell(rows[-1], told)
        kept.write_bytes(pickle.dumps(rows))

    plugin = MutantSession(
        copied.root / "pinred", list(every), asked,
        seconds=options.seconds, budget=options.budget,
    )  # fmt: skip
    copied.session(tests, plugin)
    rows: list[Row] = []
    for row in pickle.loads(kept.read_bytes()):
        if not row.outcome:
            began = time.monotonic()
            mutant = every[row.module][row.mutant]
            found = copied.outcome(row.module, mutant, row.tests, options.seconds)
            row = replace(row, outcome=found, seconds=round(time.monotonic() - began, 1))
            _tell(row, told)
        rows.append(row)
    return rows


def _tell(row: Row, told: TextIO) -> None:
    """Print what became of a mutant, unless it is left for later."""
    if row.outcome:
        print(f"{row.module}:{row.line}: {row.change}: {row.outcome}", file=told, flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
