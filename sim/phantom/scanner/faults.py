"""Effects of a real scanner beyond noise: geometry that is not as stated, blur, metal.

Every fault has a size; the default is none. The truth remains that of the scene: markers where they are.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from sim.errors import SEE_PHANTOM, BadScene
from sim.phantom.scanner import blur

MOST_TILT_DEG = 30.0  # of a gantry


@dataclass(frozen=True)
class Kernel:
    """A reconstruction kernel: blur in the slice, edge enhancement, and the colour of its noise.

    The point spread is (1 + enhanced) times a Gaussian minus `enhanced` times one of twice the width;
    `noise_side` is the tap next to the middle one with which noise is generated, None for that of the blur.
    """

    plane_sigma_mm: float = blur.PLANE_SIGMA_MM
    enhanced: float = 0.0
    noise_side: float | None = None
    name: str = "STANDARD"  # as stated in the series


KERNELS = {
    "standard": Kernel(),
    "smooth": Kernel(0.60, name="SOFT"),
    "sharp": Kernel(0.36, 0.25, -0.25, "BONE"),
}


@dataclass(frozen=True)
class ScannerFaults:
    """Tilt of the gantry (degrees), true over stated table feed minus 1, slice thickness (None: the stated
    spacing), beam hardening (1: typical), patient motion halfway up the markers, in any direction and along
    the table, the kernel, whether metal is stored beyond 3071 HU, and whether the headers show upright slices
    whatever the tilt.
    """

    tilt_deg: float = 0.0
    table_scale: float = 0.0
    thickness_mm: float | None = None
    beam_hardening: float = 0.0
    motion_mm: float = 0.0
    slide_mm: float = 0.0
    kernel: str = "standard"
    extended_range: bool = False
    tilt_hidden: bool = False

    def __post_init__(self) -> None:
        if self.kernel not in KERNELS:
            raise BadScene(f"unknown kernel {self.kernel!r}", expected=", ".join(KERNELS), action=SEE_PHANTOM)
        if abs(self.tilt_deg) > MOST_TILT_DEG:
            raise BadScene(
                f"no gantry tilts by {self.tilt_deg:g} degrees",
                limit=f"{MOST_TILT_DEG:g}",
                action=SEE_PHANTOM,
            )
        if self.tilt_hidden and not self.tilt_deg:
            raise BadScene("a tilt of 0 degrees cannot be hidden", action=SEE_PHANTOM)

    @property
    def stated_tilt_deg(self) -> float:
        """As the headers have it."""
        return 0.0 if self.tilt_hidden else self.tilt_deg

    def active(self) -> dict[str, Any]:
        """Those that differ from the default, for the truth file."""
        usual = asdict(ScannerFaults())
        return {name: value for name, value in asdict(self).items() if value != usual[name]}


NO_FAULTS = ScannerFaults()
