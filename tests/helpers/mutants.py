"""Mutants of modules, and the tests that kill them: `python tests/helpers/mutants.py MODULE …`.

Each mutant is one small change of one module, in a copy of the package: comparisons turned round,
constants ten times as large or small, + for −, * for /, `and` for `or`, a statement or a returned
value left out, an expression set to zero, a condition denied.  The tests of the module run until
one fails (killed) or all pass (survived: the tests do not see it, or there is nothing to see).
Options: --table FILE.csv, --sample N (so many of each module, at random by --seed),
--seconds of a mutant's tests, --tests (these instead of all of the module's).  Tests marked slow
are left out.

Compiled kernels and integrators are kept in a cache of the run's own; where a mutant may be part
of what was compiled, in one of its own.
"""

from __future__ import annotations

import argparse
import ast
import copy
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
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random

import numba
import pytest

ROOT = Path(__file__).parents[2]
# The tests that most likely kill a mutant, first those that mirror the module.
TESTS: dict[str, list[str]] = {
    "verification/full_state": [
        "verification/test_audit.py", "verification/test_compare.py",
        "verification/test_bounds_of_compare.py", "verification/test_ties.py",
    ],
    "verification/defect": ["verification/test_defects.py"],
    "verification/distances": ["verification/test_distances.py"],
    "verification/equations": [
        "verification/test_equations_of_motion.py", "verification/test_ties.py",
    ],
    "verification/ties": ["verification/test_ties.py", "verification/test_equations_of_motion.py"],
    "verification/report": [
        "verification/test_bounds_of_compare.py", "views/test_notebook_cards.py",
    ],
    "verification": [
        "verification/test_bounds_of_ends.py", "verification/test_bounds_of_compare.py",
        "verification/test_audit.py", "verification/test_compare.py",
    ],
    "kernels/judge": [
        "kernels/test_judged_state.py", "kernels/test_judged_velocities.py",
        "kernels/test_judge.py", "forces/test_refused_forces.py",
    ],
    "reduction/potential": ["reduction/test_gravity.py", "reduction/test_small_asymmetries.py",
                            "reduction/test_closed_forms.py", "system/test_refusals.py"],
    "reduction": ["reduction"],
    "lie": ["lie"],
    "forces": ["forces"],
    "integrators": ["integrators"],
    "simulation/balances": ["simulation/test_balances.py", "verification/test_audit.py"],
    "simulation/accelerations": [
        "verification/test_bounds_of_compare.py", "verification/test_small_faults.py",
    ],
}  # fmt: skip
_FLIPPED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
_SWAPPED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
}  # fmt: skip
_CHANGED = (
    ast.Compare, ast.BoolOp, ast.BinOp, ast.Constant, ast.AugAssign, ast.Expr, ast.If, ast.Return,
)  # fmt: skip
_TYPED = (ast.AnnAssign, ast.arg, ast.FunctionDef)


@dataclass(frozen=True)
class Mutant:
    """A change.  line: of the module.  what: before and after.  index, number: which node, how."""

    source: str
    line: int
    what: str
    index: int
    number: int

    @property
    def text(self) -> str:
        """Return the source of the module with the change."""
        tree = ast.parse(self.source)
        twin = next(node for k, node in enumerate(ast.walk(tree)) if k == self.index)
        _change(tree, twin, self.number)
        return ast.unparse(ast.fix_missing_locations(tree))


def mutants(source: str) -> Iterator[Mutant]:
    """Yield every mutant of a module."""
    tree = ast.parse(source)
    skipped = {id(node) for node in _unseen(tree)}
    for index, node in enumerate(ast.walk(tree)):
        if id(node) in skipped or not isinstance(node, _CHANGED):
            continue
        for number in range(3):
            twin = copy.deepcopy(node)
            alone = ast.Module([twin], [])  # type: ignore[list-item]
            before = ast.unparse(twin)
            after = _change(alone, twin, number)
            if after is None:
                break
            line = getattr(node, "lineno", 0)
            yield Mutant(source, line, f"{_short(before)}  ->  {after}", index, number)


def _unseen(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes that nothing runs: docstrings, annotations, imports, messages."""
    for node in ast.walk(tree):
        parts: list[ast.AST] = []
        if isinstance(node, (ast.Import, ast.ImportFrom, ast.Raise, ast.JoinedStr)):
            parts.append(node)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            parts.append(node)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            parts.append(node)
        if isinstance(node, (ast.AnnAssign, ast.arg)) and node.annotation is not None:
            parts.append(node.annotation)
        if isinstance(node, ast.FunctionDef):
            parts += [*node.decorator_list, *([node.returns] if node.returns else [])]
        for part in parts:
            yield from ast.walk(part)


def _change(tree: ast.AST, node: ast.AST, number: int) -> str | None:
    """Make change `number` of a node in its tree and return it in words; None if there is none."""
    if isinstance(node, ast.Compare) and number == 0:
        node.ops[0] = _FLIPPED[type(node.ops[0])]()
        return _short(ast.unparse(node))
    if isinstance(node, ast.BoolOp) and number == 0:
        node.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        return _short(ast.unparse(node))
    if isinstance(node, ast.BinOp) and type(node.op) in _SWAPPED and number < 2:
        if number == 0:
            node.op = _SWAPPED[type(node.op)]()
            return _short(ast.unparse(node))
        return _replaced(tree, node, ast.BinOp(ast.Constant(0.0), ast.Mult(), node))
    if isinstance(node, ast.Constant) and type(node.value) is float and number < 2:
        node.value = (node.value or 1.0) * (10.0, 0.1)[number]
        return repr(node.value)
    if isinstance(node, (ast.Assign, ast.AugAssign, ast.Expr)) and number == 0:
        if isinstance(node, ast.Assign):  # what is not set at all is found at once
            return None
        return _replaced(tree, node, ast.Pass())
    if isinstance(node, ast.If) and number == 0:
        node.test = ast.UnaryOp(ast.Not(), node.test)
        return f"if {_short(ast.unparse(node.test))}"
    if isinstance(node, ast.Return) and node.value is not None and number == 0:
        node.value = None
        return "return"
    return None


def _replaced(tree: ast.AST, node: ast.AST, other: ast.AST) -> str:
    """Put another node in a node's place."""
    words = _short(ast.unparse(ast.fix_missing_locations(copy.deepcopy(other))))
    for parent in ast.walk(tree):
        for name, value in ast.iter_fields(parent):
            if value is node:
                setattr(parent, name, other)
                return words
            if isinstance(value, list) and any(each is node for each in value):
                value[[each is node for each in value].index(True)] = other
                return words
    raise AssertionError(words)


def _short(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) < 60 else f"{line[:56]} …"


def tests_of(module: str) -> list[str]:
    """Return the tests that most likely kill a mutant of a module of the package."""
    mirrored = [module.rsplit("/", 1)[0] + "/test_" + module.rsplit("/", 1)[1]]
    known = [tests for start, tests in TESTS.items() if module.startswith(start)]
    tests = [*(known[0] if known else [module.split("/", maxsplit=1)[0]]), *mirrored]
    return [f"tests/{name}" for name in dict.fromkeys(tests) if (ROOT / "tests" / name).exists()]


class Copy:
    """A copy of the project in which modules are changed and tests run, one run after the other.

    What pinred stands on is imported once, in this process; each run is a fork of it that takes
    pinred from the copy.  Tests that have killed before come first.
    """

    def __init__(self, place: Path) -> None:
        """Copy the project to a folder."""
        self.root, self._cache = place / "project", place / "cache"
        self._said, self._writes = place / "said", 0
        self._killers: defaultdict[str, Counter[str]] = defaultdict(Counter)
        ignored = shutil.ignore_patterns("__pycache__")
        self.root.mkdir()
        for name in ("pinred", "tests", "robots", "docs", "examples", "pyproject.toml"):
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, self.root / name, ignore=ignored)
            else:
                shutil.copy(ROOT / name, self.root / name)
        for name in ("casadi", "mujoco", "pinocchio", "scipy.integrate"):
            importlib.import_module(name)

    def outcome(self, module: str, text: str, tests: list[str], seconds: float) -> str:
        """Return what the tests say of a module with that text."""
        own = (self.root / "pinred" / module).read_text()
        self._write(module, text)
        killers = [name for name, _ in self._killers[module].most_common(3)]
        with tempfile.TemporaryDirectory() as own_cache:
            kernels = module.startswith(("integrators", "kernels", "lie", "reduction", "forces"))
            places = {
                "PINRED_CACHE_DIR": own_cache if kernels else str(self._cache),
                "NUMBA_CACHE_DIR": own_cache if module.startswith("integrators")
                else str(self._cache),
            }  # fmt: skip
            code = self._forked([*killers, *tests], places, seconds)
        self._write(module, own)
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

    def _write(self, module: str, text: str) -> None:
        """Write a module with a time of its own, by which compiled ones are told from others."""
        target = self.root / "pinred" / module
        target.write_text(text)
        self._writes += 1
        os.utime(target, (self._writes, self._writes))

    def _forked(self, tests: list[str], places: dict[str, str], seconds: float) -> int | None:
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
                options = ["-q", "-x", "-m", "not slow", "-p", "no:cacheprovider"]
                code = int(pytest.main([*options, *tests]))
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
            time.sleep(0.05)
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
    options = parser.parse_args(arguments)
    rows: list[list[object]] = []
    sums, sound = [], set[tuple[str, ...]]()
    with tempfile.TemporaryDirectory() as place:
        copied = Copy(Path(place))
        for module in options.modules:
            text = (copied.root / "pinred" / module).read_text()
            tests = options.tests or tests_of(module)
            if tuple(tests) not in sound:
                plain = copied.outcome(module, text, tests, 10.0 * options.seconds)
                if plain != "survived":
                    print(f"{module}: the tests fail without a mutant: {plain}")
                    return 2
                sound.add(tuple(tests))
            every, survived = list(mutants(text)), 0
            if options.sample is not None:  # a larger sample holds a smaller one
                Random(options.seed).shuffle(every)
            chosen = every[: options.sample]
            for mutant in chosen:
                found = copied.outcome(module, mutant.text, tests, options.seconds)
                rows.append([module, mutant.line, mutant.what, found])
                if found == "survived":
                    survived += 1
                    print(f"{module}:{mutant.line}: {mutant.what}", flush=True)
                if options.table is not None:
                    with options.table.open("w", newline="") as file:
                        head = ["module", "line", "change", "outcome"]
                        csv.writer(file).writerows([head, *rows])
            killed = len(chosen) - survived
            sums.append(f"{module:<40} {len(chosen):4d} of {len(every):4d}: {killed:4d} killed")
            print(sums[-1], flush=True)
    print("\n".join(sums))
    return int(any(row[-1] == "survived" for row in rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
