"""Reads a DICOM CT series from a folder and validates its geometry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.dicom.frame_decoder import FrameDecoder
from procedures.imaging.dicom.slice_headers import Progress, read_headers
from procedures.imaging.dicom.slice_pixels import read_pixels_into
from procedures.imaging.dicom.slice_stack import accuracy_warnings, stack_slices
from procedures.imaging.slice_motion import motion_warnings
from procedures.imaging.volume import Volume

HEADER_SHARE = 0.4  # of the reading time
AIR_BELOW_HU = -500  # every head is surrounded by air


def read_series(directory: Path, *, progress: Progress | None = None) -> Volume:
    """Read the CT series whose files lie directly in `directory`.

    Returns voxels in HU with their position in patient coordinates (LPS, mm). `progress` is called
    with the fraction done. Raises CT-001 to CT-015, CT-020, CT-021, CT-023 for a series that cannot
    be trusted; nothing is guessed.
    """
    directory = Path(directory)
    headers = read_headers(directory, _part(progress, 0.0, HEADER_SHARE))
    slices, geometry = stack_slices(headers)
    voxels = np.empty(geometry.shape, dtype=np.int16)
    report = _part(progress, HEADER_SHARE, 1.0)
    with FrameDecoder() as decoder:
        for number, header in enumerate(slices):
            read_pixels_into(voxels[number], header, decoder)
            report((number + 1) / len(slices))
    voxels.flags.writeable = False
    return Volume(
        voxels=voxels,
        geometry=geometry,
        series_instance_uid=slices[0].series_instance_uid,
        frame_of_reference_uid=slices[0].frame_of_reference_uid,
        patient_position=slices[0].patient_position,
        warnings=(
            *accuracy_warnings(slices, geometry),
            *_intensity_warnings(voxels),
            *motion_warnings(voxels, geometry),
        ),
    )


def _intensity_warnings(voxels: NDArray[np.int16]) -> tuple[str, ...]:
    darkest = int(voxels.min())
    if darkest <= AIR_BELOW_HU:
        return ()
    return (f"no air in the scan, the darkest voxel has {darkest} HU: these may not be Hounsfield units",)


def _part(progress: Progress | None, start: float, end: float) -> Progress:
    def report(share: float) -> None:
        if progress is not None:
            progress(start + (end - start) * share)

    return report
