"""A cat rolls in the air by three torques, computed by a shooting solver over steps of pinred.

`flow.step(h)` is one step of the flow as a map with its Jacobians; Crocoddyl's FDDP uses these
maps as action models (extra crocoddyl). The goal concerns shape and attitude only;
momentum stays zero because pinred conserves it.
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

H, NODES, ROLL = 0.02, 40, 0.6  # step [s], number of steps, roll about the base's x axis [rad]

cat = pinred.load("falling_cat", gravity=(0.0, 0.0, 0.0))
names = [f"torque at {joint}" for joint in cat.shape_names]
torques = [pinred.Parameter(name, 0.0) for name in names]
actuation = Torque(lambda *_: dict(zip(cat.shape_names, torques, strict=True)))
initial: dict[str, Any] = {"x0": [0.0] * 3, "xi0": [0.0] * 6, "duration": 1.0}
step = pinred.flow(cat, forces=[actuation], wrt=names, method="DOP853", **initial).step(H)

n, r, m = cat.n, cat.r, cat.m
# Crocoddyl orders tangents as (pose, x, ξ, ẋ).
ORDER = [k for part in ("pose", "x", "xi", "xdot") for k in range(2 * n)[step.outputs[part]]]


class Step(crocoddyl.ActionModelAbstract):  # type: ignore[misc]
    """A step with the cost ½ |weights · (state ⊖ goal)|² + ½ effort |u|²."""

    def __init__(self, goal: Any, weights: Any, effort: float) -> None:
        """Set the goal (q, v), the weights of the tangent to it, and the weight of the torques."""
        super().__init__(crocoddyl.StateMultibody(cat.model), m, 2 * n)
        self.goal, self.weights, self.effort = goal, np.asarray(weights), effort

    def _at(self, state: Any) -> SimpleNamespace:
        configuration = cat.configuration(state[: cat.model.nq])
        motion = cat.velocity(state[cat.model.nq :])
        return SimpleNamespace(
            pose=configuration.pose, x=configuration.x, xi=motion.xi, xdot=motion.xdot
        )

    def calc(self, data: Any, state: Any, u: Any = None) -> None:
        """Compute the next state and the cost."""
        u = np.zeros(m) if u is None or not self.effort else u
        if self.effort:
            try:
                end = step(self._at(state), **dict(zip(names, u.tolist(), strict=True)))
                data.xnext = np.concatenate([end.q, end.v])
            except pinred.IntegrationError:  # the trial step is too large; the solver reduces it
                data.xnext = np.full(len(start), np.nan)
        data.r = self.weights * self.state.diff(self.goal, state)
        data.cost = 0.5 * float(data.r @ data.r) + 0.5 * self.effort * float(u @ u)

    def calcDiff(self, data: Any, state: Any, u: Any = None) -> None:
        """Compute the derivatives of the next state and the cost."""
        J = np.diag(self.weights) @ self.state.Jdiff(self.goal, state)[1]
        data.Lx, data.Lxx = J.T @ data.r, J.T @ J
        if self.effort:
            assert u is not None
            linear = step.linear(self._at(state), **dict(zip(names, u.tolist(), strict=True)))
            data.Fx, data.Fu = linear.by_state[np.ix_(ORDER, ORDER)], linear.by_parameters[ORDER]
            data.Lu, data.Luu = self.effort * u, self.effort * np.eye(m)


start = np.concatenate([cat.q(cat.group.identity(), np.zeros(m)), np.zeros(n)])
goal_pose = cat.group.exp(np.array([0.0, 0.0, 0.0, ROLL, 0.0, 0.0]))
goal = np.concatenate([cat.q(goal_pose, np.zeros(m)), np.zeros(n)])
attitude_and_shape = [0.0] * 3 + [1.0] * (3 + m) + [0.0] * r + [0.3] * m
running = Step(goal, 0.03 * np.array(attitude_and_shape), 1e-3)
terminal = Step(goal, 30.0 * np.array(attitude_and_shape), 0.0)
problem = crocoddyl.ShootingProblem(start, [running] * NODES, terminal)
solver = crocoddyl.SolverFDDP(problem)
rng = np.random.default_rng(0)
guess = [0.05 * rng.normal(size=m) for _ in range(NODES)]
solver.solve(problem.rollout(guess), guess, 150, False)

q, v = np.split(solver.xs[-1], [cat.model.nq])
error = cat.group.log(cat.group.compose(cat.group.inverse(goal_pose), cat.configuration(q).pose))
shape = cat.configuration(q).x
print(f"{solver.iter} iterations, cost {solver.cost:.4f}")
print(f"attitude missed by {np.linalg.norm(error[3:]):.1e} rad, shape by {np.abs(shape).max():.1e}")
momentum = pin.computeCentroidalMomentum(cat.model, cat.model.createData(), q, v)
print(f"momentum at the end, by Pinocchio: {np.abs(momentum.vector).max():.1e}")
if not (np.linalg.norm(error[3:]) < 0.02 and np.abs(shape).max() < 0.02):
    sys.exit("the cat did not reach the attitude")
