"""Import the CT: read the series, check its geometry, remember which one it is."""

from __future__ import annotations

import hashlib

from procedures.engine.step import Outcome, StepContext, StepSpec
from procedures.imaging.series import read_series

VOLUME = "volume"  # its name in the workspace


def run(context: StepContext) -> Outcome:
    """Read and check the series; the record names it and holds the hash of its voxels."""
    volume = read_series(
        context.case.series, progress=lambda share: context.progress(share, "reading the CT series")
    )
    context.workspace[VOLUME] = volume
    geometry = volume.geometry
    slices, rows, columns = geometry.shape
    return Outcome(
        payload={
            "series_instance_uid": volume.series_instance_uid,
            "frame_of_reference_uid": volume.frame_of_reference_uid,
            "patient_position": volume.patient_position,
            "shape": [slices, rows, columns],
            "spacing_mm": geometry.spacing_mm.tolist(),
            "origin_mm": geometry.origin_mm.tolist(),
            "axes": geometry.axes.tolist(),
            "voxels_sha256": hashlib.sha256(volume.voxels.data).hexdigest(),
            "warnings": list(volume.warnings),
        },
        summary=f"{slices} slices of {columns} x {rows}, {geometry.spacing_mm[0]:g} mm apart",
    )


STEP = StepSpec("ct_import", "Import the CT series", needs=(), run=run)
