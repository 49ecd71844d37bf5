"""A cat rolls in the air by three torques, found by a shooting solver over pinred's steps.

`flow.step(h)` is one step of the flow as a map with its Jacobians; Crocoddyl's FDDP takes these
maps as action models (pip install "pinred[crocoddyl]").  Nothing but the shape and the attitude is
asked for: momentum stays zero by itself.
"""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import crocoddyl
import numpy as np
import pinocchio as pin

import pinred
from pinred.forces import Torque

H, NODES, ROLL = 0.02, 40, 0.6  # s, and rad about the base's x axis

cat = pinred.load("falling_cat", gravity=(0.0, 0.0, 0.0))
names = [f"torque at {joint}" for joint in cat.shape_names]
torques = [pinred.Parameter(name, 0.0) for name in names]
act = Torque(lambda *_: dict(zip(cat.shape_names, torques, strict=True)))
rest: dict[str, Any] = {"x0": [0.0] * 3, "xi0": [0.0] * 6, "duration": 1.0}
step = pinred.flow(cat, forces=[act], wrt=names, method="DOP853", **rest).step(H)

n, r, m = cat.n, cat.r, cat.m
# Crocoddyl's tangents are (pose, x, ξ, ẋ), those of a step (pose, x, ẋ, ξ).
ORDER = [*range(n), *range(n + m, 2 * n), *range(n, n + m)]


class Step(crocoddyl.ActionModelAbstract):  # type: ignore[misc]
    """A step with a cost, ½ |weights · (state ⊖ goal)|² + ½ w |u|²."""

    def __init__(self, goal: Any, weights: Any, effort: float) -> None:
        """Take the goal (q, v), weights of the tangent to it, and the weight of torques."""
        super().__init__(crocoddyl.StateMultibody(cat.model), m, 2 * n)
        self.goal, self.weights, self.effort = goal, np.asarray(weights), effort

    def _at(self, state: Any) -> SimpleNamespace:
        place = cat.configuration(state[: cat.model.nq])
        motion = cat.velocity(state[cat.model.nq :])
        return SimpleNamespace(pose=place.pose, x=place.x, xi=motion.xi, xdot=motion.xdot)

    def calc(self, data: Any, state: Any, u: Any = None) -> None:
        """Fill in the next state and the cost."""
        u = np.zeros(m) if u is None or not self.effort else u
        if self.effort:
            try:
                end = step(self._at(state), **dict(zip(names, u.tolist(), strict=True)))
                data.xnext = np.concatenate([end.q, end.v])
            except pinred.IntegrationError:  # a trial that goes too far; the solver shortens it
                data.xnext = np.full(len(start), np.nan)
        data.r = self.weights * self.state.diff(self.goal, state)
        data.cost = 0.5 * float(data.r @ data.r) + 0.5 * self.effort * float(u @ u)

    def calcDiff(self, data: Any, state: Any, u: Any = None) -> None:
        """Fill in the derivatives of both."""
        J = np.diag(self.weights) @ self.state.Jdiff(self.goal, state)[1]
        data.Lx, data.Lxx = J.T @ data.r, J.T @ J
        if self.effort:
            assert u is not None
            found = step.linear(self._at(state), **dict(zip(names, u.tolist(), strict=True)))
            data.Fx, data.Fu = found.by_state[np.ix_(ORDER, ORDER)], found.by_parameters[ORDER]
            data.Lu, data.Luu = self.effort * u, self.effort * np.eye(m)


start = np.concatenate([cat.q(cat.group.identity(), np.zeros(m)), np.zeros(n)])
turned = cat.group.exp(np.array([0.0, 0.0, 0.0, ROLL, 0.0, 0.0]))
goal = np.concatenate([cat.q(turned, np.zeros(m)), np.zeros(n)])
attitude_and_shape = [0.0] * 3 + [1.0] * (3 + m) + [0.0] * r + [0.3] * m
running = Step(goal, 0.03 * np.array(attitude_and_shape), 1e-3)
last = Step(goal, 30.0 * np.array(attitude_and_shape), 0.0)
problem = crocoddyl.ShootingProblem(start, [running] * NODES, last)
solver = crocoddyl.SolverFDDP(problem)
rng = np.random.default_rng(0)
guess = [0.05 * rng.normal(size=m) for _ in range(NODES)]
solver.solve(problem.rollout(guess), guess, 150, False)

q, v = np.split(solver.xs[-1], [cat.model.nq])
left = cat.group.log(cat.group.compose(cat.group.inverse(turned), cat.configuration(q).pose))
shape = cat.configuration(q).x
print(f"{solver.iter} iterations, cost {solver.cost:.4f}")
print(f"attitude missed by {np.linalg.norm(left[3:]):.1e} rad, shape by {np.abs(shape).max():.1e}")
momentum = pin.computeCentroidalMomentum(cat.model, cat.model.createData(), q, v)
print(f"momentum at the end, by Pinocchio: {np.abs(momentum.vector).max():.1e}")
if not (np.linalg.norm(left[3:]) < 0.02 and np.abs(shape).max() < 0.02):
    sys.exit("the cat did not come round")
