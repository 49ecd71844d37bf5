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
from pinred.forces.kinds import Torque
from pinred.kernels.device import cuda_driver, device_code
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
    """

    name: str
    robot: str
    end: float
    method: str = "DOP853"
    bound: float = 1e-9
    functions: bool = False
    fields: tuple[str, ...] = ()

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
    options = batch.options(count)
    cpu = pinred.simulate_many(**options)
    expected = [cpu.fields([name])[name] for name in batch.fields] or [cpu.y]

    def store(launch: cuda_driver.Launch, progress: Any = None) -> None:  # noqa: ARG001
        assert len(launch.results[0]) == count
        file.with_suffix(".ptx").write_bytes(launch.code)
        arrays: dict[str, Any] = {
            f"{kind}{k}": array.view(np.uint8).reshape(len(array), -1)
            for kind, group in (("input", launch.inputs), ("result", launch.results))
            for k, array in enumerate(group)
        }
        arrays |= {f"expected{k}": array.reshape(count, -1) for k, array in enumerate(expected)}
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
            if batch.fields:
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
    for each in BATCHES:
        print(export(each, folder))
