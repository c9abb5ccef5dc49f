"""The guide on the mount, and the hands that work with it."""

from __future__ import annotations

from pydantic import Field

from ronna_hw.calibration import Numbers3, PoseRecord, Strict
from sim.theatre.scene.quantities import NotNegative, Positive


class Guide(Strict):
    """The guide as it really is, beside what was measured when its records were made, and its instrument.

    Its tip frame is that of the mandrel with which the tip was calibrated; z leads down the bore.
    """

    reach_mm: Positive = Field(default=85.0, description="Of the mandrel, beyond the guide's lower end.")
    bore_mm: Positive = Field(default=85.0, description="From the upper end to the lower one.")
    play_mm: NotNegative = Field(default=0.04, description="Diameter of the bore less the instrument's.")
    depth_stop_mm: NotNegative = Field(
        default=0.03, description="How exactly hands set a depth stop, one standard deviation."
    )
    seat_mm: NotNegative = Field(
        default=0.008, description="How alike the changer seats, per axis, one standard deviation."
    )
    bent_mm: Numbers3 = Field(default=(0.0, 0.0, 0.0), description="Its mandrel's end beside its place.")
    tilt_deg: tuple[float, float] = Field(
        default=(0.0, 0.0), description="Its bore beside its direction, about x and y of the tip frame."
    )
    mass_kg: Positive = Field(default=1.4, description="Of all that hangs below the changer.")
    tip_from_frame: PoseRecord | None = Field(
        default=None,
        description="Pose of the spheres on the guide, the tracker's tool `guide_frame`; none without.",
    )


class Hands(Strict):
    """What the room's hands do, and how exactly."""

    gauge_mm: NotNegative = Field(
        default=0.005, description="How exactly a dial on the gauge is read, one standard deviation."
    )
