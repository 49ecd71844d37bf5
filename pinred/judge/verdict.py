"""The report of a comparison: compared values, their bounds, and the verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, FrozenArrays


class Verdict(StrEnum):
    """The outcome of a comparison."""

    PASSED = "PASSED"
    FAILED = "FAILED"
    CANNOT_TELL = "CANNOT TELL"


EXIT_CODES = {Verdict.PASSED: 0, Verdict.FAILED: 1, Verdict.CANNOT_TELL: 3}


@checks_arguments
@dataclass(frozen=True, repr=False)
class Report(FrozenArrays):
    """Errors of a reduced trajectory against the full simulation, and the bounds on them.

    Attributes:
        robot: Name of the robot.
        engine: Engine of the reduced simulation.
        group: Name of the symmetry group.
        joints: Number of shape coordinates m.
        duration: Duration of the motion [s].
        rtol: Relative tolerance of the scene.
        atol: Absolute tolerance of the scene.
        t: Times of the comparison, (T,) [s].
        shape_errors: |Δx| of each joint of the file, (T, M) [rad | m].
        rotation_errors: Norm of the rotational part of log(g⁻¹ĝ), (T,) [rad].
        position_errors: Norm of the translational part of log(g⁻¹ĝ), (T,) [m].
        shape_bounds: Largest shape errors that pass, (T, M) [rad | m].
        rotation_bounds: Largest rotation errors that pass, (T,) [rad].
        position_bounds: Largest position errors that pass, (T,) [m].
        equations: Largest relative error of the equations of motion, evaluated with ABA.
        defect: Largest relative defect of a step, evaluated with ABA.
        energy_drift: Largest |E − E₀ − work| relative to the kinetic energy.
        momentum_drift: Largest change of conserved momentum relative to √(2mT), times the radius
            of gyration for angular momentum, which is taken about the centre of mass.  It includes
            constant momenta of symmetric bodies on balls.
        field_error: Largest relative difference of pose, twist, momenta and energy from
            Pinocchio's values at q and v.
        reference_error: Distance between the two reference solutions of order 8 and 5, relative
            to the motion's size.
        equations_bound: Largest `equations` that passes.
        defect_bound: Largest `defect` that passes.
        drift_bound: Largest drift of energy or momentum that passes.
        field_bound: Largest `field_error` that passes.
        reference_bound: Largest `reference_error` that passes.
        growth: Factor by which a small perturbation of the initial state has grown, (T,).
        told: Number of leading times at which errors can be judged.
        reasons: Why the motion cannot be judged completely; empty if it can.
        wall_reduced: Wall time of the reduced integration [s].
        wall_full: Wall time of the full integration at the same tolerance [s].
        left_out: Sentence about springs, dampers and friction of the robot's file that neither
            simulation includes, or empty.
        loop_gap: Largest violation of a closed loop, in units of its size or 1 rad; None without
            loops.
        loop_rate: Largest rate of the violation of a closed loop, relative to that of an open tree
            at the same speed; None without loops.
        rate_error: Largest relative error of a rate at the ends of stiff steps and at the times of
            the comparison; 0 without stiff steps. Only errors at report times are judged.
        stop_checks: Name, value and bound of each check of joint stops.
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
    loop_gap: float | None = None
    loop_rate: float | None = None
    rate_error: float = 0.0
    stop_checks: tuple[tuple[str, float, float], ...] = ()

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
        """Name → (value, largest value that passes) of each check.

        Errors over time and joints are represented by the entry closest to its bound.
        """
        n = self.told
        loops = {"gap of loops": self.loop_gap, "rate of the gap [relative]": self.loop_rate}
        drifts = {
            name: (value, self.drift_bound) for name, value in loops.items() if value is not None
        }
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
            **drifts,
            **{name: (value, bound) for name, value, bound in self.stop_checks},
        }

    @property
    def verdict(self) -> Verdict:
        """FAILED if a value exceeds its bound or is NaN; CANNOT TELL if there are `reasons`."""
        if not all(value <= bound for value, bound in self.checks.values()):
            return Verdict.FAILED
        return Verdict.CANNOT_TELL if self.reasons else Verdict.PASSED

    @property
    def passed(self) -> bool:
        """Whether the whole motion was judged and every value is within its bound."""
        return self.verdict is Verdict.PASSED

    def __bool__(self) -> bool:
        return self.passed

    def __repr__(self) -> str:
        """Summarise the verdict and the value closest to its bound in one line."""
        values, bounds = np.array(list(self.checks.values())).T
        k = _worst(values, bounds)
        worst, value, bound = list(self.checks)[k], values[k], bounds[k]
        reason = f": {self.reasons[0]}" if self.verdict is Verdict.CANNOT_TELL else ""
        return (
            f"<Report of {self.robot}, {self.duration:g} s: {self.verdict}{reason}; "
            f"closest to its bound: {worst} {value:.1e} of {bound:.1e}>"
        )

    def __str__(self) -> str:
        head = (
            f"{self.robot}: {self.group} × {self.joints} joints, {self.duration:g} s, "
            f"rtol {self.rtol:g}, atol {self.atol:g}\n"
            f"reduced equations against Pinocchio's ABA on the full state\n"
            + (f"{self.left_out}\n" if self.left_out else "")
        )
        lines = table_of(self.checks)
        lines += [f"  {'growth of perturbations':<31} {self.growth[-1]:10.2e}"]
        if self.rate_error:
            lines += [f"  {'rate error [relative]':<31} {self.rate_error:10.2e}"]
        lines.append(
            f"  {'wall time [s]':<31} {self.wall_reduced:10.5f} reduced ({self.engine}), "
            f"{self.wall_full:.3f} full (ABA called from Python)"
        )
        lines += [f"  {reason}" for reason in self.reasons]
        return head + "\n".join(lines) + f"\n  verdict: {self.verdict}"

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
            *([line(f"rate error: {self.rate_error:.2e}")] if self.rate_error else []),
            line(
                f"wall time: {self.wall_reduced:.5f} s reduced ({self.engine}), "
                f"{self.wall_full:.3f} s full (ABA called from Python)"
            ),
            *(line(reason) for reason in self.reasons),
            line("verdict:", verdict(self.passed, str(Verdict.PASSED), str(self.verdict))),
        )


def table_of(checks: Mapping[str, tuple[float, float]]) -> list[str]:
    """Return a line of text for each check, {name: (value, bound)}."""
    return [
        f"  {name:<31} {value:10.2e}   allowed {bound:8.1e}   "
        f"{'ok' if value <= bound else 'FAILED'}"
        for name, (value, bound) in checks.items()
    ]


def _closest(errors: Array, bounds: Array) -> tuple[float, float]:
    """Return the error that is closest to its bound, and that bound; zeros without errors."""
    if not errors.size:
        return 0.0, 0.0
    k = _worst(errors, bounds)
    return float(errors.ravel()[k]), float(bounds.ravel()[k])


def _worst(errors: Array, bounds: Array) -> int:
    """Return the flat index of the largest ratio of error to bound; a non-finite error wins."""
    unbounded = np.where(errors > 0.0, np.inf, 0.0)
    ratios = np.divide(errors, bounds, out=unbounded, where=bounds > 0.0)
    return int(np.argmax(np.where(np.isfinite(errors), ratios, np.inf)))
