"""Planned views of a ball."""

from scipy.spatial.transform import Rotation

from procedures.calibration.pose_set import calibration_looks


def test_for_a_count_of_zero_no_view_is_planned() -> None:
    assert calibration_looks(Rotation.identity(), (0.0, 0.0, 0.0), 0) == ()
