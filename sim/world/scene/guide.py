"""The guide on the mount, and the hands that work with it."""

from __future__ import annotations

from pydantic import Field

from ronna_hw.calibration import Numbers3, PoseRecord, Strict
from sim.world.scene.quantities import NotNegative, Positive


class Guide(Strict):
    """The true guide and its instrument, as opposed to the records.

    Its tip frame is that of the mandrel with which the tip was calibrated; z points down the bore.
    """

    reach_mm: Positive = Field(
        default=85.0, description="Length of the mandrel beyond the guide's lower end."
    )
    bore_mm: Positive = Field(
        default=85.0, description="Length of the guide from its upper to its lower end."
    )
    play_mm: NotNegative = Field(
        default=0.04, description="Diameter of the bore minus that of the instrument."
    )
    depth_stop_mm: NotNegative = Field(
        default=0.03, description="Error of a depth stop set by hand, one standard deviation."
    )
    seat_mm: NotNegative = Field(
        default=0.008, description="Repeatability of the changer, per axis, one standard deviation."
    )
    bent_mm: Numbers3 = Field(
        default=(0.0, 0.0, 0.0), description="Offset of the mandrel's end from its nominal position."
    )
    tilt_deg: tuple[float, float] = Field(
        default=(0.0, 0.0),
        description="Tilt of the bore from its nominal direction, about x and y of the tip frame.",
    )
    mass_kg: Positive = Field(default=1.4, description="Mass of everything below the changer.")
    tip_from_frame: PoseRecord | None = Field(
        default=None,
        description="Pose of the spheres on the guide (tracker tool `guide_frame`); without it, none.",
    )


class Hands(Strict):
    """Manual accuracy."""

    gauge_mm: NotNegative = Field(
        default=0.005, description="Error of a dial reading on the gauge, one standard deviation."
    )
