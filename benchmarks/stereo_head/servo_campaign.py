"""Random starts of the visual servo, 5 mm from the sphere: steps, last residuals, recorded points."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.stereo_head.stereo_cell import Start, StereoCell
from benchmarks.stereo_head.stereo_pictures import Studio
from ronna_hw.errors import RonnaError
from sim.world.scene.model import Scene
from sim.world.scene.named_scenes import named_scene

Array = NDArray[np.float64]

START_MM = 5.0
END_MM, STEPS = 0.03, 8
STARTS_PER_CELL = 100  # then another arm, mount and head
PLACES_SEED = 7


@dataclass
class ServoTally:
    """Outcomes of the starts. `beyond_mm` is the recorded point's error without the repeatability error."""

    starts: int = 0
    steps: list[int] = field(default_factory=list)
    residuals_mm: list[float] = field(default_factory=list)
    errors_mm: list[float] = field(default_factory=list)
    beyond_mm: list[float] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)

    @property
    def within(self) -> int:
        """Starts that met the end condition within the allowed steps."""
        ends = zip(self.steps, self.residuals_mm, strict=True)
        return sum(steps <= STEPS and residual <= END_MM for steps, residual in ends)


def servo_campaign(
    starts: int,
    scene_of: Callable[[Scene], Scene] = lambda scene: scene,
    *,
    first_seed: int = 0,
    drawn: bool = True,
    in_sight: bool = True,
) -> ServoTally:
    """Run the step's servo from `starts` random positions; `scene_of` modifies each cell's scene first.

    Without drawn images the measurements are the truth, at a fiftieth of the cost: only the arm's
    errors remain. Without `in_sight` it begins where the path check would refuse to, with another
    sphere in the line of sight.
    """
    tally = ServoTally()
    with tempfile.TemporaryDirectory(prefix="ronna-servo-") as folder:
        for number in range(-(-starts // STARTS_PER_CELL)):
            scene = scene_of(named_scene("default", seed=first_seed + number))
            count = min(STARTS_PER_CELL, starts - tally.starts)
            cell = calibrated_cell(scene, Path(folder))
            generator = np.random.default_rng([PLACES_SEED, first_seed + number])
            for _ in range(count):
                _from_one_start(cell, cell.draw_start(generator, START_MM, in_sight=in_sight), tally, drawn)
    return tally


def calibrated_cell(scene: Scene, folder: Path) -> StereoCell:
    """A cell with cameras calibrated without errors, on a mount that is assumed to be nominal."""
    perfect = Studio(scene).calibration()
    nominal = perfect.model_copy(update={"flange_from_tool": scene.mount.flange_from_tool_nominal})
    return StereoCell(scene, nominal, folder)


def _from_one_start(cell: StereoCell, start: Start, tally: ServoTally, drawn: bool) -> None:
    tally.starts += 1
    try:
        found = cell.centre(start) if drawn else cell.centre_on_truth(start)
    except RonnaError as problem:
        tally.failures.append(str(problem))
        return
    error = cell.true_offset_mm(found, start.fiducial)
    # the retreat was one more motion after the measurement
    rest = cell.rest_error_mm(found.joints_rad, cell.arm.motions - 1)
    tally.steps.append(len(found.residuals_mm) - 1)
    tally.residuals_mm.append(found.residuals_mm[-1])
    tally.errors_mm.append(float(np.linalg.norm(error)))
    tally.beyond_mm.append(float(np.linalg.norm(error + rest)))
