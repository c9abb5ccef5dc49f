"""Registration of a scan by the methods of the thesis' chapter 2, to be compared with ours.

Principal axes and iterative closest points (PCA, ICP) pair points, so they need samples of the surface, and
they say nothing about their error.
"""

from __future__ import annotations

from procedures.registration.cloud_registration import register_clouds
from procedures.registration.surface.scan import SurfaceScan
from procedures.registration.surface.starts import Start
from procedures.registration.surface.surface import Surface
from ronna_hw.frames import Frame, Transform


def register_by_closest_points(
    scan: SurfaceScan, surface: Surface, start: Start | None = None, *, overlap: float = 1.0
) -> Transform:
    """Return the pose robot <- CT by closest points; without a start, from the principal axes.

    `overlap` is the share of the scan that is taken as the head's. Raises as `register_clouds`.
    """
    begun = None if start is None else start.robot_from_ct.inverse()
    fit = register_clouds(scan.points_mm, surface.points_mm, start=begun, overlap=overlap)
    return Transform(Frame.CT, Frame.ROBOT, fit.transform).inverse()
