"""One scan: contents of the field, voxel grid, and the truth beyond the scene."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from sim.phantom.head.anatomy import Anatomy, draw_anatomy
from sim.phantom.scanner.faults import NO_FAULTS, ScannerFaults
from sim.phantom.scanner.grid import CtGrid, place_grid
from sim.theatre.scene.model import Scene

FREE, XFRAME, XFRAME_CLOSE = "free", "xframe", "xframe-close"


@dataclass(frozen=True)
class Scan:
    """Everything to paint. `truth` is added to the truth file, `marks` (by number) to the fiducials in it."""

    scene: Scene
    grid: CtGrid
    anatomy: Anatomy
    fiducials: str = FREE
    truth: dict[str, Any] = field(default_factory=dict)
    marks: dict[int, dict[str, Any]] = field(default_factory=dict)
    faults: ScannerFaults = NO_FAULTS


def plain_scan(scene: Scene) -> Scan:
    """The scan of a scene as it is; raises SIM-001 when the scene cannot be scanned."""
    return Scan(scene, place_grid(scene.head, scene.ct), draw_anatomy(scene))
