"""The CT in an InVesalius project as a DICOM series, such as the head in Debian's `invesalius-examples`.

    python -m benchmarks.scans.inv3_series Cranium.inv3 FOLDER

For `ronna-campaign localization --series FOLDER`. A project keeps neither the patient's position nor the
kernel, and may have been thinned out when it was made.
"""

from __future__ import annotations

import argparse
import plistlib
import tarfile
from pathlib import Path

import numpy as np
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, generate_uid


def read_project(path: Path) -> tuple[np.ndarray, tuple[float, ...]]:
    """Return voxels (slices, rows, columns) in HU, and spacing of columns, rows and slices in mm."""
    with tarfile.open(path) as project:
        members = {Path(member.name).name: member for member in project.getmembers()}

        def content(name: str) -> bytes:
            stream = project.extractfile(members[name])
            if stream is None:
                raise FileNotFoundError(name)
            return stream.read()

        described = plistlib.loads(content("main.plist"))
        matrix = described["matrix"]
        voxels = np.frombuffer(content(matrix["filename"]), matrix["dtype"]).reshape(matrix["shape"])
    return voxels, tuple(described["spacing"])


def write_series(voxels: np.ndarray, spacing_mm: tuple[float, ...], folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    series, frame, study = generate_uid(), generate_uid(), generate_uid()
    for number, hu in enumerate(voxels):
        one = Dataset()
        one.file_meta = FileMetaDataset()
        one.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        one.file_meta.MediaStorageSOPClassUID = one.SOPClassUID = CTImageStorage
        one.file_meta.MediaStorageSOPInstanceUID = one.SOPInstanceUID = generate_uid()
        one.Modality, one.PatientName, one.PatientID = "CT", "", ""
        one.StudyInstanceUID, one.SeriesInstanceUID, one.FrameOfReferenceUID = study, series, frame
        one.InstanceNumber = number + 1
        one.Rows, one.Columns = hu.shape
        one.PixelSpacing = [f"{spacing_mm[1]:.7g}", f"{spacing_mm[0]:.7g}"]
        one.SliceThickness = f"{spacing_mm[2]:g}"
        one.ImageOrientationPatient = [1, 0, 0, 0, 1, 0]
        one.ImagePositionPatient = [0, 0, f"{number * spacing_mm[2]:g}"]
        one.SamplesPerPixel, one.PhotometricInterpretation = 1, "MONOCHROME2"
        one.BitsAllocated = one.BitsStored = 16
        one.HighBit, one.PixelRepresentation = 15, 1
        one.RescaleSlope, one.RescaleIntercept = 1, 0
        one.PixelData = hu.astype("<i2").tobytes()
        one.save_as(folder / f"{number:04d}.dcm", enforce_file_format=True)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("project", type=Path)
    parser.add_argument("folder", type=Path)
    options = parser.parse_args()
    write_series(*read_project(options.project), options.folder)


if __name__ == "__main__":
    main()
