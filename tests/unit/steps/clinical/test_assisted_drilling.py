"""Drilling by the assistant: depths, a breakthrough against the CT, and what the operator decides."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import pytest

from procedures.engine.context import StepContext
from procedures.journal.errors import GateFailed
from procedures.operator.question import NO, YES, Topic
from procedures.planning.errors import MetalInSkull
from procedures.planning.skull_section import SkullSection
from procedures.steps.clinical.results import CranialOpening, FeedEnd
from procedures.steps.clinical.two_arms import assisted_drilling
from procedures.steps.clinical.two_arms.assisted_drilling import drill_with_assistant
from procedures.steps.clinical.two_arms.drill_plan import (
    BEHIND_SKULL_MM,
    BegunOpening,
    DrillDepths,
    plan_feed,
)
from procedures.steps.clinical.two_arms.over_guide import OverGuide
from procedures.steps.clinical.two_arms.skull_opening import (
    EARLY_MM,
    LATE_MM,
    accept_opening,
    add_feed,
    describe_opening,
    find_doubt,
    require_bone,
)
from procedures.steps.clinical.work_progress import DepthStop
from ronna_hw.arm.errors import ForceLimitExceeded
from ronna_hw.devices.contact import Drilled
from ronna_hw.errors import RonnaError

INSIDE_MM = 12.5
DEPTHS = DrillDepths(SkullSection(5.7, INSIDE_MM), 100.0)
TWO_READINGS = DrillDepths(SkullSection(5.7, 7.6, "a gap", 12.5), 100.0)
STOP = DepthStop(bore_mm=80.0, standoff_mm=10.0, depth_mm=60.0, computed_mm=150.0, read_mm=150.0)
OVER = OverGuide(cast("Any", None), 0.04, 0.0, None)


def fed(*, fell: bool = True, met_bone: bool = True, free_mm: float = 0.0) -> Drilled:
    """A feed, as the arm tells of it."""
    return Drilled(
        joints_rad=(0.0,) * 6,
        peak_force_N=15.0 if met_bone else 1.4,
        side_force_N=0.5,
        met_bone=met_bone,
        broke_through=fell,
        free_mm=free_mm,
        drilled_s=20.0,
        slowed_s=0.0,
        forces_N=(15.0,),
    )


def unfed(depths: DrillDepths = DEPTHS) -> CranialOpening:
    """The opening before its first feed."""
    context = cast(
        "Any", SimpleNamespace(workcell=SimpleNamespace(assistant=SimpleNamespace(force_error_N=1.0)))
    )
    return assisted_drilling._build_unfed(context, depths, OVER, 30.0)


def drilled(
    depth_mm: float,
    depths: DrillDepths = DEPTHS,
    *,
    fell: bool = True,
    met_bone: bool = True,
    free_mm: float = 0.0,
    end: FeedEnd = FeedEnd.ENDED,
    before: CranialOpening | None = None,
) -> CranialOpening:
    """The opening of a feed that ended there, as nobody has judged it yet."""
    feed = fed(fell=fell, met_bone=met_bone, free_mm=free_mm)
    opening = add_feed(before or unfed(depths), feed, depth_mm, end)
    return opening.model_copy(update={"doubt": find_doubt(opening)[0]})


def test_an_opening_of_an_earlier_version_is_refused_with_a_code_and_the_fields_that_it_lacks() -> None:
    plain = drilled(60.0).model_dump(mode="json")
    assert CranialOpening.of_stage(plain, "T1") == drilled(60.0)
    del plain["force_fell"]
    with pytest.raises(RonnaError, match=r"REC-003: the opening at T1 .* another version.*force_fell"):
        CranialOpening.of_stage(plain, "T1")


class AskedContext(NamedTuple):
    """Context of a step whose questions have one answer, what was asked, found, and kept of openings."""

    context: StepContext
    asked: list[Any]
    found: list[str]
    openings: list[Any]


class FeedingAssistant(SimpleNamespace):
    """Assistant over the guide, whose feed ends with an error, or is cut off before it is known."""

    def drill(self, *_plan: object) -> None:
        self.drilled = self.feed
        raise self.error

    def drill_tip_mm(self, joints_rad: object = None) -> float:
        assert joints_rad is not None or self.feed is None
        return float(self.tip_mm)


def asked_context(
    answer: str, recorded: CranialOpening | None = None, **more_of_assistant: object
) -> AskedContext:
    asked, found, openings = list[Any](), list[str](), list[Any]()

    def choose(question: Any) -> str:
        asked.append(question)
        return answer

    stages = SimpleNamespace(
        record_opening=lambda _name, opening: openings.append(opening),
        opening_at=lambda _name: None if recorded is None else recorded.model_dump(mode="json"),
        interruption_at=lambda _name: None,
    )
    instrument = SimpleNamespace(stages=stages, record_insertion=lambda _name: None)
    assistant = FeedingAssistant(
        senses_force=True, force_error_N=1.0, drilled_mm=lambda _name: None, **more_of_assistant
    )
    planned = SimpleNamespace(trajectory=lambda _name: SimpleNamespace(trajectory=None))
    fields = {
        "trajectory": "T1",
        "choose": choose,
        "rest_drill": lambda: None,
        "progress": lambda *_args: None,
        "perform_task": lambda _task: (),
        "find": found.append,
        "result": lambda _kind: planned,
        "setting": SimpleNamespace(settings=SimpleNamespace(assistant_drills=True, drill_force_N=30.0)),
        "workcell": SimpleNamespace(master=SimpleNamespace(instrument=instrument), assistant=assistant),
    }
    return AskedContext(cast("StepContext", SimpleNamespace(**fields)), asked, found, openings)


@pytest.mark.hazard(65)
@pytest.mark.parametrize("off_mm", [-EARLY_MM + 0.1, 0.0, LATE_MM - 0.1])
def test_a_breakthrough_where_the_ct_has_the_inside_is_not_asked_about(off_mm: float) -> None:
    case = asked_context(NO)
    accepted = accept_opening(case.context, drilled(INSIDE_MM + off_mm))
    assert accepted.accepted
    assert accepted.broke_through
    assert not accepted.doubt
    assert not case.asked


@pytest.mark.hazard(65)
@pytest.mark.parametrize(
    ("fell", "depth_mm", "said"),
    [
        (True, INSIDE_MM - EARLY_MM - 0.5, r"1\.5 mm before the inside"),
        (True, INSIDE_MM + LATE_MM + 0.3, r"2\.3 mm behind the inside"),
        (False, INSIDE_MM + BEHIND_SKULL_MM, r"no breakthrough up to 15\.0 mm"),
    ],
    ids=["too early", "too late", "none"],
)
def test_a_breakthrough_elsewhere_is_for_the_operator(fell: bool, depth_mm: float, said: str) -> None:
    refused, accepted = asked_context(NO), asked_context(YES)
    with pytest.raises(GateFailed, match=said):
        accept_opening(refused.context, drilled(depth_mm, fell=fell))
    assert [question.topic for question in refused.asked] == [Topic.BREAKTHROUGH]
    assert len(refused.found) == 1
    assert not refused.openings
    opening = accept_opening(accepted.context, drilled(depth_mm, fell=fell))
    assert opening.doubt in accepted.found[0]
    assert accepted.openings[-1]["accepted"] is True


@pytest.mark.hazard(65)
def test_a_fall_in_what_may_be_the_diploe_is_no_breakthrough_and_both_readings_are_asked_about() -> None:
    opening = drilled(8.6, TWO_READINGS)
    assert opening.force_fell
    assert not opening.broke_through
    assert opening.deepest_mm == pytest.approx(7.6 + BEHIND_SKULL_MM)
    case = asked_context(YES)
    accepted = accept_opening(case.context, opening)
    assert "at 7.6 mm, or bone up to 12.5 mm, of which 3.9 mm are left" in case.asked[0].value
    words = describe_opening(accepted)
    assert words.startswith("the force fell at 8.6 mm behind the entry (inside of the skull by the CT 7.6 or")
    assert "through" not in words


@pytest.mark.hazard(65)
@pytest.mark.parametrize("answer", [YES, NO])
@pytest.mark.parametrize(
    ("before", "said"),
    [
        (drilled(11.4), "an opening was through at 11.4 mm"),
        (drilled(8.6, TWO_READINGS), "the force fell at 8.6"),
    ],
)
def test_where_the_force_fell_a_repetition_feeds_no_deeper_and_names_what_it_found(
    monkeypatch: pytest.MonkeyPatch, before: CranialOpening, said: str, answer: str
) -> None:
    monkeypatch.setattr(assisted_drilling, "volume_of", lambda _context: None)
    monkeypatch.setattr(assisted_drilling, "measure_skull", lambda *_args: DEPTHS.skull)
    closed: list[Any] = []
    monkeypatch.setattr(assisted_drilling, "close_earlier_way", closed.append)
    case = asked_context(answer, before)  # its assistant has no motions at all
    if answer == NO:
        with pytest.raises(GateFailed, match=said) as refused:
            drill_with_assistant(case.context, STOP)
        assert "drills no further there" in refused.value.action
    else:
        opening = drill_with_assistant(case.context, STOP)
        assert opening is not None
        assert opening.accepted
        assert opening.depth_mm == before.depth_mm
    assert said in case.asked[0].value
    assert len(closed) == 1


@pytest.mark.parametrize(
    ("drills", "senses", "skull", "error_N", "said"),
    [
        (False, True, DEPTHS.skull, 1.0, ""),
        (True, False, DEPTHS.skull, 1.0, "senses no force"),
        (True, True, None, 1.0, "no skull with an inside"),
        (True, True, DEPTHS.skull, 1.5, r"errs by 1.5 N"),
        (True, True, DEPTHS.skull, 0.0, "no error is stated"),
    ],
    ids=[
        "not asked for",
        "no force sensor",
        "no skull in the CT",
        "a force that errs by more than no bone",
        "a force of unknown error",
    ],
)
def test_a_hand_drills_where_the_assistant_cannot(
    monkeypatch: pytest.MonkeyPatch,
    drills: bool,
    senses: bool,
    skull: SkullSection | None,
    error_N: float,
    said: str,
) -> None:
    monkeypatch.setattr(assisted_drilling, "volume_of", lambda _context: None)
    monkeypatch.setattr(assisted_drilling, "measure_skull", lambda *_args: skull)
    found: list[str] = []
    planned = SimpleNamespace(trajectory=lambda _name: SimpleNamespace(trajectory=None))
    fields = {
        "trajectory": "T1",
        "find": found.append,
        "result": lambda _kind: planned,
        "setting": SimpleNamespace(settings=SimpleNamespace(assistant_drills=drills, drill_force_N=30.0)),
        "workcell": SimpleNamespace(
            assistant=SimpleNamespace(
                senses_force=senses, force_error_N=error_N, drilled_mm=lambda _trajectory: None
            )
        ),
    }
    assert drill_with_assistant(cast("StepContext", SimpleNamespace(**fields)), STOP) is None
    assert said in "".join(found)


@pytest.mark.hazard(65)
def test_a_hand_drills_where_the_ct_shows_metal_in_the_skull(monkeypatch: pytest.MonkeyPatch) -> None:
    def metal(*_args: object) -> None:
        raise MetalInSkull("the CT shows metal 12.5 to 14.0 mm behind the entry")

    monkeypatch.setattr(assisted_drilling, "volume_of", lambda _context: None)
    monkeypatch.setattr(assisted_drilling, "measure_skull", metal)
    case = asked_context(YES)
    assert drill_with_assistant(case.context, STOP) is None
    assert "at T1 a hand drills: PLAN-035: the CT shows metal" in case.found[-1]


@pytest.mark.hazard(66)
@pytest.mark.parametrize(
    ("begun_mm", "said"),
    [
        (None, "felt no bone; expected 4 N behind the outside"),
        (5.0, "no bone below an opening begun earlier"),
    ],
)
def test_a_drill_that_felt_no_bone_is_no_opening_and_nobody_is_asked(
    begun_mm: float | None, said: str
) -> None:
    case = asked_context(YES)
    with pytest.raises(GateFailed, match=f"{said}.*at most 1\\.4 N up to 7\\.7 mm"):
        require_bone(case.context, drilled(7.7, fell=False, met_bone=False), begun_mm)
    require_bone(case.context, drilled(INSIDE_MM), begun_mm)
    assert not case.asked


@pytest.mark.hazard(66)
@pytest.mark.parametrize(
    ("bottom_mm", "bone_by_mm"),
    [(None, 7.7), (10.0, 11.0), (13.8, 14.5)],
    ids=["first", "in bone", "near its end"],
)
def test_bone_is_felt_by_2_mm_behind_its_outside_or_1_mm_behind_an_opening_begun_in_bone(
    bottom_mm: float | None, bone_by_mm: float
) -> None:
    assert DEPTHS.bone_by_mm(bottom_mm) == pytest.approx(bone_by_mm)


STOPPED = FeedEnd.INTERRUPTED


@pytest.mark.hazard(65)
@pytest.mark.parametrize(
    ("last", "reached_mm", "said"),
    [
        (drilled(10.6, fell=False, end=STOPPED), 10.65, ""),
        (drilled(10.6, fell=False, free_mm=0.4, end=STOPPED), 10.6, "bone resisted only up to 10.2 mm"),
        (drilled(10.6, fell=False, end=STOPPED), 11.0, "bone resisted only up to 10.6 mm"),
        (drilled(7.7, fell=False, met_bone=False), 7.7, ""),
        (unfed(), None, ""),
        (unfed().model_copy(update={"end": FeedEnd.UNKNOWN}), 3.7, "how deep it went is not recorded"),
        (None, 10.6, "no record says that bone resisted"),
        (None, 3.7, ""),
        (drilled(5.0, fell=False, met_bone=False, end=STOPPED, before=drilled(9.0, fell=False)), 9.0, ""),
        (drilled(10.0, fell=False, met_bone=False, before=drilled(9.0, fell=False)), 10.0, "only up to 9.0"),
    ],
    ids=[
        "stopped in bone",
        "stopped where nothing resisted",
        "deeper since",
        "blind in the outer table",
        "nothing fed",
        "end not recorded",
        "an earlier version",
        "switched on only",
        "stopped again above the bottom",
        "no bone below the bottom",
    ],
)
def test_an_opening_is_fed_on_only_where_bone_resisted_to_its_end_and_else_goes_to_a_hand(
    last: CranialOpening | None, reached_mm: float | None, said: str
) -> None:
    begun = BegunOpening.of(reached_mm, last)
    assert begun is not None
    why = begun.why_by_hand(DEPTHS)
    assert said in why
    assert bool(said) == bool(why)
    limits = plan_feed(DEPTHS, 30.0, begun).limits
    if last is not None and last.resisted_mm is not None:
        assert limits.bone_from_mm == pytest.approx(DEPTHS.deepest_mm - begun.depth_mm)
    else:
        assert limits.bone_from_mm == 0.0


@pytest.mark.hazard(65)
@pytest.mark.parametrize(
    ("feed", "tip_mm", "ends", "why"),
    [
        (fed(fell=False, free_mm=0.4), 10.6, FeedEnd.INTERRUPTED, "only up to 10.2"),
        (fed(fell=False), 10.6, FeedEnd.INTERRUPTED, ""),
        (None, DEPTHS.from_mm, FeedEnd.INTERRUPTED, ""),
        (None, 10.6, FeedEnd.UNKNOWN, "not recorded"),
    ],
    ids=["in the open", "in bone", "not begun", "not told"],
)
@pytest.mark.parametrize("error", [ForceLimitExceeded("pushed aside"), KeyboardInterrupt()])
def test_a_feed_is_recorded_before_it_begins_and_however_it_ends(
    monkeypatch: pytest.MonkeyPatch,
    error: BaseException,
    feed: Drilled | None,
    tip_mm: float,
    ends: FeedEnd,
    why: str,
) -> None:
    monkeypatch.setattr(assisted_drilling, "volume_of", lambda _context: None)
    monkeypatch.setattr(assisted_drilling, "measure_skull", lambda *_args: DEPTHS.skull)
    monkeypatch.setattr(assisted_drilling, "bring_over_guide", lambda *_args: OVER)
    monkeypatch.setattr(assisted_drilling, "guided_stretch", lambda *_args: None)
    case = asked_context(
        YES,
        drilled=None,
        axis_in_base=lambda axis: axis,
        lead_in=lambda *_args: None,
        record_drill=lambda **_state: None,
        feed=feed,
        tip_mm=tip_mm,
        error=error,
    )
    with pytest.raises(type(error)):
        drill_with_assistant(case.context, STOP)
    before, after = map(CranialOpening.model_validate, case.openings)
    assert (before.end, after.end) == (FeedEnd.UNKNOWN, ends)
    begun = BegunOpening.of(None, after)
    assert begun is not None
    assert why in begun.why_by_hand(DEPTHS)
    assert bool(why) == bool(begun.why_by_hand(DEPTHS))


@pytest.mark.hazard(65)
def test_an_opening_that_may_be_through_goes_to_a_hand_once_the_drill_is_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(assisted_drilling, "volume_of", lambda _context: None)
    monkeypatch.setattr(assisted_drilling, "measure_skull", lambda *_args: DEPTHS.skull)
    closed: list[Any] = []
    monkeypatch.setattr(assisted_drilling, "close_earlier_way", closed.append)
    case = asked_context(YES, drilled(10.6, fell=False, free_mm=0.4, end=STOPPED))
    assert drill_with_assistant(case.context, STOP) is None  # its assistant has no motions at all
    assert len(closed) == 1
    assert "a hand drills: drilling was begun there" in case.found[-1]
    assert "THE SKULL MAY BE OPEN" in case.found[-1]
