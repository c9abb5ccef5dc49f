"""SimpleITK, which reads our transform of a fusion as 3D Slicer does."""

from __future__ import annotations

from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import SimpleITK
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.fusion.record import FusedPose, Fusion, format_itk_transform

CT_POINT_MM = (10.0, 20.0, 30.0)
CT_FROM_OTHER = RigidTransform.from_components([25.0, -5.0, 3.0], Rotation.from_rotvec([0.1, 0.2, -0.3]))


def maps_points_of_the_ct_to_the_other_series() -> None:
    pose = FusedPose.of(CT_FROM_OTHER)
    fusion = Fusion(
        schema=1,
        ct_series_uid="1.2.1",
        other_series_uid="1.2.3",
        other_frame_uid="1.2.3",
        modality="MR",
        ct_from_other=pose,
        parts=(pose, pose),
        expected_mm=0.3,
        starts=1,
        agreeing_starts=1,
        information=0.8,
        overlap=1.0,
    )
    file = Path(mkdtemp()) / "fused.tfm"
    file.write_text(format_itk_transform(fusion))
    mapped = SimpleITK.ReadTransform(str(file)).TransformPoint(CT_POINT_MM)
    assert np.allclose(CT_FROM_OTHER.apply(mapped), CT_POINT_MM)
