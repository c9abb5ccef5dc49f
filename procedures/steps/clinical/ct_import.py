"""CT import: read the series, check its geometry, record its identity."""

from __future__ import annotations

import hashlib
from concurrent.futures import ThreadPoolExecutor

from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.imaging.dicom.slice_headers import list_dicom_files
from procedures.imaging.errors import KERNEL_UNNAMED
from procedures.imaging.series import read_series
from procedures.imaging.volume import Volume
from procedures.journal.errors import GateFailed
from procedures.journal.results import Matrix3, StepResult
from procedures.steps.conditions import needs_guide_unmounted
from ronna_hw.calibration import Numbers3


class ImportedCt(StepResult, kind="ct_import"):
    """Identity and geometry of the CT series."""

    series_instance_uid: str = Field(description="DICOM UID of the series.")
    frame_of_reference_uid: str = Field(description="DICOM UID of its patient coordinate system.")
    patient_position: str = Field(description="As DICOM names it, such as HFS.")
    shape: tuple[int, int, int] = Field(description="Slices, rows, columns.")
    spacing_mm: Numbers3 = Field(description="Between slices, rows, columns.")
    origin_mm: Numbers3 = Field(description="Centre of the first voxel, LPS.")
    axes: Matrix3 = Field(description="Directions of slices, rows and columns in LPS.")
    kernel: str = Field(default="", description="Reconstruction kernel, as the scanner names it.")
    voxels_sha256: str = Field(description="SHA-256 of the voxels in HU.")
    warnings: tuple[str, ...] = Field(description="Warnings of the import.")
    study_instance_uid: str = Field(
        default="", description="DICOM UID of the study; empty if not stated, or in a record without it."
    )

    @classmethod
    def from_volume(cls, volume: Volume) -> ImportedCt:
        """Return the identity and geometry of a CT volume."""
        geometry = volume.geometry
        slices, rows, columns = geometry.shape
        return cls(
            series_instance_uid=volume.series_instance_uid,
            frame_of_reference_uid=volume.frame_of_reference_uid,
            patient_position=volume.patient_position,
            shape=(slices, rows, columns),
            spacing_mm=geometry.spacing_mm.tolist(),
            origin_mm=geometry.origin_mm.tolist(),
            axes=geometry.axes.tolist(),
            kernel=volume.kernel,
            voxels_sha256=hashlib.sha256(volume.voxels.data).hexdigest(),
            warnings=tuple(volume.warnings),
            study_instance_uid=volume.study_instance_uid,
        )

    def names_series(self) -> str:
        return self.series_instance_uid

    def differences(self, volume: Volume) -> str:
        """List the recorded fields in which a series differs, such as `voxels_sha256`; empty if none."""
        now = ImportedCt.from_volume(volume)
        recorded = (name for name in type(self).model_fields if name in self.model_fields_set)
        return ", ".join(name for name in recorded if getattr(now, name) != getattr(self, name))


def run(context: StepContext) -> Outcome[ImportedCt]:
    """Read and check the series, and record its identity with the hash of its voxels.

    Raises CT-027 for a series without the name of its kernel: the registration weighs the spheres by stated
    errors, which were not checked for an unknown filter.
    """
    series = context.clinical.series
    with ThreadPoolExecutor(1) as pool:  # hashing leaves the interpreter to the reader most of the time
        noting = pool.submit(lambda: context.note_inputs(*list_dicom_files(series)))
        volume = read_series(series, progress=lambda share: context.progress(share, "reading the CT series"))
        noting.result()
    if not volume.kernel:
        raise KERNEL_UNNAMED(
            f"series {volume.series_instance_uid} does not name its reconstruction kernel",
            expected="ConvolutionKernel (0018,1210), such as B30f or H60s",
            got="none",
        )
    context.setting.memory.keep(volume)
    imported = ImportedCt.from_volume(volume)
    slices, rows, columns = imported.shape
    return Outcome(
        imported, summary=f"{slices} slices of {columns} x {rows}, {imported.spacing_mm[0]:g} mm apart"
    )


def volume_of(context: StepContext) -> Volume:
    """Return the imported CT, reread from its folder if it is not in memory.

    Raises PRO-007 if the folder no longer holds the imported series.
    """
    imported = context.result(ImportedCt)
    kept = context.setting.memory.find(Volume)
    if kept is not None:
        return kept
    volume = read_series(context.clinical.series)
    if changed := imported.differences(volume):
        raise GateFailed(
            f"the CT series has changed since it was imported: {changed}",
            expected=imported.series_instance_uid,
            got=volume.series_instance_uid,
            action="Import the series again: run ct_import.",
        )
    return volume


STEP = StepSpec(
    ImportedCt, "Import the CT series", Phase.PREOPERATIVE, run, preconditions=needs_guide_unmounted
)
