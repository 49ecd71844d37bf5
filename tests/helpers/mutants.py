"""Mutants of modules, and the tests that kill them: `python tests/helpers/mutants.py MODULE …`.

Each mutant is one small change of one module (see mutations.py), in a copy of the package.  Of
the tests of the module's room, those that run the changed line are run, the quickest first, until
one fails (killed) or all pass (survived: the tests do not see it, or there is nothing to see).
Where none runs the line, it is "not run", which is no better.  Options: --table FILE.csv, --sample
N (so many of each module, at random by --seed), --seconds of a mutant's tests, --tests (these
instead of the room's), --only LINE … (mutants of these lines), --keep FOLDER (works there, and
keeps which test runs which line, and what is compiled, for the next time).  Tests marked slow are
left out, unless --slow is given.

Compiled kernels and integrators are kept in a cache of the run's own; where a mutant may be part
of what was compiled, in one of its own.
"""

from __future__ import annotations

import argparse
import csv
import importlib
import os
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter, defaultdict
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from random import Random

import numba
import pytest
from covering import Chosen, Covering, Recorder, SameKernels
from mutations import Mutant, mutants

ROOT = Path(__file__).parents[2]
LONG = 20.0  # s; tests that take longer are left out
_KERNELS = ["kernels/test_compiled_kernels.py", "kernels/test_limbs.py"]
_STEPPERS = ["integrators/test_steppers.py", "integrators/test_claimed_orders.py"]
_GAUSS = ["integrators/test_gauss.py", "integrators/test_newton_in_gauss.py"]
_LANES = ["integrators/test_lanes.py", "integrators/test_batches.py"]
# The tests that most likely kill a mutant.
TESTS: dict[str, list[str]] = {
    "verification": [
        "verification/test_audit.py", "verification/test_compare.py",
        "verification/test_bounds_of_compare.py", "verification/test_bounds_of_ends.py",
        "verification/test_ties.py", "verification/test_defects.py",
        "verification/test_distances.py", "verification/test_equations_of_motion.py",
        "verification/test_weights.py", "verification/test_false_alarms.py",
        "verification/test_small_faults.py", "views/test_notebook_cards.py",
        "simulation/test_balances.py", "simulation/test_coupled_motion.py",
        "forces/test_forces_in_space.py",
    ],
    "kernels/judge": [
        "kernels/test_judged_state.py", "kernels/test_judged_velocities.py",
        "kernels/test_judge.py", "forces/test_refused_forces.py", "forces/test_prescribed.py",
        "reduction/test_gravity.py", "forces/test_forces_in_space.py",
    ],
    "reduction/tree": ["reduction", *_KERNELS, "simulation/test_varied_inertias.py"],
    "reduction": [
        "reduction", "system/test_refusals.py", "views/test_notebook_cards.py",
        "simulation/test_skipping.py",
    ],
    "lie": ["lie", "system/test_root_chain.py"],
    "forces": [
        "forces", "scene/test_odd_values.py", "simulation/test_balances.py",
        "kernels/test_machine_code.py", "views/test_notebook_cards.py",
    ],
    "integrators/radau": ["integrators/test_radau.py", *_STEPPERS],
    "integrators/methods/radau": ["integrators/test_radau.py", *_STEPPERS],
    "integrators/explicit": [
        *_STEPPERS, "integrators/test_tableaux.py", "integrators/test_tolerance_of_turns.py",
        "integrators/test_lanes.py", "simulation/test_flow_map.py",
    ],
    "integrators/gauss": [*_GAUSS, *_STEPPERS],
    "integrators/variational": ["integrators/test_variational.py", *_STEPPERS],
    "integrators/lanes": [*_LANES, "integrators/test_steppers.py"],
    "integrators": ["integrators", "simulation/test_step_map.py"],
    "simulation/balances": [
        "simulation/test_balances.py", "verification/test_audit.py",
        "views/test_notebook_cards.py", "forces/test_forces.py",
    ],
    "simulation/accelerations": [
        "verification/test_bounds_of_compare.py", "verification/test_small_faults.py",
        "simulation", "forces",
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
    pinred from the copy.  Tests that have killed before come first.
    """

    def __init__(self, place: Path, *, slow: bool) -> None:
        """Copy the project to a folder.  slow: run tests that are marked so, too."""
        self.root, self._cache = place / "project", place / "cache"
        self._said, self._writes, self._slow = place / "said", 0, slow
        self._killers: defaultdict[str, Counter[str]] = defaultdict(Counter)
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

    def covering(self, tests: list[str], modules: list[str]) -> Covering:
        """Return what tests cover of modules without a mutant; raise SystemExit if one fails."""
        digest = sha256(" ".join([*tests, "of", *modules]).encode())
        for folder in ("pinred", "tests"):
            for path in sorted((self.root / folder).rglob("*.py")):
                digest.update(path.read_bytes())
        path = self.root.parent / f"{digest.hexdigest()[:16]}.json"
        if not path.exists():
            recorder = Recorder(self.root / "pinred", modules, path)
            code = self._forked(tests, [recorder, SameKernels()], self._places(None), 3600.0)
            if code:
                raise SystemExit(f"tests fail without a mutant:\n{self._said.read_text()[-3000:]}")
        return Covering.read(path)

    def outcome(self, module: str, mutant: Mutant, covering: Covering, seconds: float) -> str:
        """Return what the tests say of a mutant."""
        tests = self.tests(module, mutant, covering)
        if not tests:
            return "not run"
        target = self.root / "pinred" / module
        own = target.read_text()
        self._write(target, mutant.text)
        with tempfile.TemporaryDirectory() as own_cache:
            files = list(dict.fromkeys(test.split("::")[0] for test in tests))
            places = self._places(Path(own_cache), module)
            plugins: list[object] = [Chosen(tests)]
            if module.startswith("kernels/judge"):  # which is no part of what is compiled
                plugins.append(SameKernels())
            code = self._forked(files, plugins, places, seconds)
        self._write(target, own)
        if code == 0:
            return "survived"
        said = self._said.read_text(errors="replace").splitlines()
        failed = [line for line in said if line.startswith(("FAILED", "ERROR"))]
        if code is None or not failed:
            return f"killed by {'time' if code is None else 'an error'}"
        killer = failed[0].split(" - ")[0].split(maxsplit=1)[1]
        if "::" in killer:
            self._killers[module][killer] += 1
        return f"killed by {killer}"

    def tests(self, module: str, mutant: Mutant, covering: Covering) -> list[str]:
        """Return the tests that may kill a mutant, the likeliest first."""
        tests = covering.tests(module, mutant.line, mutant.end) if mutant.inside else []
        if not mutant.inside or (not tests and module.startswith("integrators")):
            tests = covering.of_module(module)
        tests = [test for test in tests if covering.seconds[test] < LONG]
        killers = [name for name, _ in self._killers[module].most_common(3) if name in tests]
        return list(dict.fromkeys([*killers, *tests]))

    def _places(self, own: Path | None, module: str = "") -> dict[str, str]:
        """Return where what is compiled is kept, for a mutant of a module in a folder of its own.

        Keys of kernels tell what lie, kernels and reduction/tree are from what they were.
        """
        graphs = own is not None and module.startswith(("forces", "reduction/", "integrators"))
        graphs = graphs and not module.startswith("reduction/tree")
        steppers = own is not None and module.startswith("integrators")
        return {
            "PINRED_CACHE_DIR": str(own if graphs else self._cache),
            "NUMBA_CACHE_DIR": str(own if steppers else self._cache),
        }

    def _write(self, target: Path, text: str) -> None:
        """Write a module with a time of its own, by which compiled ones are told from others."""
        target.write_text(text)
        self._writes += 1
        os.utime(target, (self._writes, self._writes))

    def _forked(
        self, tests: list[str], plugins: list[object], places: dict[str, str], seconds: float
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
                os.environ.update(places | {"PYTHONPATH": str(self.root)})
                numba.config.reload_config()  # type: ignore[no-untyped-call]
                sys.path.insert(0, str(self.root))
                slow = [] if self._slow else ["-m", "not slow"]
                options = ["-q", "-x", *slow, "-p", "no:cacheprovider"]
                code = int(pytest.main([*options, *tests], plugins=plugins))
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


def main(arguments: list[str]) -> int:
    """Run the mutants of modules; return how many survived, at most 1."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("modules", nargs="+", help="such as verification/compare.py")
    parser.add_argument("--table", type=Path)
    parser.add_argument("--sample", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tests", nargs="+", default=[])
    parser.add_argument("--seconds", type=float, default=180.0)
    parser.add_argument("--only", nargs="+", type=int)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--slow", action="store_true")
    options = parser.parse_args(arguments)
    rows: list[list[object]] = []
    sums = []
    with tempfile.TemporaryDirectory() as place:
        copied = Copy(options.keep or Path(place), slow=options.slow)
        for module in options.modules:
            text = (copied.root / "pinred" / module).read_text()
            tests = options.tests or tests_of(module)
            alike = [m for m in options.modules if options.tests or tests_of(m) == tests]
            covering = copied.covering(tests, alike)
            every, alive = list(mutants(text)), 0
            if options.sample is not None:  # a larger sample holds a smaller one
                Random(options.seed).shuffle(every)
            chosen = every[: options.sample]
            if options.only is not None:
                chosen = [mutant for mutant in chosen if mutant.line in options.only]
            for mutant in chosen:
                began = time.monotonic()
                found = copied.outcome(module, mutant, covering, options.seconds)
                took = round(time.monotonic() - began, 1)
                rows.append([module, mutant.line, mutant.what, found, took])
                if not found.startswith("killed"):
                    alive += 1
                    print(f"{module}:{mutant.line}: {mutant.what}: {found}", flush=True)
                if options.table is not None:
                    with options.table.open("w", newline="") as file:
                        head = ["module", "line", "change", "outcome", "seconds"]
                        csv.writer(file).writerows([head, *rows])
            killed = len(chosen) - alive
            sums.append(f"{module:<40} {len(chosen):4d} of {len(every):4d}: {killed:4d} killed")
            print(sums[-1], flush=True)
    print("\n".join(sums))
    return int(any(not str(row[3]).startswith("killed") for row in rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
