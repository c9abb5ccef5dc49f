"""One scan: contents of the field, voxel grid, and truth beyond the scene."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from sim.phantom.head.anatomy import Anatomy, draw_anatomy
from sim.phantom.head.frame_markers import FREE, XFRAME, XFRAME_CLOSE, frame_markers, frame_shapes
from sim.phantom.scanner.faults import NO_FAULTS, ScannerFaults
from sim.phantom.scanner.grid import CtGrid, place_grid
from sim.world.noise import noise
from sim.world.scene.model import Scene

__all__ = ["FREE", "XFRAME", "XFRAME_CLOSE", "Scan", "plain_scan"]


@dataclass(frozen=True)
class Scan:
    """Everything to paint. `truth` is added to the truth file, `marks` (by number) to its fiducials."""

    scene: Scene
    grid: CtGrid
    anatomy: Anatomy
    fiducials: str = FREE
    truth: dict[str, Any] = field(default_factory=dict)
    marks: dict[int, dict[str, Any]] = field(default_factory=dict)
    faults: ScannerFaults = NO_FAULTS


def plain_scan(scene: Scene) -> Scan:
    """The scan of a scene as it is; raises SIM-001 when the scene cannot be scanned."""
    grid, head = place_grid(scene.head, scene.ct), scene.head
    if not head.x_frame:
        return Scan(scene, grid, draw_anatomy(scene))
    generator = noise(scene.seed, "ct frame", 0)
    bare = draw_anatomy(scene.model_copy(update={"head": head.model_copy(update={"fiducials": ()})}))
    anatomy = replace(
        bare,
        surroundings=(*bare.surroundings, *frame_shapes(head, XFRAME, generator)),
        markers=frame_markers(head, generator),
    )
    return Scan(scene, grid, anatomy, XFRAME)
