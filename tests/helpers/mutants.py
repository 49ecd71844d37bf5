"""Create mutants of modules and find the tests that kill them.

    python tests/helpers/mutants.py MODULE …

Each mutant is one small change of one module (see mutations.py) in a copy of the package. The
tests of the module's package that run the changed line are run, quickest first, and the further
cases of a parametrized test later. A mutant is "killed" if a test fails. It has "survived" if all
tests pass: either the tests do not detect the change, or it has no effect. It is "not run" if no
test runs the line, which is no better. Tests marked slow run only with --slow.

Options: --table FILE.csv; --sample N (number of random mutants per module, drawn with --seed);
--seconds (time limit for the tests of a mutant); --budget (limit on the total duration of the tests
of a mutant, measured without it); --tests (instead of the tests of the package); --only LINE …
(mutants of these lines); --keep FOLDER (work in this folder, and reuse the line coverage and the
compiled code of an earlier run).

Tests run in forks of a session that has imported everything (mutant_session.py). If a mutant
changes code that runs at import, its fork imports the package again. Compiled kernels and
integrators are cached in a separate folder. If a mutant may affect compiled code, its fork uses
no cache.
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

import pytest
from mutant_session import MutantSession, is_woven
from mutations import Mutant, mutants

ROOT = Path(__file__).parents[2]
# The tests that most likely kill a mutant.
TESTS: dict[str, list[str]] = {
    "judge": [
        "judge/test_audit.py", "judge/test_compare.py", "judge/test_impact_checks.py",
        "judge/test_bounds_of_compare.py", "judge/test_error_bounds.py",
        "judge/test_full_system.py", "judge/test_step_defects.py",
        "judge/test_reference_solution.py", "judge/test_reference_integrators.py",
        "judge/test_gravity_loads.py", "judge/test_stiff_defects.py",
        "simulation/test_balances.py", "views/test_notebook_cards.py",
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
    "integrators/explicit/run_sensitivities": [
        "integrators/test_run_derivatives.py", "simulation/test_step_map.py",
        "simulation/test_flow_map.py", "simulation/test_adapters.py",
    ],
    "integrators/explicit": [
        "integrators/test_steppers.py", "integrators/test_measured_orders.py",
        "integrators/test_tableaux.py", "integrators/test_rotation_tolerance.py",
        "integrators/test_step_control.py",
    ],
    "integrators/implicit/gauss_sensitivities": [
        "integrators/test_run_derivatives.py", "simulation/test_step_map.py",
        "simulation/test_flow_map.py", "simulation/test_adapters.py",
    ],
    "integrators/implicit/gauss": [
        "integrators/test_counted_evaluations.py", "integrators/test_step_control.py",
        "integrators/test_gauss.py", "integrators/test_newton_in_gauss.py",
    ],
    "integrators/implicit/radau_iia": [
        "integrators/test_counted_evaluations.py", "integrators/test_step_control.py",
        "integrators/test_radau.py",
    ],
    "integrators/implicit/lagrange_poincare": [
        "integrators/test_counted_evaluations.py", "integrators/test_variational.py",
    ],
    "integrators/lanes": ["integrators/test_lanes.py", "integrators/test_measured_orders.py"],
    "integrators/methods": [
        "integrators/test_equal_steps.py", "integrators/test_further_method.py",
        "integrators/test_tableaux.py", "integrators/test_steppers.py",
        "integrators/test_batches.py",
    ],
    "integrators/stepping/run_state": [
        "integrators/test_run_record.py", "integrators/test_run_derivatives.py",
        "simulation/test_step_map.py",
        "simulation/test_flow_map.py",
    ],
    "integrators/run_derivatives": [
        "integrators/test_run_derivatives.py", "simulation/test_step_map.py",
        "simulation/test_flow_map.py",
    ],
    "integrators": [
        "integrators/test_counted_evaluations.py", "integrators/test_step_control.py",
        "integrators/test_steppers.py", "integrators/test_batches.py",
        "integrators/test_measured_orders.py", "integrators/test_further_method.py",
        "integrators/test_work_rows.py", "integrators/test_radau.py",
        "integrators/test_several_quaternions.py",
    ],
    "simulation": [
        "simulation/test_balances.py", "judge/test_audit.py", "forces/test_forces.py",
        "judge/test_bounds_of_compare.py", "judge/test_small_faults.py",
        "views/test_notebook_cards.py",
    ],
}  # fmt: skip


def tests_of(module: str) -> list[str]:
    """Return the test files that most likely kill a mutant of a module."""
    mirrored = [module.rsplit("/", 1)[0] + "/test_" + module.rsplit("/", 1)[-1]]
    listed = [tests for start, tests in TESTS.items() if module.startswith(start)]
    tests = [*(listed[0] if listed else [module.split("/", maxsplit=1)[0]]), *mirrored]
    existing = [
        f"tests/{name}" for name in dict.fromkeys(tests) if (ROOT / "tests" / name).exists()
    ]
    folders = [name for name in existing if not name.endswith(".py")]
    return [
        name for name in existing if name in folders or Path(name).parent.as_posix() not in folders
    ]


class Copy:
    """A copy of the project in which modules are mutated and tests run, one run at a time.

    The dependencies of pinred are imported once, in this process. Each run is a fork of it that
    imports pinred from the copy.
    """

    def __init__(self, place: Path, *, slow: bool) -> None:
        """Copy the project to a folder.  slow: also run tests that are marked slow."""
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

    def coverage_path(self, tests: list[str], modules: list[str]) -> Path:
        """Return the file of the line coverage of tests for the current sources."""
        digest = sha256(" ".join([*tests, "of", *modules]).encode())
        for folder in ("pinred", "tests"):
            for path in sorted((self.root / folder).rglob("*.py")):
                digest.update(path.read_bytes())
        return self.root.parent / f"{digest.hexdigest()[:16]}.json"

    def session(self, tests: list[str], plugin: MutantSession) -> None:
        """Run a session of tests with a plugin; raise SystemExit if it fails."""
        if self._forked(tests, plugin, {}, 1e6):
            output = self._said.read_text(errors="replace")
            raise SystemExit(f"the session of tests has failed:\n{output[-3000:]}")

    def outcome(self, module: str, mutant: Mutant, tests: list[str], seconds: float) -> str:
        """Return the outcome of a mutant by importing the package with it."""
        target = self.root / "pinred" / module
        text = target.read_text()
        self._write(target, mutant.text)
        with tempfile.TemporaryDirectory() as cache:
            files = list(dict.fromkeys(test.split("::")[0] for test in tests))
            # The keys of numba functions depend on their sources, so these need no own folder.
            is_numba = module.startswith("integrators") or is_woven(target)
            environment = {} if is_numba else {"PINRED_CACHE_DIR": cache}
            code = self._forked(files, Chosen(tests), environment, seconds)
        self._write(target, text)
        if code == 0:
            return "survived"
        output = self._said.read_text(errors="replace").splitlines()
        failed = [line for line in output if line.startswith(("FAILED", "ERROR"))]
        if code is None or not failed:
            return f"killed by {'time' if code is None else 'an error'}"
        return f"killed by {failed[0].split(' - ')[0].split(maxsplit=1)[1]}"

    def _write(self, target: Path, text: str) -> None:
        """Write a module with a unique modification time, which identifies its bytecode."""
        target.write_text(text)
        self._writes += 1
        os.utime(target, (self._writes, self._writes))

    def _forked(
        self, tests: list[str], plugin: object, environment: dict[str, str], seconds: float
    ) -> int | None:
        """Run tests in a fork until one fails; return its exit code, or None after a time-out."""
        child = os.fork()
        if not child:
            try:
                os.setsid()
                with self._said.open("w") as output_file:
                    os.dup2(output_file.fileno(), 1)
                    os.dup2(output_file.fileno(), 2)
                os.chdir(self.root)
                os.environ["PINRED_CACHE_DIR"] = str(self._cache)
                os.environ["PYTHONPATH"] = str(self.root)
                sys.path.insert(0, str(self.root))
                # Integrators stay in the folder that is set at this import.
                importlib.import_module("pinred.integrators.stepping.shipped_code")
                os.environ.update(environment)
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
            finished, status = os.waitpid(child, os.WNOHANG)
            if finished:
                return os.waitstatus_to_exitcode(status)
            time.sleep(0.02)
        os.killpg(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return None


class Chosen:
    """The pytest plugin that runs only the given tests, in the given order."""

    def __init__(self, tests: list[str]) -> None:
        """Take the names of tests as pytest prints them."""
        self._rank = {test: k for k, test in enumerate(tests)}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(
        self, config: pytest.Config, items: list[pytest.Item]
    ) -> None:
        """Deselect all other tests."""
        deselected = [item for item in items if item.nodeid not in self._rank]
        items[:] = sorted(
            (item for item in items if item.nodeid in self._rank),
            key=lambda item: self._rank[item.nodeid],
        )
        config.hook.pytest_deselected(items=deselected)


@dataclass(frozen=True)
class Row:
    """The outcome of a mutant.

    Attributes:
        module: Mutated module.
        mutant: Number of the mutant.
        line: Line number of the change.
        change: Code before and after.
        outcome: "killed by …", "survived", "not run", or "" while pending.
        tests: Tests to run if the package must be imported with the mutant.
        seconds: Duration of the tests [s].
    """

    module: str
    mutant: int
    line: int
    change: str
    outcome: str
    tests: list[str]
    seconds: float


def main(arguments: list[str]) -> int:
    """Run the mutants of modules; return 1 if one was not killed, else 0."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("modules", nargs="+", help="for example judge/compare.py")
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
            by_module = {
                name: list(mutants((ROOT / "pinred" / name).read_text())) for name in modules
            }
            if options.sample is not None:  # a larger sample contains a smaller one
                for all_mutants in by_module.values():
                    Random(options.seed).shuffle(all_mutants)
            rows += _outcomes(copied, list(tests), by_module, options)
            for module, all_mutants in by_module.items():
                tried = [row for row in rows if row.module == module]
                killed = sum(row.outcome.startswith("killed") for row in tried)
                print(
                    f"{module:<40} {len(tried):4d} of {len(all_mutants):4d}: {killed:4d} killed",
                    flush=True,
                )
            if options.table is not None:
                with options.table.open("w", newline="") as file:
                    table = csv.writer(file)
                    table.writerow(["module", "line", "change", "outcome", "seconds"])
                    table.writerows(
                        [r.module, r.line, r.change, r.outcome, r.seconds] for r in rows
                    )
    return int(any(not row.outcome.startswith("killed") for row in rows))


def _outcomes(
    copied: Copy, tests: list[str], by_module: dict[str, list[Mutant]], options: argparse.Namespace
) -> list[Row]:
    """Return the outcomes of mutants of modules that have the same tests."""
    coverage_file, rows_file = (
        copied.coverage_path(tests, list(by_module)),
        copied.root.parent / "rows",
    )
    output = os.fdopen(os.dup(1), "w")

    def run_mutants(session: MutantSession) -> None:
        session.cover(coverage_file)
        rows = []
        for module, of_module in by_module.items():
            for k, mutant in enumerate(of_module[: options.sample]):
                if options.only is not None and mutant.line not in options.only:
                    continue
                start = time.monotonic()
                outcome = session.outcome(module, mutant) or ""
                seconds = round(time.monotonic() - start, 1)
                pending_tests = [] if outcome else session.tests(module, mutant)
                rows.append(
                    Row(module, k, mutant.line, mutant.what, outcome, pending_tests, seconds)
                )
                _print_row(rows[-1], output)
        rows_file.write_bytes(pickle.dumps(rows))

    plugin = MutantSession(
        copied.root / "pinred", list(by_module), run_mutants,
        seconds=options.seconds, budget=options.budget,
    )  # fmt: skip
    copied.session(tests, plugin)
    rows: list[Row] = []
    for row in pickle.loads(rows_file.read_bytes()):
        if not row.outcome:
            start = time.monotonic()
            mutant = by_module[row.module][row.mutant]
            outcome = copied.outcome(row.module, mutant, row.tests, options.seconds)
            row = replace(row, outcome=outcome, seconds=round(time.monotonic() - start, 1))
            _print_row(row, output)
        rows.append(row)
    return rows


def _print_row(row: Row, output: TextIO) -> None:
    """Print the outcome of a mutant, unless it is pending."""
    if row.outcome:
        print(f"{row.module}:{row.line}: {row.change}: {row.outcome}", file=output, flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
