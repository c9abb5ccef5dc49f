"""The two-way table: each fiducial is sought in the room, each reading is sought in the CT."""

from __future__ import annotations

import numpy as np
import pytest
from coded_errors import raises

from procedures.registration import RoomPoint, match, register, verify_two_way
from procedures.registration.errors import BAD_POINTS


@pytest.fixture
def case(random, fiducials, any_pose):
    """Five fiducials; the tracker sees four of them and a stray, the stereo head measured the four."""
    image, room = fiducials(5, random), any_pose(random)
    tracker = np.vstack([room.apply(image[:4]) + 0.1, [room.apply([300.0, 300.0, 300.0])]])[[4, 2, 0, 3, 1]]
    found = match(image, tracker, sigma_image_mm=0.17, sigma_physical_mm=0.56)
    stereo = [RoomPoint(k, tuple(room.apply(image[k]))) for k in (0, 1, 2, 3)]
    fine = register(image[:4], [point.position_mm for point in stereo])
    table = verify_two_way(
        image,
        tracker,
        found.pairs,
        found.transform,
        fine=fine,
        stereo=stereo,
        ct_disagreement_mm={0: 0.01, 1: 0.02},
    )
    return found, fine, table


def test_each_fiducial_carries_the_evidence_of_every_instrument(case):
    found, fine, table = case
    row = table.ct_to_room[1]
    assert row.ct_disagreement_mm == 0.02
    assert (row.fiducial, row.tracker_index) in {(int(i), int(j)) for i, j in found.pairs}
    assert row.tracker_residual_mm < 0.2
    assert row.stereo_residual_mm == pytest.approx(np.linalg.norm(fine.residuals_mm[1]))
    assert row.leave_one_out_mm == fine.leave_one_out_mm[1]
    assert row.partner_is_nearest


def test_a_missing_measurement_is_none_and_unmatched_points_are_named_on_either_side(case):
    table = case[2]
    assert table.ct_to_room[2].ct_disagreement_mm is None
    missing = table.ct_to_room[4]
    assert (missing.tracker_index, missing.stereo_residual_mm, missing.partner_is_nearest) == (None,) * 3
    assert table.unmatched_ct == (4,)
    assert [(str(instrument), index) for instrument, index in table.unmatched_room] == [("tracker", 0)]


def test_spheres_beside_the_skin_have_what_was_measured_with_it(random, fiducials, any_pose):
    image, room = fiducials(3, random), any_pose(random)
    alone = verify_two_way(image, room.apply(image[:2]), [[0, 0], [1, 1]], room)
    table = alone.beside_skin({0: 0.12, 2: 0.05}, {0: 0.2, 2: 0.1})
    assert [row.stereo_residual_mm for row in table.ct_to_room] == [0.12, None, 0.05]
    assert [row.leave_one_out_mm for row in table.ct_to_room] == [0.2, None, 0.1]
    assert (alone.unmatched_ct, table.unmatched_ct) == ((2,), ())


def test_readings_are_mapped_back_into_the_ct(case):
    table = case[2]
    assert len(table.room_to_ct) == 5 + 4
    stray, paired = table.room_to_ct[0], table.room_to_ct[1]
    assert stray.fiducial is None
    assert stray.distance_mm > 100.0
    assert paired.nearest_fiducial == paired.fiducial
    assert paired.distance_mm < 0.2
    assert table.agrees_both_ways


def test_a_wrong_pairing_disagrees(random, fiducials, any_pose):
    image, room = fiducials(4, random), any_pose(random)
    table = verify_two_way(image, room.apply(image), [[0, 1], [1, 0], [2, 2], [3, 3]], room)
    assert not table.agrees_both_ways
    assert [row.partner_is_nearest for row in table.ct_to_room] == [False, False, True, True]


def test_nothing_to_compare_gives_an_empty_table(any_pose, random):
    table = verify_two_way([], [], [], any_pose(random))
    assert table.ct_to_room == table.room_to_ct == ()


@pytest.mark.parametrize(
    "wrong", [{"pairs": [[0, 9]]}, {"pairs": [[-1, 0]]}, {"stereo": [RoomPoint(9, (0.0, 0.0, 0.0))]}]
)
def test_indices_of_absent_points_are_refused(wrong, random, fiducials, any_pose):
    image, room = fiducials(4, random), any_pose(random)
    options = {"pairs": [[0, 0]], "stereo": (), **wrong}
    with raises(BAD_POINTS, match="REG-001"):
        verify_two_way(image, room.apply(image), options["pairs"], room, stereo=options["stereo"])


def test_measurements_and_registration_must_belong_together(random, fiducials, any_pose):
    image, room = fiducials(4, random), any_pose(random)
    with raises(BAD_POINTS, match="REG-001"):
        verify_two_way(image, room.apply(image), [], room, fine=register(image, room.apply(image)))
