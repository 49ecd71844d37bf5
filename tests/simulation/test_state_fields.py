"""The table of state fields: classes agree with it, and everything else is derived from it."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from new_state_field import NEW_FIELD

import pinred
from pinred.system.state_fields import FIELDS, Outcome, StateArrays, axis_lengths


def test_classes_of_states_agree_with_the_table() -> None:
    """State, ShapeState, Outcome and the attributes of motions have exactly the table's fields."""
    shape = [name for name, field in FIELDS.items() if not field.needs_base]
    assert [field.name for field in fields(pinred.State)] == list(FIELDS)
    assert [field.name for field in fields(pinred.ShapeState)] == shape
    columns = {name for name in vars(StateArrays) if name in FIELDS}
    assert columns == FIELDS.keys() - {"t"}
    derivable = {name for name, field in FIELDS.items() if field.derivative != "none"}
    assert set(get_args(Outcome)) == derivable


@pytest.mark.parametrize("engine", ["compiled", "pinocchio"])
@pytest.mark.parametrize("robot", ["falling_cat", "cartpole", "rigid_body"])
def test_state_shapes_agree_with_the_table(robot: str, engine: Any) -> None:
    """Each field has the axis that the table gives, and a description in the documentation."""
    traj = pinred.simulate(pinred.load(robot), duration=0.1, times=[0.0, 0.1], engine=engine)
    lengths = axis_lengths(traj.system)
    for name, field in FIELDS.items():
        shape = (2,) if field.axis is None else (2, lengths[field.axis])
        assert getattr(traj, name).shape == shape
        assert field.description in (pinred.State.__doc__ or "")
    assert (pinred.Trajectory.pose.__doc__ or "").startswith("Pose of the base, (…, size)")
    with pytest.raises(AttributeError, match="read-only"):
        traj.pose = np.zeros(7)


@pytest.mark.by_hand
def test_new_field_needs_edits_in_at_most_four_files(tmp_path: Path) -> None:
    """After these edits the field is an attribute, a file column, a label and a flow output."""
    assert len(NEW_FIELD) <= 4
    root = Path(pinred.__file__).parents[1]
    environment = dict(os.environ) | {
        "PINRED_CACHE_DIR": str(tmp_path / "kernels"), "PYTHONPATH": str(root),
    }  # fmt: skip
    program = root / "tests/helpers/new_state_field.py"
    subprocess.run(
        [sys.executable, str(program)], check=True, cwd=tmp_path, env=environment, timeout=300
    )
