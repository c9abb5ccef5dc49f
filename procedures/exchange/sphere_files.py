"""Writes the spheres of one localization to files, each in the format given by its extension."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.exchange.errors import NotWritable, UnknownForm
from ronna_hw.records import canonical_json, write_whole

if TYPE_CHECKING:
    from procedures.imaging import Localization, PatientIdentity

MARKUPS, JSON, CSV, DICOM = ".mrk.json", ".json", ".csv", ".dcm"


def check_names(paths: Sequence[Path]) -> None:
    """Raise EXC-001 for a file name with an unknown extension; cheap, so callers check before the work."""
    for path in paths:
        if not path.name.endswith((MARKUPS, JSON, CSV, DICOM)):
            raise UnknownForm(f"cannot tell the format of {path.name}")


def write_spheres(found: Localization, paths: Sequence[Path], patient: PatientIdentity | None = None) -> None:
    """Write the spheres to each of the files; only DICOM files name the `patient`.

    Raises EXC-001, EXC-002.
    """
    check_names(paths)
    if not paths:
        return
    from procedures.exchange.dicom_object import Origin, name_patient, write
    from procedures.exchange.plain_files import document, slicer_markups, table
    from procedures.exchange.run_export import fiducials
    from procedures.exchange.spatial_fiducials import spatial_fiducials

    markers = [marker.document() for marker in found.markers]
    spheres = fiducials(found.markers)
    key = hashlib.sha256(canonical_json(markers)).hexdigest()
    origin = Origin(found.series_instance_uid, found.frame_of_reference_uid, datetime.now(UTC), key)
    for path in paths:
        if path.name.endswith(DICOM):
            made = spatial_fiducials(spheres, origin)
            if patient is not None:
                name_patient(made, patient.name, patient.identifier, patient.birth_date, patient.sex)
            write(made, path)
            continue
        if path.name.endswith(MARKUPS):
            text = slicer_markups(spheres)
        else:
            text = document(markers, origin) if path.name.endswith(JSON) else table(spheres)
        try:
            write_whole(path, text.encode())
        except OSError as error:
            raise NotWritable(f"cannot write {path}: {error.strerror}") from error
