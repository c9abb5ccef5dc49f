"""What the planner was asked to open, as passed on by the command line."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel, ConfigDict

SixNumbers = tuple[float, float, float, float, float, float]


class PlannerRequest(BaseModel):
    """A CT, the plan on it, and the arm that should follow it, if known."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    series: Path
    plan: Path
    port: int = 0
    config: Path | None = None
    strategy: str = "ocs"
    robot_from_ct: SixNumbers | None = None
    home_deg: SixNumbers | None = None
