import numpy as np
import pytest
from coded_errors import raises

from ronna_hw.arguments import WrongArgument
from ronna_hw.calibration import PoseRecord
from ronna_hw.frames import FRAME_MISMATCH, Frame, Transform
from ronna_hw.tool_record import TipInHead


def test_composing_across_matching_frames_maps_points_through_both() -> None:
    robot_from_tool = Transform.of(Frame.ROBOT, Frame.TOOL, translation_mm=(1.0, 2.0, 3.0))
    half_turn = Transform.of(Frame.TOOL, Frame.MARKER, quaternion_wxyz=(0.0, 0.0, 0.0, 1.0))
    mapped = (robot_from_tool @ half_turn).apply((1.0, 0.0, 0.0))
    assert mapped == pytest.approx((0.0, 2.0, 3.0))


@pytest.mark.hazard(7)
def test_composing_across_mismatched_frames_is_refused() -> None:
    robot_from_tool = Transform.of(Frame.ROBOT, Frame.TOOL)
    with raises(FRAME_MISMATCH, match="FRM-001"):
        robot_from_tool @ Transform.of(Frame.CT, Frame.ROBOT)


@pytest.mark.parametrize(
    ("matrix", "shown"),
    [
        (np.diag([1.0, 1.0, -1.0, 1.0]), "determinant -1"),
        (np.diag([2.0, 1.0, 1.0, 1.0]), "determinant 2"),
        (np.eye(3), r"shape \(3, 3\)"),
        (np.diag([1.0, np.nan, 1.0, 1.0]), "row 2"),
    ],
)
@pytest.mark.hazard(7)
def test_a_matrix_that_is_not_a_proper_rotation_is_refused(matrix: np.ndarray, shown: str) -> None:
    with raises(FRAME_MISMATCH, match=shown):
        Transform.from_matrix(Frame.ROBOT, Frame.CT, matrix)


def test_what_is_no_array_of_numbers_is_refused() -> None:
    with pytest.raises(WrongArgument, match=r"the points.*'x'"):
        Transform.of(Frame.ROBOT, Frame.CT).apply("x")  # type: ignore[arg-type]  # wrong on purpose
    with pytest.raises(WrongArgument, match=r"the translation.*'abc'"):
        Transform.of(Frame.ROBOT, Frame.CT, translation_mm="abc")  # type: ignore[arg-type]  # wrong on purpose


@pytest.mark.parametrize(
    "wrong",
    [{"translation_mm": (np.nan, 0.0, 0.0)}, {"quaternion_wxyz": (1e200, 1e200, 0.0, 0.0)}],
    ids=["a translation that is no number", "a quaternion beyond all numbers"],
)
@pytest.mark.hazard(7)
def test_non_finite_values_are_refused(wrong: dict[str, tuple[float, ...]]) -> None:
    with raises(FRAME_MISMATCH):
        Transform.of(Frame.ROBOT, Frame.CT, **wrong)


def test_a_long_chain_of_transforms_stays_rigid() -> None:
    step = Transform.of(
        Frame.ROBOT, Frame.ROBOT, translation_mm=(0.3, -0.2, 0.1), quaternion_wxyz=(0.9, 0.1, -0.3, 0.2)
    )
    chain = step
    for _ in range(1000):
        chain = chain @ step
    turned = chain.rotation_matrix
    assert turned @ turned.T == pytest.approx(np.eye(3), abs=1e-12)


def test_the_inverse_swaps_frames_and_undoes_the_motion() -> None:
    transform = Transform.of(
        Frame.ROBOT, Frame.CT, translation_mm=(10.0, -4.0, 2.0), quaternion_wxyz=(0.9, 0.1, -0.3, 0.2)
    )
    both = transform @ transform.inverse()
    assert (both.target, both.source) == (Frame.ROBOT, Frame.ROBOT)
    assert both.as_matrix() == pytest.approx(np.eye(4), abs=1e-12)


def test_the_tip_in_the_stereo_head_composes_both_records() -> None:
    head, tip = (
        PoseRecord(translation_mm=(110.0, -20.0, 300.0), quaternion_wxyz=(0.5, -0.5, 0.5, 0.5)),
        PoseRecord(translation_mm=(220.0, 7.0, 60.0), quaternion_wxyz=(0.0, 0.6, 0.0, 0.8)),
    )
    found = TipInHead.of(head, tip)
    by_scipy = head.transform(Frame.FLANGE, Frame.CAMERA_LEFT).inverse() @ tip.transform(
        Frame.FLANGE, Frame.TOOL
    )
    assert found.translation_mm == pytest.approx(by_scipy.translation_mm)
    assert found.quaternion_wxyz == pytest.approx(by_scipy.quaternion_wxyz)
