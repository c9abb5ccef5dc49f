"""Result of a scan of the clamped head, made up."""

from __future__ import annotations

import numpy as np

from procedures.fusion.record import FusedPose
from procedures.imaging.markers import Marker
from procedures.steps.clinical.fiducial_localization import IntraoperativeSpheres, ScannedSphere
from ronna_hw.vectors import vector3

SCAN_SIGMA_MM = 0.02
PLACE_SIGMA_MM = 0.1


def scanned_spheres() -> IntraoperativeSpheres:
    marker = Marker(
        centre_mm=(10.0, 0.0, 90.0),
        covariance_mm2=tuple(tuple(row) for row in (SCAN_SIGMA_MM**2 * np.eye(3)).tolist()),
        radius_mm=5.75,
        quality=1.0,
        agreement_mm=0.01,
        flags=(),
        odds=1.0,
    )
    spheres = tuple(
        ScannedSphere(
            fiducial=index,
            in_scan_mm=(1.0, 2.0, 3.0),
            sigma_mm=0.03,
            is_cut=False,
            moved_mm=0.7,
            agrees=False,
        )
        for index in range(4)
    )
    unit = np.eye(6) * ([1e-3] * 3 + [PLACE_SIGMA_MM] * 3)
    return IntraoperativeSpheres(
        series_instance_uid="1.2.3",
        diameter_mm=11.5,
        markers=(marker,) * 4,
        doubtful=(),
        ct_from_scan=FusedPose(translation_mm=(1.0, 2.0, 3.0), quaternion_wxyz=(1.0, 0.0, 0.0, 0.0)),
        files_sha256="0" * 64,
        place_middle_mm=(0.0, 0.0, 0.0),
        place_turns_rad=tuple(map(vector3, unit[:, :3])),
        place_shifts_mm=tuple(map(vector3, unit[:, 3:])),
        bone_agreement=0.95,
        agreeing_starts=6,
        starts=6,
        spheres=spheres,
        expected_mm={"T1": 0.17},
    )
