"""The compiled flow of a scene: kernel, parameters, and the full state behind a reduced one."""

from __future__ import annotations

import numpy as np

from ..arrays import Array
from ..base import BASES
from ..canonical import CanonicalForm
from ..flow import symmetric
from ..potential import potential_of
from ..scene import Scene
from ..trajectory import State
from .evaluate import evaluate
from .kernel import Kernel, kernel_for


class CompiledFlow:
    """What the compiled integrators need of a scene.

    kernel: machine code and layout.  y0: (k,) reduced state at the start.  parameters:
    (p,) what the kernel reads besides.
    """

    def __init__(self, scene: Scene) -> None:
        """Set up the flow.  Raises SymmetryError if gravity breaks the symmetry."""
        system, start = scene.system, scene.start
        self._system = system
        self._potential = potential = potential_of(system, scene.springs)
        form = system.workspace(CanonicalForm, lambda: CanonicalForm(system, potential))
        H = symmetric(form.mass_matrix(start.x))
        self._base = BASES[system.group.name](system, start, form.com())
        pi = H[system.r :] @ np.concatenate([self._base.relative_twist0, start.xdot])
        self.kernel: Kernel = kernel_for(
            system,
            self._potential,
            tuple(scene.springs),
            zero_momentum=not self._base.spin.any(),
        )
        layout = self.kernel.layout
        self._active, self._cyclic = list(layout.active), list(layout.cyclic)
        springs = np.array(list(scene.springs.values())).reshape(-1, 2)
        self._pi_cyclic = pi[self._cyclic]
        spin = self._base.spin[: layout.spin]
        self.parameters = np.concatenate([spin, self._pi_cyclic, springs[:, 0], springs[:, 1]])
        self.y0 = np.concatenate(
            [
                start.x[self._active],
                pi[self._active],
                start.x[self._cyclic],
                self._base.attitude0,
            ]
        )

    def states(self, t: Array, y: Array) -> State:
        """Return the full states at times t (T,) of reduced states y (T, k)."""
        system, base = self._system, self._base
        r, k, T = system.r, len(self._active), len(t)
        out = evaluate(self.kernel.outputs.address, self.parameters, y, system.n + 3)
        relative, xdot, com = out[:, :r], out[:, r : system.n].copy(), out[:, system.n :]
        x, pi = np.empty((T, system.m)), np.empty((T, system.m))
        x[:, self._active], x[:, self._cyclic] = y[:, :k], y[:, 2 * k : 2 * k + len(self._cyclic)]
        pi[:, self._active], pi[:, self._cyclic] = y[:, k : 2 * k], self._pi_cyclic
        attitude = y[:, y.shape[1] - len(base.attitude0) :]
        pose, xi = base.pose(attitude, com, t), base.twist(attitude, relative, t)
        group, mass = system.group, system.mass
        J = base.spatial_momentum(mass, t)
        mu = np.swapaxes(group.Ad(pose), -1, -2) @ J[:, :, None]
        energy = (
            base.turning_energy(attitude, relative)
            + 0.5 * np.sum(xdot * pi, axis=1)
            + base.carried_energy(mass, t)
            + base.falling_energy(mass, t)
            + self._potential.values(x, com)
        )
        return State(
            t=t.copy(),
            x=x,
            xdot=xdot,
            xi=xi,
            pose=pose,
            q=system.q(pose, x),
            v=system.v(xi, xdot),
            body_momentum=mu[:, :, 0],
            spatial_momentum=J,
            energy=energy,
        )

    @property
    def address(self) -> int:
        """Address of the vector field."""
        return self.kernel.rate.address

    def shape(self, y: Array) -> Array:
        """Return the shape (m,) in a reduced state."""
        x, k = np.empty(self._system.m), len(self._active)
        x[self._active], x[self._cyclic] = y[:k], y[2 * k : 2 * k + len(self._cyclic)]
        return x

    def entry_name(self, entry: int) -> str:
        """Return what an entry of the reduced state is, for messages."""
        names, k = self._system.shape_names, len(self._active)
        if entry < k:
            return f"the position of joint '{names[self._active[entry]]}'"
        if entry < 2 * k:
            return f"the momentum of joint '{names[self._active[entry - k]]}'"
        if entry < 2 * k + len(self._cyclic):
            return f"the position of joint '{names[self._cyclic[entry - 2 * k]]}'"
        return f"the attitude of the root joint '{self._system.root_name}'"
