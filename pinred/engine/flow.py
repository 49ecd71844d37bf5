"""The compiled flow of a scene: kernel, parameters, and the full state behind a reduced one."""

from __future__ import annotations

import numpy as np

from ..arrays import Array
from ..base import Base, angular_momentum
from ..flow import entry_name
from ..potential import shape_gravity
from ..scene import Scene
from ..start import Start
from ..state import Sample, ShapeState, State, full_state
from .evaluate import evaluate
from .kernel import Kernel, kernel_for


class CompiledFlow:
    """What the compiled integrators need of a scene.

    kernel: machine code and layout.  y0: (k,) reduced state at the start.  parameters:
    (p,) what the kernel reads besides.  numbers: those of them that are in the forces; the
    torques that controllers hold are set in it as time goes on.
    """

    def __init__(self, scene: Scene) -> None:
        """Set up the flow.  Raises SymmetryError if gravity breaks the symmetry."""
        about = angular_momentum(scene.system, scene.starts)
        self._take(CompiledFlows(scene, scene.starts, about), 0)

    @classmethod
    def of(cls, flows: CompiledFlows, member: int) -> CompiledFlow:
        """Return one of many flows."""
        flow = cls.__new__(cls)
        flow._take(flows, member)
        return flow

    def _take(self, flows: CompiledFlows, member: int) -> None:
        scene = flows.scene
        self._system, self._wanted = scene.system, scene.outputs == "all"
        self._forces, self._potential = scene.force_model, flows.potential
        self.kernel, self._base = flows.kernel, flows.base.member(member)
        layout = self.kernel.layout
        self._active, self._cyclic = list(layout.active), list(layout.cyclic)
        self._prescribed = list(layout.prescribed)
        self.y0, self.parameters = flows.y0[member], flows.parameters[member]
        spin, end = layout.base.spin, layout.parameters - layout.numbers
        self._pi_cyclic, self.numbers = self.parameters[spin:end], self.parameters[end:]

    def sample(self, t: float, y: Array, numbers: Array) -> Sample:  # noqa: ARG002
        """Return what forces see at one time."""
        system, r = self._system, self._system.r
        out = self.kernel.evaluate_outputs(y, self._with(numbers))
        x, _ = self._shape(y[None], out[None])
        b, base = self._b(y), self._base
        return Sample(x[0], out[r : system.n], out[:r], base.momentum(b), base.body_weight(b))

    def states(self, t: Array, y: Array, numbers: Array) -> State | ShapeState:
        """Return the full states at times t (T,) of reduced states y (T, k).

        numbers: (p,) those in the forces then.
        """
        system, base = self._system, self._base
        r = system.r
        kernel = self.kernel
        out = evaluate(kernel.outputs.address, self._with(numbers), y, kernel.outputs_size)
        relative, xdot, com = out[:, :r], out[:, r : system.n].copy(), out[:, system.n :][:, :3]
        x, pi = self._shape(y, out)
        b = self._b(y)
        turning = relative[:, r - base.turns :] if base.turns else relative[:, :0]
        energy = 0.5 * (np.sum(turning * base.angular(b), axis=1) + np.sum(xdot * pi, axis=1))
        energy += self._potential.values(x, com)
        if self._forces is not None:
            energy += self._forces.potentials(x, numbers)
        if not self._wanted:
            energy += base.weight_energy(b, com)
            return ShapeState(t=t.copy(), x=x, xdot=xdot, energy=energy)
        energy += base.base_energy(b, com, t)
        pose, J = base.pose(b, com, t), base.spatial_momentum(b, t)
        mu = (np.swapaxes(system.group.Ad(pose), -1, -2) @ J[:, :, None])[:, :, 0]
        return full_state(system, t, x, xdot, base.twist(b, relative, t), pose, mu, J, energy)

    @property
    def address(self) -> int:
        """Address of the vector field."""
        return self.kernel.rate.address

    def shape(self, y: Array) -> Array:
        """Return the shape (m,) in a reduced state."""
        out = np.zeros(self.kernel.outputs_size)
        if self._prescribed:
            out = self.kernel.evaluate_outputs(y, self.parameters)
        x, _ = self._shape(y[None], out[None])
        return np.asarray(x[0])

    def entry_name(self, entry: int) -> str:
        """Return what an entry of the reduced state is, for messages."""
        return entry_name(self._system, self._active, self._cyclic, entry)

    def _with(self, numbers: Array) -> Array:
        """Return the parameters with these numbers in the forces."""
        return np.concatenate([self.parameters[: len(self.parameters) - len(numbers)], numbers])

    def _b(self, y: Array) -> Array:
        layout = self.kernel.layout
        return y[..., layout.base_at : layout.base_at + layout.base.size]

    def _shape(self, y: Array, out: Array) -> tuple[Array, Array]:
        """Return x and π, (T, m) each, from reduced states and outputs."""
        T, k, n = len(y), len(self._active), self._system.n
        x, pi = np.empty((T, self._system.m)), np.empty((T, self._system.m))
        x[:, self._active], x[:, self._cyclic] = y[:, :k], y[:, 2 * k : 2 * k + len(self._cyclic)]
        pi[:, self._active], pi[:, self._cyclic] = y[:, k : 2 * k], self._pi_cyclic
        if self._prescribed:
            places = n + 3 + len(self._prescribed)
            x[:, self._prescribed] = out[:, n + 3 : places]
            pi[:, self._prescribed] = out[:, places:]
        return x, pi


class CompiledFlows:
    """Flows of one scene from many initial states, all with or all without momentum.

    kernel: of all of them.  y0: (N, k).  parameters: (N, p).
    """

    def __init__(self, scene: Scene, start: Start, about: Array) -> None:
        """Set up the flows.  start: (N, …).  about: (N, a) their angular momenta.

        Raises SymmetryError if gravity breaks the symmetry.
        """
        system, forces = scene.system, scene.force_model
        r = system.r
        self.scene, self.potential = scene, shape_gravity(system)
        wanted, wrench = scene.outputs == "all", forces is not None and forces.has_wrench
        self.base = base = Base(
            system, start, about, wanted=wanted, wrench=wrench, zero=not about.any()
        )
        self.kernel: Kernel = kernel_for(scene, zero_momentum=not base.has_momentum)
        layout, N = self.kernel.layout, len(start.x)
        active, cyclic = list(layout.active), list(layout.cyclic)
        v = np.concatenate([base.relative_twist0, start.xdot], axis=1)
        pi = (start.mass_matrix[:, r:] @ v[:, :, None])[:, :, 0]
        x, clock = start.x, np.zeros((N, layout.clock))
        parts = [x[:, active], pi[:, active], x[:, cyclic], base.b0, clock]
        self.y0 = np.concatenate(parts, axis=1)
        own = np.empty(0) if forces is None else forces.numbers_from(0.0, scene.end)
        numbers = np.broadcast_to(own, (N, len(own)))
        self.parameters = np.concatenate([base.spin, pi[:, cyclic], numbers], axis=1)
