"""A new explicit method is one file: the example in docs/integrators.md, added to methods/."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from shutil import copytree, ignore_patterns
from typing import Any

import numpy as np
import pytest
from orders import fit_order

import pinred
from pinred import AdaptiveGauss
from pinred.integrators.methods import METHODS, options_of

ROOT = Path(__file__).parents[2]
DOCUMENT = (ROOT / "docs/integrators.md").read_text(encoding="utf-8")
TIMES = [0.0, 0.35, 0.5]
PROGRAM = """
import json
import numpy as np
import pinred
from pinred.cli.command_line import main
from pinred.integrators.methods import METHODS, options_of
from pinred.laboratory.bench import SOLVERS

cat, BS3 = pinred.load("falling_cat"), METHODS["BS3"]
errors = []
for count in (100, 140, 200, 280):
    method = BS3(rtol=1e3, atol=1e3, max_step=0.5 / count)
    traj = pinred.simulate(cat, seed=3, times={times}, method=method)
    assert abs(traj.run.steps - count) <= 1
    errors.append(np.abs(traj.x - {exact}).max(axis=1).tolist())
assert main(["run", "scene.toml"]) == 0
command = ["simulate", "falling_cat", "--duration", "0.2", "--method", "BS3", "--out", "out.csv"]
assert main([*command, "--rtol", "1e-5"]) == 0
solver = next(solver for solver in SOLVERS if solver.name == "pinred-bs3")
schema = pinred.scene_schema()["properties"]["run"]["properties"]["method"]
names = [one["properties"]["name"]["enum"][0] for one in schema["anyOf"][1]["oneOf"]]
print(json.dumps([errors, solver.about, names]))
"""
SCENE = """
robot = "falling_cat"
run = { duration = 0.2, method = { name = "BS3", rtol = 1e-5 } }
"""


@pytest.mark.by_hand
def test_new_explicit_method_needs_one_file(tmp_path: Path) -> None:
    """It has its order on a robot; command line, scene files, schema and benchmark know it."""
    code = re.findall(r"```python\n(.*?)```", DOCUMENT, re.DOTALL)[-1]
    copytree(ROOT / "pinred", tmp_path / "pinred", ignore=ignore_patterns("__pycache__"))
    (tmp_path / "robots").symlink_to(ROOT / "robots")
    (tmp_path / "pinred/integrators/methods/bs3.py").write_text(code, encoding="utf-8")
    (tmp_path / "scene.toml").write_text(SCENE, encoding="utf-8")
    tight = AdaptiveGauss(1e-13, 1e-15)
    truth = pinred.simulate(pinred.load("falling_cat"), seed=3, times=TIMES, method=tight)
    program = PROGRAM.format(times=TIMES, exact=f"np.array({truth.x.tolist()})")
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "of BS3 (compiled)" in done.stdout
    assert (tmp_path / "out.csv").is_file()
    output: list[Any] = json.loads(done.stdout.splitlines()[-1])
    errors, about, names = output
    for k in (1, 2):  # within a step, perhaps, and at the end of one
        order = fit_order([row[k] for row in errors], [1 / 100, 1 / 140, 1 / 200, 1 / 280])
        assert order == pytest.approx(3.0, abs=0.2)
    assert np.array(errors)[:, 0].max() < 1e-15
    assert about == "simulate() with BS3, whole call"
    assert names == ["auto", *sorted([*METHODS, "BS3"])]


def test_document_table_matches_method_attributes() -> None:
    """Each row states the defaults, order, steps and symplecticity of a method."""
    table_rows = re.findall(r"^\| `(\w+)\((.*?)\)` \|(.*)\|$", DOCUMENT, re.MULTILINE)
    assert sorted(name for name, *_ in table_rows) == list(METHODS)
    for name, written, cells in table_rows:
        method_type: Any = METHODS[name]
        options = {option.name: option for option in options_of(method_type)}
        for one in written.split(", "):
            option, _, default = one.partition("=")
            assert options[option].default == (float(default) if default else None)
        arguments: tuple[Any, ...] = () if method_type.adaptive else (0.1,)
        method = method_type(*arguments, order=16) if name == "Gauss" else method_type(*arguments)
        order, steps, between, symplectic, _ = (cell.strip() for cell in cells.split("|"))
        assert str(method.order) in order.split(", ")
        assert steps == ("adaptive" if method.adaptive else "fixed")
        assert name == "Gauss" or f"order {method.dense_order}" in between
        assert symplectic == ("yes" if method.symplectic else "no")
