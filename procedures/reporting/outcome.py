"""Outcome of a run. As JSON, these models form the stable output of `ronna-procedure run --json`."""

from __future__ import annotations

import math
from typing import Any, Literal

from pydantic import BaseModel, Field, SerializerFunctionWrapHandler, model_serializer

from procedures.engine.methods import Matcher
from procedures.imaging.localizers import Localizer
from procedures.journal.results import Values


class CtOutcome(Values):
    """Spheres found in the CT, compared with the truth."""

    found: int
    missed: int
    false: int
    rms_error_mm: float | None


class ErrorParts(BaseModel, frozen=True, extra="ignore", allow_inf_nan=False):
    """The error's two parts as vectors in the robot frame, which add up to the error."""

    registration_mm: tuple[float, float, float] = Field(description="Registered minus true target.")
    intrinsic_mm: tuple[float, float, float] = Field(description="Tip minus registered target.")

    @property
    def lengths_mm(self) -> dict[str, float]:
        """Lengths of both vectors."""
        return {
            "registration": math.hypot(*self.registration_mm),
            "intrinsic": math.hypot(*self.intrinsic_mm),
        }


class TargetTruth(BaseModel, frozen=True, extra="ignore", allow_inf_nan=False):
    """True position of the tip at one target, according to the theatre's verifier."""

    id: str
    application_error_mm: float
    lateral_mm: float | None = Field(default=None, description="Component across the planned axis.")
    axial_mm: float | None = Field(default=None, description="Component along it.")
    parts: ErrorParts | None = Field(default=None, description="Shares of registration and arm.")


class Truth(BaseModel, frozen=True, extra="ignore", allow_inf_nan=False):
    """Result of the simulated theatre's verifier for a run; empty with real devices."""

    ct: CtOutcome | None = None
    targets: tuple[TargetTruth, ...] = ()


class RegistrationOutcome(Values):
    """Number of matched fiducials, and the residual of each registration."""

    n: int
    fre_mm: tuple[float, ...]


class TargetOutcome(Values):
    """Result at a target. The application error is known only in a simulated theatre."""

    id: str
    depth_mm: float
    predicted_tre_mm: float = Field(description="Root mean square.")
    application_error_mm: float | None
    strategy: str | None = Field(
        default=None, description="Used: another than the run's if the operator agreed, and with `best`."
    )
    measured_error_mm: float | None = Field(
        default=None, description="Measured by the stereo head in place of the guide, on a phantom."
    )

    @model_serializer(mode="wrap")
    def _only_what_was_measured(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Omit the measured error if there is none, so that scripts find the same keys in every case."""
        values: dict[str, Any] = plain(self)
        if self.measured_error_mm is None:
            del values["measured_error_mm"]
        return values


class RunOutcome(Values):
    """Outcome values that every run can report."""

    run: str
    outcome: str
    seed: int | None
    strategy: str
    localizer: Localizer = Localizer.OURS
    matcher: Matcher = Matcher.OURS


FinishedOutcome = Literal["done", "in doubt", "missed"]


class FinishedRun(RunOutcome):
    """A run that reached the end of its case."""

    outcome: FinishedOutcome = Field(
        default="done", description="A target beyond its margin is missed, whatever else is doubted."
    )
    markers: int = Field(description="Found in the CT.")
    ct: CtOutcome | None
    registration: RegistrationOutcome
    targets: tuple[TargetOutcome, ...]
    left_out: dict[str, str] = Field(default={}, description="Trajectories that were left out, and why.")
    in_doubt: dict[str, tuple[str, ...]] = Field(
        default={}, description="Targets that may be off by more than was predicted, and why."
    )
    beyond_margin: dict[str, float] = Field(
        default={},
        description="Targets whose known error is above the margin of the plan, and that error in mm.",
    )
    limit_beyond_margin: dict[str, float] = Field(
        default={},
        description="Targets whose predicted limit is above the margin of the plan, and that limit in mm.",
    )
    mean_application_error_mm: float | None
    max_application_error_mm: float | None
    late_cycles: int = Field(description="Late or lost cycles, over all streams of the robot link.")
    sim_s: float = Field(description="Theatre time.")
    wall_s: float
    report: str | None = None


class RunError(Values):
    """The error that ended a run."""

    code: str
    what: str


class UnfinishedRun(RunOutcome):
    """A run that was interrupted or failed."""

    outcome: Literal["interrupted", "failed"]
    error: RunError | None
    report: str | None = None
