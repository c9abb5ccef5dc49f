"""Hazards 12 and 13: head, cart or tracker move after the localization, and the case detects it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from clinical_case import FIRST, SPHERES_MM, ClinicalCell, SeeingTracker
from coded_errors import raises
from prepared_results import (
    checked_paths,
    checked_plan,
    checked_tool,
    coarse,
    localized_fiducials,
    mounted_guide,
    registered_robot,
)
from room_trials import FLANKS, STILL, TrackedCase
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.engine.engine import Engine
from procedures.guards.errors import BaseShifted, PatientMoved, PatientUnseen
from procedures.guards.room_motion import NEAR_HEAD_MM
from procedures.guards.room_reading import CAREFUL_FRAMES, RoomReading, find_ghosts, room_reading
from procedures.guards.room_watch import RoomWatch
from procedures.journal.results import StepResult
from procedures.registration.movement import NEAR_MM
from procedures.steps.clinical import positioning, relocalization
from procedures.steps.clinical.room import require_unmoved
from procedures.workcell import MountedTool
from procedures.workcell.tracker_look import read_frames_at_rest
from ronna_hw.arrays import Array
from ronna_hw.errors import LinkTimeout
from ronna_hw.frames import Frame, Transform
from ronna_hw.roles import ASSISTANT
from ronna_hw.vectors import JointVector
from sim.polaris.measurement.optics import EYES_MM, phantoms
from sim.world.rigid import matrix_from

SCENES = 50
TRIALS_PER_SCENE = 20
HEAD_MM, CART_MM = 0.5, 1.7


def trials() -> Iterator[TrackedCase]:
    """1,000 cases over 50 scenes, each with noise of its own."""
    for seed in range(SCENES):
        case = TrackedCase(seed)
        for _ in range(TRIALS_PER_SCENE):
            yield case


@pytest.mark.slow
@pytest.mark.hazard(12)
@pytest.mark.hazard(13)
def test_a_thousand_quiet_cases_raise_no_alarm() -> None:
    for case in trials():
        watch = case.begin()
        stays = int(case.generator.integers(len(case.rests)))  # there it is read again before it leaves
        for number, place in enumerate(case.rests):
            for _ in range(2 if number == stays else 1):
                assert watch.compare(case.reading(watch, place)).require() == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("head_mm", "cart_mm", "noticed"),
    [
        pytest.param(HEAD_MM, 0.0, PatientMoved, marks=pytest.mark.hazard(12)),
        pytest.param(0.0, CART_MM, BaseShifted, marks=pytest.mark.hazard(13)),
    ],
)
def test_a_shift_while_the_arm_rests_is_detected_before_the_next_motion_in_a_thousand_cases(
    head_mm: float, cart_mm: float, noticed: type[Exception]
) -> None:
    for case in trials():
        watch, way = case.begin(), case.direction()
        rest = int(case.generator.integers(len(case.rests)))
        for place in case.rests[: rest + 1]:
            watch.compare(case.reading(watch, place)).require()
        with raises(noticed):
            watch.compare(case.reading(watch, case.rests[rest], head_mm * way, cart_mm * way)).require()


@pytest.mark.hazard(13)
def test_a_moved_tracker_is_distinguished_from_a_moved_cart_and_a_moved_head() -> None:
    case = TrackedCase(3)
    way = np.array([0.0, 2.0, 0.0])
    for head_mm, cart_mm, said in ((STILL, way, "cart"), (-way, -way, "tracker"), (way, STILL, "head")):
        watch = case.begin()
        what = rf"the {said}.*(1\.9|2\.\d)\d mm.*y \+[12]\.\d\d"
        with pytest.raises((BaseShifted, PatientMoved), match=what):
            watch.compare(case.reading(watch, case.home_rad, head_mm, cart_mm)).require()


@pytest.mark.hazard(13)
@pytest.mark.parametrize("pushed_mm", [0.6, 30.0])
def test_a_moved_tracker_is_a_finding_of_a_careful_look_because_arm_and_head_agree(pushed_mm: float) -> None:
    case = TrackedCase(3)
    watch, pushed = case.begin(), matrix_from((pushed_mm, 0.0, 0.0), np.eye(3))
    true = case.true_flange(case.home_rad)
    reading = case.read(watch, case.home_rad, true, CAREFUL_FRAMES, head=pushed, cart=pushed, sides=FLANKS)
    (finding,) = watch.compare(reading).require()
    assert "the tracker was moved" in finding
    assert "head and arm agree" in finding


@pytest.mark.hazard(12)
def test_a_hidden_frame_and_too_few_spheres_are_not_compared_and_never_in_place() -> None:
    watch, reading = at_home()
    looked = watch.compare(replace(reading, frame_mm=None, groups=reading.groups[:2], frames={}), now_s=1.0)
    assert (looked.head_mm, looked.base_mm, looked.moved) == (None, None, None)
    assert not looked.in_place
    assert watch.head_sight.seen_s == 0.0  # the head counts as unseen


@pytest.mark.hazard(12)
def test_a_head_turned_about_the_middle_of_its_spheres_has_moved() -> None:
    watch, reading = at_home()
    middle = reading.spheres_mm.mean(axis=0)
    turn = Rotation.from_rotvec([0.0, 0.0, 1.0], degrees=True)
    turned = seeing(reading, middle + turn.apply(reading.spheres_mm - middle))
    with pytest.raises(PatientMoved, match="the head has moved"):
        watch.compare(turned).require()


@pytest.mark.hazard(12)
def test_a_single_displaced_sphere_is_not_reported_as_a_moved_head() -> None:
    watch, reading = at_home()
    one_mm = reading.spheres_mm
    one_mm[1] += (1.2, -0.9, 0.0)
    with pytest.raises(PatientMoved, match=r"one sphere has moved by 1\.[45] mm.*the other 4 have not"):
        watch.compare(seeing(reading, one_mm)).require()


@pytest.mark.hazard(12)
@pytest.mark.parametrize(
    ("moved_mm", "seen", "noticed", "said"),
    [
        (3.0, 2, PatientMoved, r"the head has moved since it was localized, by [23]\.\d\d mm"),
        (9.0, 1, PatientUnseen, "PRO-022.*1 sphere near the head"),
    ],
)
def test_two_displaced_spheres_suffice_to_detect_a_moved_head_and_a_single_one_is_not_ignored(
    moved_mm: float, seen: int, noticed: type[Exception], said: str
) -> None:
    watch, reading = at_home(np.array([0.0, moved_mm, 0.0]))
    with pytest.raises(noticed, match=said):
        watch.compare(replace(reading, groups=reading.groups[:seen])).require()


def at_home(head_mm: Array = STILL) -> tuple[RoomWatch, RoomReading]:
    """A watch that has just begun, and a look with the arm at home at a head that was moved by this."""
    case = TrackedCase(3)
    watch = case.begin()
    return watch, case.reading(watch, case.home_rad, head_mm)


def seeing(reading: RoomReading, spheres_mm: Array) -> RoomReading:
    """The reading with its strays at these places (m, 3)."""
    groups = tuple(replace(reading.groups[0], mean_mm=place) for place in spheres_mm)
    return replace(reading, groups=groups)


def with_crossings(reading: RoomReading, spheres_mm: Array) -> RoomReading:
    """A marker on the arm stands before the first sphere, in one plane with it and both sensors.

    One sensor sees it, the other the sphere: the tracker reports where these lines cross, and not the two.
    """
    marker = 0.93 * spheres_mm[0] + (0.0, 30.0, 0.0)
    points, seen = np.vstack([spheres_mm[:1], marker]), np.array([[True, False], [False, True]])
    crossings = phantoms(EYES_MM, points, seen, line_separation_mm=0.5)
    assert len(crossings) == 1
    seen = seeing(reading, np.vstack([reading.spheres_mm[1:3], crossings]))
    return replace(seen, markers_mm=marker[None])


@pytest.mark.hazard(12)
def test_an_intersection_of_lines_to_known_markers_is_not_taken_for_a_sphere_of_a_moved_head() -> None:
    watch, reading = at_home()
    reading = with_crossings(reading, watch.spheres_mm)
    looked = watch.compare(reading)
    assert (looked.head_mm, looked.moved, looked.findings) == (None, None, ())


@pytest.mark.hazard(12)
def test_an_intersection_of_lines_to_two_markers_on_the_arm_is_not_taken_for_a_sphere_either() -> None:
    watch, reading = at_home()
    crossing = watch.spheres_mm.mean(axis=0)
    markers = [eye + 0.86 * (crossing - eye) for eye in EYES_MM]
    crossed = replace(
        seeing(reading, np.vstack([reading.spheres_mm[:2], crossing])), markers_mm=np.array(markers)
    )
    looked = watch.compare(crossed)
    assert (looked.head_mm, looked.moved, looked.findings) == (None, None, ())


@pytest.mark.hazard(12)
def test_markers_of_the_mounted_guide_are_known_as_ends_of_lines_as_those_of_the_frame_are(
    tmp_path: Path,
) -> None:
    for mounted, known in ((MountedTool.STEREO_HEAD, 1), (MountedTool.GUIDE, 2)):
        cell = ClinicalCell(tmp_path / mounted.name).carrying(mounted)
        frames, _ = read_frames_at_rest(cell.workcell)
        reading = room_reading(
            cell.workcell, frames, Transform(Frame.ROBOT, Frame.TRACKER, RigidTransform.identity())
        )
        assert len(reading.markers_mm) == sum(map(len, list(cell.tracker.markers_mm.values())[:known]))


@pytest.mark.hazard(12)
def test_no_sphere_of_a_moved_head_is_taken_for_an_intersection_of_lines() -> None:
    generator = np.random.default_rng(12)
    for seed in range(10):
        case = TrackedCase(seed)
        watch = case.begin()
        reading = case.reading(watch, case.home_rad)
        for _ in range(100):
            moved = watch.spheres_mm + case.direction() * generator.uniform(NEAR_MM, NEAR_HEAD_MM)
            assert not find_ghosts(watch.spheres_mm, reading.markers_mm, moved).any()


def beside_its_place(watch: RoomWatch, reading: RoomReading, sphere: int, off_mm: float) -> RoomReading:
    """A marker on the arm hides a sphere from one sensor: a ghost is so far behind the sphere's place."""
    places_mm = reading.spheres_mm
    way = watch.spheres_mm[sphere] - EYES_MM[0]
    places_mm[sphere] = watch.spheres_mm[sphere] + off_mm * way / np.linalg.norm(way)
    marker = EYES_MM[1] + 0.9 * (places_mm[sphere] - EYES_MM[1])
    return replace(seeing(reading, places_mm[[sphere, 1, 2]]), markers_mm=marker[None])


@pytest.mark.hazard(12)
@pytest.mark.hazard(14)
def test_a_ghost_half_a_millimetre_from_a_hidden_sphere_is_no_moved_head_if_two_others_are_in_place() -> None:
    watch, reading = at_home()
    looked = watch.compare(beside_its_place(watch, reading, 0, 0.5))
    assert looked.moved is None
    assert looked.judged.look.spheres.numbers == (1, 2)
    watch, reading = at_home(np.array([0.0, 0.5, 0.0]))
    with pytest.raises(PatientMoved, match="the head has moved"):
        watch.compare(beside_its_place(watch, reading, 0, 0.5)).require()


@pytest.mark.hazard(12)
def test_with_a_single_other_sphere_in_view_one_that_may_be_a_ghost_still_shows_a_moved_head() -> None:
    watch, reading = at_home()
    ghost = beside_its_place(watch, reading, 0, 0.5)
    with pytest.raises(PatientMoved, match="the head has moved"):
        watch.compare(replace(ghost, groups=ghost.groups[:2])).require()


def before(cell: ClinicalCell) -> tuple[StepResult, ...]:
    return (checked_paths(cell), *coarse(), checked_plan(), localized_fiducials())


@pytest.mark.parametrize(
    ("moved", "noticed"),
    [
        pytest.param("spheres_mm", PatientMoved, marks=pytest.mark.hazard(12)),
        pytest.param("frame_shift_mm", BaseShifted, marks=pytest.mark.hazard(13)),
    ],
)
def test_nothing_moves_after_a_shift_and_the_localization_is_superseded(
    cell: ClinicalCell, moved: str, noticed: type[Exception]
) -> None:
    cell.carrying(MountedTool.STEREO_HEAD)
    engine = cell.begin(*before(cell), relocalization.STEP)
    engine.run_to(engine.order.sequence[4])
    now = np.add(SPHERES_MM, (0.5, 0.0, 0.0)) if moved == "spheres_mm" else (0.0, 1.7, 0.0)
    setattr(cell.tracker, moved, now)
    with raises(noticed):
        engine.run_to()
    assert cell.arm.motions == []
    assert [
        engine.course.status(engine.order.find(name)) for name in ("global_localization", "correspondence")
    ] == [
        "next",
        "done",  # as given: a real one descends from it and goes as well
    ]
    assert cell.entries("voided") == [("voided", "global_localization")]


@pytest.mark.hazard(12)
def test_a_head_that_moves_during_the_relocalization_voids_it(cell: ClinicalCell) -> None:
    cell.carrying(MountedTool.STEREO_HEAD)
    engine = cell.begin(*before(cell), relocalization.STEP)

    def move_the_head(_start: object, _target: object) -> bool:
        cell.tracker.spheres_mm = np.add(SPHERES_MM, (0.0, 0.5, 0.0))
        return False  # the way is clear

    cell.arm.blocked = move_the_head
    with pytest.raises(PatientMoved, match="has moved"):
        engine.run_to()
    assert not engine.case.stands(engine.order.find(f"relocalization:{FIRST}"))


def before_the_approach(cell: ClinicalCell) -> Engine:
    cell.carrying(MountedTool.GUIDE).settled()
    given = (*before(cell), registered_robot(), mounted_guide(), checked_tool())
    engine = cell.begin(*given, positioning.STEP)
    engine.run_to(engine.order.sequence[len(given) - 1])
    at_exchange = engine.context(engine.order.find(f"positioning:{FIRST}"))
    require_unmoved(at_exchange, "with the arm parked for the tool exchange")
    return engine


@pytest.mark.parametrize(
    ("name", "hidden", "shown", "said"),
    [
        pytest.param("spheres_mm", SPHERES_MM[:0], SPHERES_MM, "", marks=pytest.mark.hazard(12)),
        pytest.param("spheres_mm", SPHERES_MM[:2], SPHERES_MM, "", marks=pytest.mark.hazard(12)),
        pytest.param("hidden", True, False, "the cart may have moved", marks=pytest.mark.hazard(13)),
    ],
)
def test_no_head_is_approached_while_the_tracker_does_not_see_it_or_the_frame_on_the_arm(
    cell: ClinicalCell, name: str, hidden: object, shown: object, said: str
) -> None:
    engine = before_the_approach(cell)
    setattr(cell.tracker, name, hidden)
    with pytest.raises(PatientUnseen, match=f"PRO-022.*{said}"):
        engine.run_to()
    assert cell.arm.motions == []
    setattr(cell.tracker, name, shown)
    engine.run_step(engine.order.find(f"positioning:{FIRST}"))


@pytest.mark.hazard(58)
def test_an_assistant_whose_link_is_dead_is_not_called_hidden_from_the_tracker(cell: ClinicalCell) -> None:
    def silent() -> JointVector:
        raise LinkTimeout("its link is dead")

    engine = before_the_approach(cell)
    assistant = SimpleNamespace(
        role=ASSISTANT, name="assistant", frame="frame", leads_instrument=False, joints_rad=silent
    )
    cell.add_assistant(assistant)
    with pytest.raises(LinkTimeout, match="its link is dead"):
        require_unmoved(engine.context(engine.order.find(f"positioning:{FIRST}")), "before the approach")


@pytest.mark.hazard(12)
def test_a_jogged_arm_goes_home_and_no_further_while_the_head_is_hidden(cell: ClinicalCell) -> None:
    engine = before_the_approach(cell)
    A1, *others = cell.arm.joints_rad
    cell.arm.joints_rad = (A1 + 0.1, *others)
    cell.tracker.spheres_mm = SPHERES_MM[:2]
    with pytest.raises(PatientUnseen, match="PRO-022"):
        engine.run_to()
    assert [kind for kind, _ in cell.arm.motions] == ["joints", "joints"]  # home
    assert cell.workcell.master.place.is_home


@pytest.mark.hazard(12)
@pytest.mark.parametrize(
    ("moved", "noticed"),
    [
        (lambda tracker: setattr(tracker, "spheres_mm", np.add(SPHERES_MM, (0.0, 0.2, 0.0))), PatientMoved),
        pytest.param(
            lambda tracker: setattr(tracker, "frame_shift_mm", (0.0, 0.2, 0.0)),
            BaseShifted,
            marks=pytest.mark.hazard(13),
        ),
    ],
)
def test_a_head_or_cart_that_moved_by_little_is_noticed_before_the_approach(
    cell: ClinicalCell, moved: Callable[[SeeingTracker], None], noticed: type[Exception]
) -> None:
    engine = before_the_approach(cell)
    moved(cell.tracker)
    with raises(noticed):
        engine.run_to()
    assert cell.arm.motions == []


@pytest.mark.hazard(12)
def test_nothing_is_inserted_into_a_head_that_moved_during_the_approach(cell: ClinicalCell) -> None:
    engine = before_the_approach(cell)

    def move_the_head(_start: object, _target: object) -> bool:
        cell.tracker.spheres_mm = np.add(SPHERES_MM, (0.0, HEAD_MM, 0.0))
        return False  # the way is clear

    cell.arm.blocked = move_the_head
    with pytest.raises(PatientMoved):
        engine.run_to()
    assert [kind for kind, _ in cell.arm.motions] == ["joints"]
    assert engine.instrument_in is None
