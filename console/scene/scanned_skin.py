"""Skin in the scene that a scan is planned for: what is covered so far, and what is not."""

from __future__ import annotations

from typing import Any

import numpy as np

from console.scene.bodies import METRES, Point
from procedures.engine.case_view import CaseView
from procedures.engine.events import ScanProgress
from procedures.reporting.case_figures import CaseFigures
from ronna_hw.frames import Transform

COVERED, MISSING = "#42d392", "#ff5fa2"  # as the stereo head and the plan
COVERED_MM, MISSING_MM = 4.0, 2.5  # size of a place, so that colour alone does not tell
BEFORE_THE_FACE_MM = np.array([0.0, -550.0, 140.0])  # in the CT


def shown_scan(view: CaseView, figures: CaseFigures | None) -> ScanProgress | None:
    """Return the scan under way, else the one that is valid; None before the first."""
    if view.scan is not None:
        return view.scan
    scan = None if figures is None or figures.surface is None else figures.surface.scan
    return None if scan is None else scan.progress


class ScannedSkin:
    """Places of the planned skin in a scene. Sends only changes."""

    def __init__(self, scene: Any) -> None:
        self._scene = scene
        self._clouds: list[Any] = []
        self._shown: object = None
        self.camera: tuple[Point, Point] | None = None  # place and aim, robot frame; None: nothing is shown

    def show(self, scan: ScanProgress | None, robot_from_ct: Transform | None) -> None:
        """Show a scan on the head where it is, if both are known."""
        if (scan, robot_from_ct) == self._shown:
            return
        self._shown = scan, robot_from_ct
        for cloud in self._clouds:
            cloud.delete()
        self._clouds, self.camera = [], None
        if scan is None or robot_from_ct is None or not (planned_mm := scan.covered_mm + scan.missing_mm):
            return
        for places_mm, colour, size_mm in (
            (scan.covered_mm, COVERED, COVERED_MM),
            (scan.missing_mm, MISSING, MISSING_MM),
        ):
            if places_mm:
                points = (robot_from_ct.apply(places_mm) * METRES).tolist()
                cloud = self._scene.point_cloud(points, point_size=size_mm * METRES)
                self._clouds.append(cloud.material(colour))
        middle_mm = np.mean(planned_mm, axis=0)
        (a, b, c), (x, y, z) = robot_from_ct.apply([middle_mm + BEFORE_THE_FACE_MM, middle_mm]).tolist()
        self.camera = (a, b, c), (x, y, z)
