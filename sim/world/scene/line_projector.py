"""Line projector on the stereo head: a near-infrared laser behind a line lens, between the cameras.

Its light leaves one point and spreads in the plane of x and z of its frame, z towards the work. The lens
spreads the power evenly over the fan.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from ronna_hw.calibration import PoseRecord, Strict
from sim.world.scene.parts import Positive


class LineProjector(Strict):
    """True line projector."""

    tool_from_projector: PoseRecord = Field(description="Pose tool centre <- projector.")
    fan_deg: Annotated[float, Field(gt=0, le=120)] = Field(default=12.0, description="Angle of the fan.")
    width_mm: Positive = Field(
        default=0.2, description="Width of the line at its focus, between the places of 1/e² of its middle."
    )
    focus_mm: Positive = Field(default=232.0, description="Distance of the focus from the lens.")
    power_mW: Annotated[float, Field(gt=0, le=100)] = Field(
        default=0.7, description="Power of all light of the line."
    )
    wavelength_nm: Annotated[float, Field(ge=700, le=1000)] = Field(default=850.0, description="Wavelength.")
