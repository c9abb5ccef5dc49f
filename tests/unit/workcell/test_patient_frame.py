"""Readings relative to the frame on the head clamp: only what the tracker shows since it rests counts."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike

from procedures.journal.errors import GateFailed
from procedures.workcell.patient_frame import hold_to_patient_frame, require_in_view
from procedures.workcell.tracker_look import FRAMES, mean_pose
from ronna_hw.devices.readings import Stamp, StrayReading, ToolReading, TrackerFrame, Validity
from ronna_hw.devices.strays import average_strays
from ronna_hw.frames import Frame, Transform
from ronna_hw.patient_frame import MARKERS_MM, NAME

ARM = "robot_frame"
SPHERES_MM = np.array([[0.0, 0.0, -2000.0], [60.0, 0.0, -2010.0], [0.0, 50.0, -2020.0]])
CLAMP = Transform.of(Frame.TRACKER, Frame.MARKER, translation_mm=(200.0, 0.0, -2000.0))
ON_ARM = Transform.of(Frame.TRACKER, Frame.MARKER, translation_mm=(0.0, 500.0, -1900.0))
STILL = Transform.of(Frame.TRACKER, Frame.TRACKER)
PUSHED = Transform.of(
    Frame.TRACKER, Frame.TRACKER, translation_mm=(9.0, -4.0, 6.0), quaternion_wxyz=(1.0, 0.002, 0.0, 0.003)
)


def reading(name: str, pose: Transform | None) -> ToolReading:
    if pose is None:
        return ToolReading(name, Validity.MISSING, None, None, None)
    w, qx, qy, qz = pose.quaternion_wxyz.tolist()
    x, y, z = pose.translation_mm.tolist()
    return ToolReading(name, Validity.OK, (w, qx, qy, qz), (x, y, z), 0.1)


def seen(pushed: Transform = STILL, *, hidden: bool = False, arm_mm: ArrayLike = (0, 0, 0)) -> TrackerFrame:
    """A frame as the tracker sees it that was pushed so far; the arm may have moved in the room."""
    tools = (
        reading(ARM, pushed @ ON_ARM.displace(arm_mm)),
        reading(NAME, None if hidden else pushed @ CLAMP),
    )
    places = pushed.apply(SPHERES_MM).tolist()
    strays = tuple(StrayReading((x, y, z), Validity.OK) for x, y, z in places)
    return TrackerFrame(Stamp(0, 0, 0.0), Validity.OK, tools, strays)


def test_a_reading_at_rest_is_left_as_it_is() -> None:
    frames = [seen()] * FRAMES
    held, pose, pushed = hold_to_patient_frame(frames, NAME, MARKERS_MM, ARM)
    assert (held, pushed) == (frames, False)
    assert pose.source is Frame.PATIENT
    assert pose.translation_mm == pytest.approx(CLAMP.translation_mm)


@pytest.mark.hazard(13)
@pytest.mark.parametrize("before", [16, 30, 44])
def test_a_push_during_the_reading_leaves_all_where_the_pushed_tracker_sees_it(before: int) -> None:
    frames = [seen()] * before + [seen(PUSHED)] * (FRAMES - before)
    held, pose, pushed = hold_to_patient_frame(frames, NAME, MARKERS_MM, ARM)
    groups = average_strays(held).groups
    assert (len(held), pushed) == (FRAMES - before, True)
    assert np.array([one.mean_mm for one in groups]) == pytest.approx(PUSHED.apply(SPHERES_MM), abs=1e-6)
    assert max(one.spread_mm for one in groups) < 1e-6
    on_arm = mean_pose(held, ARM, len(held))
    assert on_arm is not None
    assert on_arm.translation_mm == pytest.approx((PUSHED @ ON_ARM).translation_mm)
    assert pose.translation_mm == pytest.approx((PUSHED @ CLAMP).translation_mm)


def test_a_tracker_that_moves_until_the_end_counts_as_pushed() -> None:
    assert hold_to_patient_frame([seen()] * 50 + [seen(PUSHED)] * 10, NAME, MARKERS_MM, ARM).pushed


def test_a_single_frame_that_shows_the_clamp_elsewhere_is_left_out_and_is_no_push() -> None:
    frames = [seen()] * 30 + [seen(PUSHED)] + [seen()] * 29
    held, _, pushed = hold_to_patient_frame(frames, NAME, MARKERS_MM, ARM)
    assert (len(held), pushed) == (FRAMES - 1, False)


def test_frames_in_the_midst_of_a_push_are_left_out() -> None:
    ways = [Transform.of(Frame.TRACKER, Frame.TRACKER, translation_mm=(3.0 * k, 0.0, 0.0)) for k in range(10)]
    held, _, pushed = hold_to_patient_frame(
        [*[seen()] * 25, *map(seen, ways[1:]), *[seen(ways[-1])] * 25], NAME, MARKERS_MM, ARM
    )
    assert (len(held), pushed) == (26, True)  # one of those under way is where the tracker comes to rest


@pytest.mark.hazard(12)
@pytest.mark.parametrize(
    ("frames", "said"),
    [
        (
            [seen()] * 30 + [seen(PUSHED, arm_mm=(0.0, 1.5, 0.0))] * 30,
            r"clamp and the arm moved against each other.*limit 1 mm, got 1\.50",
        ),
        (
            [seen(hidden=True)] * 40 + [seen()] * 20,
            f"PRO-007: the reference frame {NAME} is in 20 of 60 frames",
        ),
    ],
    ids=["a clamp that moves against the arm", "a hidden frame"],
)
def test_a_reading_that_cannot_be_held_to_the_frame_is_refused(frames: list[TrackerFrame], said: str) -> None:
    with pytest.raises(GateFailed, match=said):
        hold_to_patient_frame(frames, NAME, MARKERS_MM, ARM)


class Cell:
    patient_frame: str | None = NAME


def test_at_the_clamp_a_hidden_frame_is_named_with_what_to_do() -> None:
    cell = Cell()
    require_in_view(cell, [seen()] * 12)  # type: ignore[arg-type]
    with pytest.raises(GateFailed, match=r"does not see the frame on the head clamp.*got 0.*Turn it.*rom"):
        require_in_view(cell, [seen(hidden=True)] * 12)  # type: ignore[arg-type]
    cell.patient_frame = None
    require_in_view(cell, [seen(hidden=True)] * 12)  # type: ignore[arg-type]
