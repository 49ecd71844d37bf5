"""Export batches for a CUDA device: PTX, arguments of the launch, and states of the CPU.

    python tests/device/export_batches.py FOLDER

No device is needed.  `run_on_device.py` runs the folder on a machine that has one.
"""

from __future__ import annotations

import shutil
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import casadi as ca
import numpy as np

import pinred
from pinred.common.arrays import Array
from pinred.forces.kinds import Torque
from pinred.integrators.integrate_many import integrate_many
from pinred.kernels.device import cuda_driver, device_code
from pinred.kernels.device.few_rows import stepper_with_few_rows
from pinred.kernels.flow_functions import rate_of
from pinred.simulation.flow_map.flow_columns import Columns
from pinred.simulation.members.trajectories import Trajectories


@dataclass(frozen=True)
class Batch:
    """A batch of members with random shapes and rates.

    Attributes:
        name: Name of its files.
        robot: Name of the robot.
        end: End time [s].
        method: Name of the method.
        bound: Largest difference from the CPU, relative to the largest state: round-off times the
            growth of perturbations.
        functions: Whether a torque of time needs functions of libm, hence libdevice.
        fields: Fields of the states that a launch computes from reduced states; none if a launch
            integrates members.
        wrt: Inputs of a flow whose derivatives the members carry; none if a launch integrates
            states alone.
    """

    name: str
    robot: str
    end: float
    method: str = "DOP853"
    bound: float = 1e-9
    functions: bool = False
    fields: tuple[str, ...] = ()
    wrt: tuple[str, ...] = ()

    def columns(self) -> Columns:
        """Return the flow whose derivatives the members carry."""
        options: dict[str, Any] = {"seed": 7, "duration": self.end, "method": self.method}
        flow = pinred.flow(pinred.load(self.robot), wrt=self.wrt, rtol=1e-9, **options)
        return flow.columns()

    def inputs(self, count: int) -> list[Array]:
        """Return the inputs of some members of the flow."""
        rng = np.random.default_rng(7)
        starts = self.columns().starts
        return [start + 0.1 * rng.normal(size=(count, len(start))) for start in starts]

    def options(self, count: int) -> dict[str, Any]:
        """Return the arguments of `simulate_many` for some members."""
        system = pinred.load(self.robot)
        rng = np.random.default_rng(7)
        options: dict[str, Any] = {
            "system": system,
            "members": {"x0": 0.3 * rng.normal(size=(count, system.m))},
            "xdot0": 0.3 * rng.normal(size=system.m),
            "times": np.linspace(0.0, self.end, 11) if self.fields else [self.end],
            "method": f"{self.method}(rtol=1e-9, atol=1e-9)",
        }
        if self.functions:
            options["forces"] = [Torque({system.space.names[0]: _functions})]
        return options


def _functions(t: ca.SX, *_: object) -> ca.SX:
    waves = ca.exp(-t) + ca.tanh(3 * t) + ca.tan(0.5 * ca.sin(t)) + ca.log(1 + t) + (1 + t) ** 1.3
    return 1e-2 * (waves + ca.atan2(t, 2) + ca.sinh(0.1 * t) + ca.cosh(0.1 * t) + ca.atan(t))


BATCHES = (
    Batch("coupled_planar", "coupled_planar", 10.0),
    Batch("planar_chain5", "planar_chain5", 10.0, bound=1e-7),
    Batch("satellite_two_arms", "satellite_two_arms", 10.0, bound=1e-7),
    Batch("solo12", "solo12", 4.0),
    Batch("talos", "talos", 2.0),
    Batch("tsit5", "falling_cat", 2.0, method="Tsit5"),
    Batch("functions", "falling_cat", 2.0, functions=True),
    Batch("states_of_cat", "falling_cat", 2.0, fields=("x", "pose", "energy"), functions=True),
    Batch("states_of_talos", "talos", 0.5, fields=("pose", "spatial_momentum", "energy", "q")),
)


TANGENTS = (
    Batch("tangents_of_chain", "planar_chain5", 1.0, wrt=("x0", "xdot0"), bound=1e-8),
    Batch("tangents_of_cat", "falling_cat", 1.0, wrt=("x0", "xi0"), bound=1e-8),
)


def _tangents_on_cpu(columns: Columns, launch: cuda_driver.Launch) -> Array:
    """Return the states and tangents that a launch computes."""
    propagator = columns.flow.propagator
    kernel, method = propagator.kernel, propagator.method
    _, params, y0, ends, times = launch.inputs
    return integrate_many(
        method, rate_of(kernel).joined.address, params, y0, ends, times[0],
        kernel.layout.quaternions, stepper=stepper_with_few_rows(method, tangent=True),
    ).y  # fmt: skip


class _Exported(Exception):  # noqa: N818 - no error
    """The launch is stored."""


def export(batch: Batch, folder: Path, count: int = 256) -> Path:
    """Store what `simulate_many` would launch for a batch, and the states that the CPU finds.

    Args:
        batch: The batch.
        folder: Folder of the files.
        count: Number of members.
    Returns:
        The file of the arguments.
    """
    file = folder / f"{batch.name}.npz"
    expected, columns = list[Array](), None
    if batch.wrt:
        columns = batch.columns()
    else:
        options = batch.options(count)
        cpu = pinred.simulate_many(**options)
        expected = [cpu.fields([name])[name] for name in batch.fields] or [cpu.y]

    def store(launch: cuda_driver.Launch, progress: Any = None) -> None:  # noqa: ARG001
        if columns is not None:
            expected.append(_tangents_on_cpu(columns, launch))
        size = len(expected[0])
        assert len(launch.results[0]) == size == count * sum(columns.sizes if columns else [1])
        file.with_suffix(".ptx").write_bytes(launch.code)
        arrays: dict[str, Any] = {
            f"{kind}{k}": array.view(np.uint8).reshape(len(array), -1)
            for kind, group in (("input", launch.inputs), ("result", launch.results))
            for k, array in enumerate(group)
        }
        arrays |= {f"expected{k}": array.reshape(size, -1) for k, array in enumerate(expected)}
        np.savez_compressed(
            file, entry=launch.entry, numbers=launch.numbers, each=launch.each, bound=batch.bound,
            **arrays,
        )  # fmt: skip
        raise _Exported

    with (
        mock.patch.object(device_code, "opened_devices"),
        mock.patch.object(device_code, "run_on_devices", store),
    ):
        try:
            if columns is not None:
                columns.jacobians(*batch.inputs(count), device="cuda")
            elif batch.fields:
                (members,) = cpu._batches
                members = replace(members, device="cuda")
                scenes = cpu._count, cpu._scene_of
                Trajectories(scenes, [members], {}, []).fields(batch.fields)
            else:
                pinred.simulate_many(device="cuda", **options)
        except _Exported:
            return file
    raise AssertionError(f"'{batch.name}' launched nothing")


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(Path(__file__).with_name("run_on_device.py"), folder)
    for each in (*BATCHES, *TANGENTS):
        print(export(each, folder))
