"""CasADi functions as JavaScript: the same bits as CasADi, in short scripts."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from feel_cost import scripts_of

import pinred
from pinred.common.arrays import Array
from pinred.views.feel.feel_page import to_javascript
from pinred.views.playback.colours_and_view_options import LOOK

NODE = shutil.which("node")
needs_node = pytest.mark.skipif(NODE is None, reason="node is not installed")


def run_script(script: str, y: Array, size: int) -> Array:
    """Return the outputs of the function `f` of a script."""
    assert NODE is not None
    call = f"const out = new Float64Array({size}); f({json.dumps(y.tolist())}, out);"
    text = f"{script}\n{call}\nconsole.log(JSON.stringify(Array.from(out)));"
    done = subprocess.run([NODE, "-"], input=text, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return np.array(json.loads(done.stdout))


def random_function(rng: np.random.Generator, count: int) -> ca.Function:
    """Return a function of arithmetic with constants of both signs and shared subexpressions."""
    y = ca.SX.sym("y", 4)
    values = [*ca.vertsplit(y), ca.SX(-0.5), ca.SX(2.0), ca.SX(-1.2345678901234567)]
    for _ in range(count):
        a, b = (values[int(k)] for k in rng.integers(max(0, len(values) - 25), len(values), 2))
        kinds = [a + b, a - b, a * b, -a, a * a, ca.fabs(a), 2 * a, ca.if_else(a < b, a, b - a),
                 a / (1.5 + b * b), ca.sqrt(1.0 + a * a), ca.fmin(a, -b)]  # fmt: skip
        value = kinds[int(rng.integers(len(kinds)))]
        values.append(value / ca.sqrt(1.0 + value * value))
    return ca.Function("f", [y], [ca.vertcat(*values[-12:], ca.sum1(ca.vertcat(*values)))])


@pytest.mark.by_hand("4")
@needs_node
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.sampled(3)
def test_script_has_the_bits_of_casadi(seed: int) -> None:
    """Nested expressions and variables that are used again change no operation."""
    rng = np.random.default_rng(seed)
    function = random_function(rng, 10 + 60 * seed)
    y = rng.normal(size=4)
    expected = np.array(function(y)).ravel()
    np.testing.assert_array_equal(
        run_script(to_javascript("f", function), y, len(expected)), expected
    )


@needs_node
def test_square_of_a_sum_evaluates_the_sum_once() -> None:
    """An operand that a template repeats becomes a variable."""
    y = ca.SX.sym("y", 2)
    total = y[0] + y[1]
    script = to_javascript("f", ca.Function("f", [y], [total * total]))
    assert script.count("y[0]") == 1
    np.testing.assert_array_equal(run_script(script, np.array([0.1, 0.2]), 1), [(0.1 + 0.2) ** 2])


def test_operations_without_translation_are_refused() -> None:
    """The error names the operation."""
    y = ca.SX.sym("y", 1)
    function = ca.Function("f", [y], [ca.erf(y)])
    with pytest.raises(pinred.UnsupportedOperationError, match="got CasADi's operation"):
        to_javascript("f", function)


@pytest.mark.by_hand("satellite_two_arms-45")
@pytest.mark.parametrize(("name", "most"), [("falling_cat", 12), ("satellite_two_arms", 45)])
def test_scripts_stay_short(name: str, most: float) -> None:
    """Sizes in kB; one statement per operation would take twice as much."""
    assert len(scripts_of(pinred.load(name))) < 1e3 * most


def test_scripts_take_colours_from_the_look() -> None:
    """Pages and films have one table of colours and sizes; no script states a colour of its own."""
    views = Path(pinred.__file__).parent / "views"
    scripts = "".join(path.read_text("utf-8") for path in views.rglob("*.js"))
    assert re.findall(r"#[0-9a-f]{6}\b|0x[0-9a-f]{6}\b", scripts) == []
    known = set(vars(LOOK))
    assert set(re.findall(r"\blook\.(\w+)", scripts)) <= known
    sources = scripts + "".join(path.read_text("utf-8") for path in views.rglob("*.py"))
    assert {name for name in known if f"look.{name}" not in sources.lower()} == set()
