"""Mutants of modules, and the tests that kill them: `python tests/helpers/mutants.py MODULE …`.

Each mutant is one small change of one module, in a copy of the package: comparisons turned round,
constants ten times as large or small, + for −, * for /, `and` for `or`, a statement or a returned
value left out, an expression set to zero, a condition denied.  The tests of the module run until
one fails (killed) or all pass (survived: the tests do not see it, or there is nothing to see).
Options: --table FILE.csv, --every N (each N-th mutant only), --first (number of the first),
--seconds of a mutant's tests, --tests (these instead of all of the module's).

Compiled kernels and integrators are kept in a cache of the run's own; where a mutant may be part
of what was compiled, in one of its own.
"""

from __future__ import annotations

import argparse
import ast
import copy
import csv
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
# The tests that most likely kill a mutant, first those that mirror the module.
TESTS: dict[str, list[str]] = {
    "verification": [
        "verification/test_bounds_of_compare.py", "verification/test_small_faults.py",
        "verification/test_compare.py", "verification/test_ties.py",
    ],
    "kernels/judge": ["kernels/test_judge.py", "simulation/test_simulate.py"],
    "reduction/potential": ["reduction/test_gravity.py", "reduction/test_closed_forms.py",
                            "system/test_refusals.py"],
    "reduction": ["reduction"],
    "lie": ["lie"],
    "forces": ["forces"],
    "integrators": ["integrators"],
    "simulation/balances": ["simulation/test_balances.py"],
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
    """A change.  line: of the module.  what: before and after.  text: of the whole module."""

    line: int
    what: str
    text: str


def mutants(source: str) -> Iterator[Mutant]:
    """Yield every mutant of a module."""
    tree = ast.parse(source)
    skipped = {id(node) for node in _unseen(tree)}
    for index, node in enumerate(ast.walk(tree)):
        if id(node) in skipped or not isinstance(node, _CHANGED):
            continue
        for number in range(3):
            changed = copy.deepcopy(tree)
            twin = next(each for k, each in enumerate(ast.walk(changed)) if k == index)
            before = ast.unparse(twin)
            after = _change(changed, twin, number)
            if after is None:
                break
            text = ast.unparse(ast.fix_missing_locations(changed))
            yield Mutant(getattr(node, "lineno", 0), f"{_short(before)}  ->  {after}", text)


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


def outcome(copied: Path, module: str, text: str, tests: list[str], seconds: float) -> str:
    """Return what the tests say of a module with that text, in a copy of the project."""
    target = copied / "pinred" / module
    own = target.read_text()
    target.write_text(text)
    with tempfile.TemporaryDirectory() as own_cache:
        shared = str(copied.parent / "cache")
        kernels = module.startswith(("integrators", "kernels", "lie", "reduction", "forces"))
        places = {
            "PINRED_CACHE_DIR": own_cache if kernels else shared,
            "NUMBA_CACHE_DIR": own_cache if module.startswith("integrators") else shared,
        }
        command = [sys.executable, "-B", "-m", "pytest", "-q", "-x", "-m", "not slow", "-p",
                   "no:cacheprovider", *tests]  # fmt: skip
        with subprocess.Popen(
            command, cwd=copied, env=os.environ | places | {"PYTHONPATH": str(copied)},
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
        ) as job:  # fmt: skip
            try:
                said = job.communicate(timeout=seconds)[0]
            except subprocess.TimeoutExpired:
                os.killpg(job.pid, signal.SIGKILL)
                said = "\nFAILED too long"
    target.write_text(own)
    if job.returncode == 0:
        return "survived"
    failed = [line for line in said.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return f"killed by {failed[0].split()[1] if failed else 'an error'}"


def main(arguments: list[str]) -> int:
    """Run the mutants of modules; return how many survived, at most 1."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("modules", nargs="+", help="such as verification/compare.py")
    parser.add_argument("--table", type=Path)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--tests", nargs="+", default=[])
    parser.add_argument("--seconds", type=float, default=180.0)
    options = parser.parse_args(arguments)
    rows, counts = [], Counter[tuple[str, str]]()
    with tempfile.TemporaryDirectory() as place:
        copied = Path(place) / "project"
        copied.mkdir()
        for name in ("pinred", "tests", "robots", "docs", "examples", "pyproject.toml"):
            source = ROOT / name
            ignored = shutil.ignore_patterns("__pycache__")
            if source.is_dir():
                shutil.copytree(source, copied / name, ignore=ignored)
            else:
                shutil.copy(source, copied / name)
        for module in options.modules:
            text = (ROOT / "pinred" / module).read_text()
            tests = options.tests or tests_of(module)
            plain = outcome(copied, module, text, tests, options.seconds)
            if plain != "survived":
                print(f"{module}: the tests fail without a mutant: {plain}")
                return 2
            for mutant in list(mutants(text))[options.first :: options.every]:
                found = outcome(copied, module, mutant.text, tests, options.seconds)
                counts[module, found.split()[0]] += 1
                rows.append([module, mutant.line, mutant.what, found])
                if found == "survived":
                    print(f"{module}:{mutant.line}: {mutant.what}", flush=True)
                if options.table is not None:
                    with options.table.open("w", newline="") as file:
                        head = ["module", "line", "change", "outcome"]
                        csv.writer(file).writerows([head, *rows])
    for module in options.modules:
        killed, survived = (counts[module, word] for word in ("killed", "survived"))
        print(f"{module:<40} {killed:4d} killed {survived:4d} survived")
    return int(any(word == "survived" for _, word in counts))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
