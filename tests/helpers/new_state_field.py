"""pinred with one more state field: edits of its source at import, and checks of the result."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from importlib.util import find_spec
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import numpy as np

# The edits that add the field `relative_twist`, by module: old text and new text.
NEW_FIELD = {
    "pinred.system.state_fields": [
        (
            '    StateField(\n        "energy",',
            '    StateField("relative_twist", "m/s | rad/s", "twist", "entries",\n'
            '        "Body twist relative to the centre of mass", needs_base=False),\n'
            '    StateField(\n        "energy",',
        ),
        ("    energy: Array\n", "    relative_twist: Array\n    energy: Array\n"),
        ('"energy"]', '"relative_twist", "energy"]'),
        ("    energy = _", '    relative_twist = _Column("relative_twist")\n    energy = _'),
    ],
    "pinred.kernels.reduced_graph": [
        ('fields["energy"] =', 'fields["relative_twist"] = self.xi\n        fields["energy"] =')
    ],
    "pinred.simulation.pinocchio_engine": [
        ("t=t.copy(),", "t=t.copy(), relative_twist=v[:, :r].copy(),")
    ],
}


class EditingLoader(SourceFileLoader):
    """Loader of a module in NEW_FIELD with its edits."""

    def get_code(self, fullname: str) -> CodeType:
        """Compile the edited source.  Raises ValueError if a text to edit is missing."""
        source = Path(self.path).read_text(encoding="utf-8")
        for old, new in NEW_FIELD[fullname]:
            if old not in source:
                raise ValueError(f"{fullname} does not contain {old!r}")
            source = source.replace(old, new)
        return compile(source, self.path, "exec")


class EditingFinder:
    """Finder of the modules in NEW_FIELD."""

    @staticmethod
    def find_spec(
        name: str, path: Sequence[str] | None = None, _target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the spec of a module in NEW_FIELD, None for all others."""
        spec = PathFinder.find_spec(name, path) if name in NEW_FIELD else None
        if spec is not None and spec.origin is not None:
            spec.loader = EditingLoader(name, spec.origin)
        return spec


def check_trajectories(pinred: Any) -> None:
    """Check the field on both engines, in states, files, labelled arrays and members."""
    cat = pinred.load("falling_cat")
    start: dict[str, Any] = {"x0": [0.1, 0.2, 0.3], "xdot0": [1.0, 0.0, 0.5]}
    start |= {"momentum": [0.0, 0.0, 0.0, 0.1, 0.2, 0.3], "times": [0.0, 0.1, 0.2]}
    traj, reference = (
        pinred.simulate(cat, engine=engine, **start) for engine in ("compiled", "pinocchio")
    )
    twist = traj.relative_twist
    assert twist.shape == (3, 6)
    assert np.abs(twist).max() > 0.1
    np.testing.assert_allclose(reference.relative_twist, twist, atol=1e-7)
    assert "relative to the centre of mass" in pinred.State.__doc__
    np.testing.assert_allclose(traj(0.1).relative_twist, twist[1], atol=1e-12)
    shape = pinred.simulate(cat, outputs="shape", **start)
    np.testing.assert_allclose(shape.relative_twist, twist, atol=1e-7)
    for motion, name in ((traj, "all.npz"), (shape, "shape.npz")):
        motion.save(name)
        recording = pinred.read_recording(name)
        np.testing.assert_array_equal(recording.relative_twist, motion.relative_twist)
    traj.save("motion.csv")
    assert "relative_twist.6" in Path("motion.csv").read_text(encoding="utf-8")
    members = pinred.simulate_many(cat, seeds=range(2), duration=0.1, times=[0.0, 0.05, 0.1])
    assert members.relative_twist.shape == (2, 3, 6)
    if find_spec("xarray"):
        assert members.to_xarray().relative_twist.dims == ("member", "t", "twist")


def check_flow(pinred: Any) -> None:
    """Compare derivatives of the field with central differences in every mode."""
    cat = pinred.load("falling_cat")
    flow = pinred.flow(cat, wrt=["xdot0"], of=["relative_twist"], duration=0.1, x0=[0.1, 0.2, 0.3])
    J, step = flow.jacobian()["xdot0"], np.array([0.0, 1e-5, 0.0])
    change = flow(xdot0=step).relative_twist - flow(xdot0=-step).relative_twist
    np.testing.assert_allclose(J[:, 1], change / 2e-5, atol=1e-8)
    columns = flow.columns()
    np.testing.assert_allclose(columns.value(step), flow(xdot0=step).relative_twist, atol=1e-14)
    adjoint = flow.vjp({"relative_twist": np.eye(6)[3]})["xdot0"]
    np.testing.assert_allclose(adjoint, J[3], atol=1e-12)


if __name__ == "__main__":
    sys.meta_path.insert(0, EditingFinder)
    import pinred as edited

    check_trajectories(edited)
    check_flow(edited)
