"""Sizes of the scripts of `feel` pages and times of A(x): `python tests/helpers/feel_cost.py`."""

from __future__ import annotations

import json
import subprocess

import pinred
from pinred.system.system import System
from pinred.views.feel.feel_page import feel_graphs, felt_robot, loop_numbers, to_javascript
from pinred.views.playback.page import resource

ROBOTS = (
    "elroys_beanie", "three_rods", "falling_cat", "falling_cat_ball", "satellite_two_arms",
    "solo12", "four_bar", "gripper", "parallel_biped",
)  # fmt: skip
# The minimum of nine rounds; shapes change from call to call, as on the page.
TIMING = """
const head = %(head)s, rest = %(rest)s, size = %(size)d;
const motion = lifter(size, twist, head ? closedShapes(head, size, loops) : openShapes());
const rate = rest.map((_, k) => 0.3 - 0.1 * k);
function calls(count) {
  for (let n = 0; n < count; n++)
    motion.velocity(rest.map((v, k) => v + 0.05 * Math.sin(0.07 * n + k)), rate);
}
calls(5000);
let best = Infinity;
for (let round = 0; round < 9; round++) {
  const start = process.hrtime.bigint();
  calls(1000);
  best = Math.min(best, Number(process.hrtime.bigint() - start) / 1e6);
}
console.log(best);
"""


def scripts_of(system: System) -> str:
    """Return the functions of a robot as JavaScript."""
    graphs = feel_graphs(felt_robot(system).connection, system)
    return "".join(to_javascript(name, function) for name, function in vars(graphs).items())


def microseconds(system: System, scripts: str) -> float:
    """Measure one A(x) ẋ in node [µs]."""
    robot = felt_robot(system)
    program = TIMING % {
        "head": json.dumps(loop_numbers(robot) if system.loops else None),
        "rest": json.dumps(robot.rest[robot.independent].tolist()), "size": robot.connection.m,
    }  # fmt: skip
    files = [resource(f"../feel/{name}") for name in ("lift.js", "closed_shapes.js")]
    text = "\n".join([scripts, *files, program])
    return float(subprocess.run(["node", "-"], input=text, capture_output=True, text=True).stdout)


def main() -> None:
    """Print a row for each robot."""
    for name in ROBOTS:
        system = pinred.load(name)
        scripts = scripts_of(system)
        print(f"{name:<20} {len(scripts) / 1e3:6.1f} kB {microseconds(system, scripts):8.2f} µs")


if __name__ == "__main__":
    main()
