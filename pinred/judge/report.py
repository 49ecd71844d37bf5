"""The report of a comparison: what was judged, by which bounds, and the verdict."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ..common.arrays import Array, freeze

JUDGEABLE = 0.1  # rad, or part of the motion's size; a bound above it says nothing


class Verdict(StrEnum):
    """The outcome of a comparison."""

    PASSED = "PASSED"
    FAILED = "FAILED"
    CANNOT_TELL = "CANNOT TELL"


EXIT_CODES = {Verdict.PASSED: 0, Verdict.FAILED: 1, Verdict.CANNOT_TELL: 3}


@dataclass(frozen=True, repr=False)
class Report:
    """The distance of a reduced trajectory from the full simulation, and its bounds.

    t: (T,) the times judged [s].  shape_errors: (T, M) |Δx| of each joint of the file
    [rad | m].  rotation_errors [rad] and position_errors [m]: (T,) norms of the parts of
    log(g⁻¹ĝ).  *_bounds: what passes, of the same shapes.
    equations: the largest error of the equations of motion by ABA at the trajectory's states,
    relative.  defect: the largest defect of a step by ABA, relative.  energy_drift: largest
    |E − E0| over the kinetic energy.  momentum_drift: the same of the conserved momentum, angular
    about the centre of mass, over √(2mT) (times the radius of gyration).  field_error: largest
    difference of pose, twist, momenta and energy from what Pinocchio makes of q and v.
    reference_error: how far two references, of order 8 and 5, are apart [relative to the
    motion's size].  *_bound: what passes.  growth: (T,) factor by which a small perturbation of
    the initial state has grown.  told: how many of the times, from the first on, have ends of
    which something can be told.  reasons: why nothing can be told of what is left; empty if all
    of the motion is judged.  wall_reduced, wall_full: seconds of integration at the same
    tolerance.  left_out: a sentence on springs, dampers and friction in the robot's file that
    neither side has, or nothing.
    """

    robot: str
    engine: str
    group: str
    joints: int
    duration: float
    rtol: float
    atol: float
    t: Array
    shape_errors: Array
    rotation_errors: Array
    position_errors: Array
    shape_bounds: Array
    rotation_bounds: Array
    position_bounds: Array
    equations: float
    defect: float
    energy_drift: float
    momentum_drift: float
    field_error: float
    reference_error: float
    equations_bound: float
    defect_bound: float
    drift_bound: float
    field_bound: float
    reference_bound: float
    growth: Array
    told: int
    reasons: tuple[str, ...]
    wall_reduced: float
    wall_full: float
    left_out: str = ""

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def shape_error(self) -> float:
        """Largest shape error over time [rad | m]."""
        return float(self.shape_errors.max(initial=0.0))

    @property
    def rotation_error(self) -> float:
        """Largest rotation error of the base over time [rad]."""
        return float(self.rotation_errors.max())

    @property
    def position_error(self) -> float:
        """Largest position error of the base over time [m]."""
        return float(self.position_errors.max())

    @property
    def checks(self) -> dict[str, tuple[float, float]]:
        """Judged numbers: name to (value, largest value that passes).

        Of errors over time, and of joints, those that come closest to what passes.
        """
        n = self.told
        return {
            "equations of motion [relative]": (self.equations, self.equations_bound),
            "defect of a step [relative]": (self.defect, self.defect_bound),
            "shape error [rad | m]": _closest(self.shape_errors[:n], self.shape_bounds[:n]),
            "rotation error [rad]": _closest(self.rotation_errors[:n], self.rotation_bounds[:n]),
            "position error [m]": _closest(self.position_errors[:n], self.position_bounds[:n]),
            "reference error [relative]": (self.reference_error, self.reference_bound),
            "energy drift [relative]": (self.energy_drift, self.drift_bound),
            "momentum drift [relative]": (self.momentum_drift, self.drift_bound),
            "fields against q, v": (self.field_error, self.field_bound),
        }

    @property
    def verdict(self) -> Verdict:
        """Whether all is within its bounds, or something is not, or that cannot be told.

        What is not a number is within no bound.
        """
        if not all(value <= bound for value, bound in self.checks.values()):
            return Verdict.FAILED
        return Verdict.CANNOT_TELL if self.reasons else Verdict.PASSED

    @property
    def passed(self) -> bool:
        """Whether all of the motion was judged, and every value is within its bound."""
        return self.verdict is Verdict.PASSED

    def __bool__(self) -> bool:
        return self.passed

    def __repr__(self) -> str:
        """Return one line."""
        values, bounds = np.array(list(self.checks.values())).T
        k = _worst(values, bounds)
        worst, value, bound = list(self.checks)[k], values[k], bounds[k]
        told = f": {self.reasons[0]}" if self.verdict is Verdict.CANNOT_TELL else ""
        return (
            f"<Report of {self.robot}, {self.duration:g} s: {self.verdict}{told}; "
            f"closest to its bound: {worst} {value:.1e} of {bound:.1e}>"
        )

    def __str__(self) -> str:
        head = (
            f"{self.robot}: {self.group} × {self.joints} joints, {self.duration:g} s, "
            f"rtol {self.rtol:g}, atol {self.atol:g}\n"
            f"reduced equations against Pinocchio's ABA on the full state\n"
            + (f"{self.left_out}\n" if self.left_out else "")
        )
        rows = [
            f"  {name:<31} {value:10.2e}   allowed {bound:8.1e}   "
            f"{'ok' if value <= bound else 'FAILED'}"
            for name, (value, bound) in self.checks.items()
        ]
        rows += [f"  {'growth of perturbations':<31} {self.growth[-1]:10.2e}"]
        rows.append(
            f"  {'wall time [s]':<31} {self.wall_reduced:10.5f} reduced ({self.engine}), "
            f"{self.wall_full:.3f} full (ABA called from Python)"
        )
        rows += [f"  {reason}" for reason in self.reasons]
        return head + "\n".join(rows) + f"\n  verdict: {self.verdict}"

    def _repr_html_(self) -> str:
        from ..common.html import card, line, table, verdict

        about = (
            f"{self.group} × {self.joints} joints, {self.duration:g} s, rtol {self.rtol:g}, "
            f"atol {self.atol:g}; reduced equations against Pinocchio's ABA on the full state"
        )
        rows = [
            (name, f"{value:.2e}", f"{bound:.1e}", verdict(value <= bound))
            for name, (value, bound) in self.checks.items()
        ]
        return card(
            self.robot,
            about,
            *([line(self.left_out)] if self.left_out else []),
            table("", ["", "value", "allowed", ""], rows),
            line(f"growth of perturbations: {self.growth[-1]:.2e}"),
            line(
                f"wall time: {self.wall_reduced:.5f} s reduced ({self.engine}), "
                f"{self.wall_full:.3f} s full (ABA called from Python)"
            ),
            *(line(reason) for reason in self.reasons),
            line("verdict:", verdict(self.passed, str(Verdict.PASSED), str(self.verdict))),
        )


def _closest(errors: Array, bounds: Array) -> tuple[float, float]:
    """Return the error and the bound of which it is the largest part; zeros if there is none."""
    if not errors.size:
        return 0.0, 0.0
    k = _worst(errors, bounds)
    return float(errors.ravel()[k]), float(bounds.ravel()[k])


def _worst(errors: Array, bounds: Array) -> int:
    """Return where the error is the largest part of its bound; what is no number wins."""
    parts = np.divide(errors, bounds, out=np.where(errors > 0.0, np.inf, 0.0), where=bounds > 0.0)
    return int(np.argmax(np.where(np.isfinite(errors), parts, np.inf)))
