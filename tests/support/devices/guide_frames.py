"""Scenes whose guide carries a frame of spheres."""

from __future__ import annotations

from ronna_hw.calibration import PoseRecord
from sim.world.rigid import matrix_from, pose_of, rotation_towards
from sim.world.scene.guide_frame import MARKERS_MM, NAME, PART_NUMBER
from sim.world.scene.model import Scene, TrackerTool

IN_TIP_MM = (-90.0, 0.0, -265.0)  # above the upper end of the bore, beside the mount; faces up as M does


def with_guide_frame(scene: Scene) -> Scene:
    """The same scene with such a frame on its guide, and known to the tracker."""
    place: PoseRecord = pose_of(matrix_from(IN_TIP_MM, rotation_towards((0.0, 0.0, -1.0), (1.0, 0.0, 0.0))))
    guide = scene.mount.guide.model_copy(update={"tip_from_frame": place})
    tool = TrackerTool(name=NAME, part_number=PART_NUMBER, markers_mm=MARKERS_MM)
    return scene.model_copy(
        update={
            "mount": scene.mount.model_copy(update={"guide": guide}),
            "tracker": scene.tracker.model_copy(update={"tools": (*scene.tracker.tools, tool)}),
        }
    )
