"""Compare random stiff trees and planted faults: `python tests/helpers/stiff_study.py 300 [first]`.

A verdict FAILED on a tree is contradicted if SciPy's Radau over ABA agrees with the motion, and
PASSED if it does not. Every planted fault exceeds the tolerance of its run and leaves the model
valid, so every verdict on one must be FAILED. A short form is part of the suite
(tests/judge/test_stiff_trees.py).
"""

from __future__ import annotations

import sys
import time
import warnings
from collections import Counter
from dataclasses import replace
from typing import Any, cast

import numpy as np
from scipy.integrate import solve_ivp
from stiff_trees import stiff_tree
from tampering import tampered

import pinred
from pinred.common.arrays import Array
from pinred.forces import PD, Damper, Force, Spring
from pinred.judge.reference_solution import FullState

AGREES = 1e-6  # largest difference from SciPy's Radau of a correct motion [rad | m]
_RTOL, _ATOL = 1e-8, 1e-10  # tolerances of SciPy's Radau, which round-off of stiff forces permits
_MOST = 100_000  # evaluations after which SciPy's Radau is given up


def scipy_difference(traj: pinred.Trajectory) -> float:
    """Return the largest difference of the final configuration from SciPy's Radau over ABA.

    The result is NaN if SciPy's Radau does not reach the end.
    """
    scene, start = traj.scene, traj.scene.start
    full = FullState(scene)
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    moves, evaluations = 1e-7 * np.maximum(1.0, np.abs(y0)), 0

    def rate(t: float, y: Array) -> Array:
        nonlocal evaluations
        evaluations += 1
        if evaluations > _MOST:
            raise TimeoutError
        return full.rate(t, y)

    def jacobian(t: float, y: Array) -> Array:
        f = rate(t, y)
        return np.array([rate(t, y + move) - f for move in np.diag(moves)]).T / moves

    try:
        solution = solve_ivp(
            rate, (0.0, scene.end), y0, method="Radau", rtol=_RTOL, atol=_ATOL, jac=jacobian
        )
    except TimeoutError:
        return float("nan")
    if not solution.success:
        return float("nan")
    state = traj(np.array([scene.end]))
    y = full.state(state.pose, state.x, state.xi, state.xdot)[0]
    coordinates = len(y) - scene.system.model.nv
    return float(np.abs(y - solution.y[:, -1])[:coordinates].max())


def planted_fault(traj: pinred.Trajectory, seed: int) -> tuple[str, pinred.Trajectory]:
    """Return the kind of a fault and a trajectory that does not belong to its scene.

    Args:
        traj: A correct trajectory of a stiff tree.
        seed: Seed of the fault.
    """
    rng = np.random.default_rng([8, seed])
    kind = ("force", "mass", "lever", "start", "offset", "jump", "tolerance")[seed % 7]
    size = 10.0 ** rng.uniform(-6.0, -3.0)
    scene = traj.scene
    if kind == "tolerance":
        if loose := _integrated_loosely(traj, rng):
            return kind, loose
        kind = "offset"
    if kind in ("offset", "jump"):
        return kind, _with_wrong_states(traj, kind, size, rng)
    start: dict[str, Any] = {"x0": scene.start.x, "xdot0": scene.start.xdot, "xi0": scene.start.xi}
    if kind == "force":
        forces = cast(tuple[Force, ...], scene.forces)
        scene = replace(scene, forces=[_changed(force, 1.0 + size) for force in forces])
    elif kind == "start":
        moved = start["x0"].copy()
        moved[rng.integers(len(moved))] += size
        scene = replace(scene, **{**start, "x0": moved})
    else:
        model = scene.system.model.copy()
        tip = model.njoints - 1
        if kind == "mass" or not _turns(scene.system, tip):
            model.inertias[tip].mass *= 1.0 + size
        else:
            model.inertias[tip].lever = model.inertias[tip].lever * (1.0 + size)
        scene = replace(scene, system=pinred.load(model), **start)
    return kind, pinred.Trajectory(scene, traj.motion, traj.run)


def _turns(system: pinred.System, joint: int) -> bool:
    """Return whether the lever of the link matters: some joint up to the root turns it."""
    model = system.model
    kinds = [model.joints[k].shortname() for k in model.supports[joint] if k > 0]
    return any(
        not kind.startswith(("JointModelPX", "JointModelPY", "JointModelPZ", "JointModelPri"))
        for kind in kinds
    )


def _changed(force: Any, factor: float) -> Any:
    """Return the force with a wrong stiffness or damping."""
    if isinstance(force, Damper):
        return Damper(force.joint, factor * force.coefficient)
    if isinstance(force, Spring):
        return Spring(force.joint, factor * force.stiffness, force.rest)
    gains = {name: factor * value for name, value in force.kd.items()}
    return PD(force.reference, force.kp, gains, name=force.name)


def _with_wrong_states(
    traj: pinred.Trajectory, kind: str, size: float, rng: np.random.Generator
) -> pinred.Trajectory:
    """Return the trajectory with an offset of a coordinate or a rate from a step end on.

    Args:
        traj: A correct trajectory.
        kind: "offset" of a coordinate, or "jump" of a rate.
        size: Offset relative to the largest value of any joint, or to 1, like tolerances.
        rng: Generator that selects the joint.
    """
    name = "x" if kind == "offset" else "xdot"
    column = int(rng.integers(traj.system.m))
    knots = traj.motion.knots
    when = knots[len(knots) // 2]
    size *= max(1.0, float(np.abs(getattr(traj(knots), name)).max()))

    def change(state: pinred.State) -> pinred.State:
        values = getattr(state, name).copy()
        values[state.t >= when, column] += size
        return replace(state, **{name: values})

    return tampered(traj, change)


def _integrated_loosely(
    traj: pinred.Trajectory, rng: np.random.Generator
) -> pinred.Trajectory | None:
    """Return a trajectory with errors above a thousand of the tolerances that its scene claims.

    The result is None if the motion is right with any tolerance.
    """
    scene = traj.scene
    claimed = scene.rtol + scene.atol
    y = np.hstack([traj.x[-1], traj.xi[-1]])
    for rtol in 10.0 ** np.arange(-5.0, 0.0) * rng.uniform(0.5, 1.0):
        loose = pinred.simulate(scene, method=f"Radau(rtol={rtol:.3g}, atol={rtol:.3g})")
        if np.abs(np.hstack([loose.x[-1], loose.xi[-1]]) - y).max() > 1e3 * claimed:
            return pinred.Trajectory(scene, loose.motion, loose.run)
    return None


def study(seed: int) -> tuple[str, str, pinred.Report, str, pinred.Report]:
    """Return the tree, its verdict with contradiction, its report, and those of a planted fault."""
    tree = stiff_tree(seed)
    traj = pinred.simulate(tree.scene)
    report = pinred.compare(traj)
    outcome = str(report.verdict)
    if outcome != "CANNOT TELL":
        difference = scipy_difference(traj)
        agrees = (difference < AGREES) == (outcome == "PASSED")
        word = "not followed" if np.isnan(difference) else "confirmed" if agrees else "contradicted"
        outcome += f", {word} by SciPy ({difference:.1e})"
    kind, wrong = planted_fault(traj, seed)
    return tree.about, outcome, report, kind, pinred.compare(wrong)


def main(arguments: list[str]) -> int:
    """Run the study; print its table, and each unexpected verdict."""
    count, first = int(arguments[0]), int(arguments[1]) if len(arguments) > 1 else 0
    warnings.simplefilter("ignore")
    trees: Counter[str] = Counter()
    faults: Counter[str] = Counter()
    for seed in range(first, first + count):
        start = time.process_time()
        try:
            about, outcome, report, kind, fault = study(seed)
        except pinred.PinredError as error:
            trees[type(error).__name__] += 1
            print(f"{seed}: {error}", flush=True)
            continue
        trees[outcome.split(" (")[0]] += 1
        faults[f"{kind}: {fault.verdict}"] += 1
        seconds = time.process_time() - start
        print(f"{about}: {outcome}; {kind}: {fault.verdict}; {seconds:.1f} s", flush=True)
        if "PASSED" not in outcome or "contradicted" in outcome:
            print(report, flush=True)
        if fault.verdict != "FAILED":
            print(f"fault not found: {fault}", flush=True)
    for table in (trees, faults):
        print("\n".join(f"{name}: {number}" for name, number in sorted(table.items())))
    wrong = [name for name in trees if "contradicted" in name]
    return 1 if wrong or any(not name.endswith("FAILED") for name in faults) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
