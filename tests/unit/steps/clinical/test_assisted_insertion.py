"""Insertion by the assistant: what it relies on."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from procedures.calibration.errors import PlatformMoved
from procedures.engine.context import StepContext
from procedures.engine.setting import CaseMemory
from procedures.guards.assistant_frame import READINGS, AssistantFrame
from procedures.guards.errors import InsertionDisturbed
from procedures.journal.errors import GateFailed
from procedures.operator.question import NO, YES
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.two_arms import assisted_insertion, base_to_base
from procedures.steps.clinical.two_arms.assisted_insertion import (
    _has_stood,
    _look_before_retreat,
    _require_bases,
    _require_seen_coaxial,
    _stands_as_presented,
    insert_with_assistant,
)
from procedures.steps.clinical.two_arms.base_to_base import require_platforms_unmoved
from procedures.workcell.arm_history import ArmPlace, PlaceKind
from procedures.workcell.tracker_look import FrameHidden
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.readings import Validity
from ronna_hw.frames import Frame, Transform

BASES = object()
AXIS = cast("Any", SimpleNamespace(arriving=None))


def context_after_a_fault(answer: str, kept: list[Any]) -> StepContext:
    fields = {
        "result_among": lambda _model, pick: pick([BASES]),
        "doubt": lambda _model: "URD-030: protective stop",
        "choose": lambda _question: answer,
        "keep": kept.append,
        "trajectory": "T1",
    }
    return cast("StepContext", SimpleNamespace(**fields))


@pytest.mark.hazard(59)
@pytest.mark.branch("KEPT_BASES")
def test_bases_from_before_a_fault_lead_no_instrument_unless_they_are_kept() -> None:
    kept: list[Any] = []
    with pytest.raises(GateFailed, match="older than a fault of an arm"):
        _require_bases(context_after_a_fault(NO, kept))
    assert not kept
    assert _require_bases(context_after_a_fault(YES, kept)) is BASES
    assert kept


SEEN_MM = (100.0, 200.0, -1500.0)


def an_assistant(*, home: bool = True) -> Any:
    return SimpleNamespace(
        place=SimpleNamespace(is_home=home), holder=SimpleNamespace(frame="assistant_frame")
    )


def the_tracker_sees(monkeypatch: pytest.MonkeyPatch, place_mm: tuple[float, float, float] | None) -> None:
    seen = None if place_mm is None else Transform.of(Frame.TRACKER, Frame.MARKER, translation_mm=place_mm)
    monkeypatch.setattr(assisted_insertion, "_see_standing", lambda *_args: seen)


def the_tracker_sees_both(monkeypatch: pytest.MonkeyPatch, see: Callable[[], list[Transform]]) -> None:
    monkeypatch.setattr(assisted_insertion, "read_localized", lambda _context: [])
    monkeypatch.setattr(assisted_insertion, "see_both_arms", lambda *_args: see())


@pytest.mark.hazard(61)
def test_an_assistant_whose_cart_was_moved_at_a_target_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    void: list[Any] = []
    ways_mm: list[list[float]] = []
    fields = {
        "trajectory": "T1",
        "void": lambda model, _reason: void.append(model),
        "workcell": SimpleNamespace(follow_assistant=lambda way_mm: ways_mm.append(list(way_mm))),
    }
    context, known = cast("StepContext", SimpleNamespace(**fields)), cast("Any", SimpleNamespace())
    known.assistant_seen_mm = SEEN_MM
    known.robot_from_tracker = SimpleNamespace(transform=Transform.of(Frame.ROBOT, Frame.TRACKER))
    the_tracker_sees(monkeypatch, (100.2, 200.0, -1500.2))
    assert _has_stood(context, an_assistant(), known)
    assert not _has_stood(context, an_assistant(home=False), known)
    the_tracker_sees(monkeypatch, (100.0, 200.9, -1500.0))
    with pytest.raises(PlatformMoved, match="CAL-023"):
        _has_stood(context, an_assistant(), known)
    assert void == [GlobalLocalization]
    assert ways_mm == [pytest.approx([0.0, 0.9, 0.0])]  # for the way home
    the_tracker_sees(monkeypatch, None)
    assert not _has_stood(context, an_assistant(), known)


@pytest.mark.hazard(61)
def test_a_cart_that_is_pushed_while_the_holder_is_loaded_is_noticed_before_the_assistant_leaves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fields = {
        "trajectory": "T1",
        "void": lambda _model, _reason: None,
        "workcell": SimpleNamespace(follow_assistant=lambda _way_mm: None),
    }
    context = cast("StepContext", SimpleNamespace(**fields))
    still = SimpleNamespace(transform=Transform.of(Frame.ROBOT, Frame.TRACKER))
    known = cast("Any", SimpleNamespace(robot_from_tracker=still))
    before = Transform.of(Frame.TRACKER, Frame.MARKER, translation_mm=SEEN_MM)
    the_tracker_sees(monkeypatch, SEEN_MM)
    assert _stands_as_presented(context, an_assistant(), known, before)
    assert not _stands_as_presented(context, an_assistant(), known, None)
    the_tracker_sees(monkeypatch, (100.0, 200.0, -1499.1))
    with pytest.raises(PlatformMoved, match=r"limit 0.5 mm, got 0.90 mm"):
        _stands_as_presented(context, an_assistant(), known, before)


@pytest.mark.hazard(61)
def test_joints_alone_do_not_lead_an_instrument_into_the_guide(monkeypatch: pytest.MonkeyPatch) -> None:
    def hidden() -> list[Transform]:
        raise FrameHidden("assistant_frame")

    found: list[str] = []
    records = SimpleNamespace(tracker_frame=SimpleNamespace(tool="robot_frame"))
    fields = {
        "trajectory": "T1",
        "workcell": SimpleNamespace(calibrations=records),
        "find": found.append,
        "setting": SimpleNamespace(memory=CaseMemory()),
    }
    context = cast("StepContext", SimpleNamespace(**fields))
    the_tracker_sees_both(monkeypatch, hidden)
    with pytest.raises(GateFailed, match="nothing shows that its cart has stood still"):
        _require_seen_coaxial(context, an_assistant(), AXIS, cast("Any", None), stood=False)
    _require_seen_coaxial(context, an_assistant(), AXIS, cast("Any", None), stood=True)
    assert "where it stood" in found[0]


@pytest.mark.hazard(61)
def test_an_assistant_seen_elsewhere_than_its_joints_have_it_has_everything_localized_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A repeated step would only end in the same place."""

    def posed(pose: Transform) -> Any:
        return SimpleNamespace(transform=pose)

    on_flange = posed(Transform.of(Frame.FLANGE, Frame.MARKER))
    robot_from_tracker = posed(Transform.of(Frame.ROBOT, Frame.TRACKER))
    known = SimpleNamespace(
        flange_from_frame=on_flange,
        flange_from_master_frame=on_flange,
        robot_from_tracker=robot_from_tracker,
        robot_from_base=posed(Transform.of(Frame.ROBOT, Frame.ASSISTANT)),
    )
    ways_mm: list[list[float]] = []
    arm = {
        "joints_rad": lambda: (0.0,) * 6,
        "flange_pose": lambda _joints, _arrived: Transform.of(Frame.ROBOT, Frame.FLANGE),
    }
    records = SimpleNamespace(tracker_frame=SimpleNamespace(tool="robot_frame"))
    void: list[Any] = []
    fields = {
        "trajectory": "T1",
        "workcell": SimpleNamespace(
            calibrations=records,
            place=SimpleNamespace(axis=None),
            follow_assistant=lambda way_mm: ways_mm.append(list(way_mm)),
            **arm,
        ),
        "void": lambda model, _reason: void.append(model),
    }
    holder = SimpleNamespace(frame="assistant_frame")
    arm["flange_pose"] = lambda _joints, _arrived: Transform.of(Frame.ASSISTANT, Frame.FLANGE)
    assistant = SimpleNamespace(holder=holder, **arm)
    places = ((0.0, 0.0, 0.0), (0.0, 1.1, 0.0))
    seen = [Transform.of(Frame.TRACKER, Frame.MARKER, translation_mm=place) for place in places]
    the_tracker_sees_both(monkeypatch, lambda: seen)
    with pytest.raises(GateFailed, match="elsewhere than its joints have it"):
        _require_seen_coaxial(
            cast("StepContext", SimpleNamespace(**fields)),
            cast("Any", assistant),
            AXIS,
            cast("Any", known),
            stood=True,
        )
    assert void == [GlobalLocalization]
    assert ways_mm == [pytest.approx([0.0, 1.1, 0.0])]


SPHERES_MM = np.array([[0.0, 0.0, 0.0], [120.0, 0.0, 0.0], [0.0, 120.0, 0.0], [0.0, 0.0, 120.0]])


def context_with_bases(assistant_place: PlaceKind = PlaceKind.HOME) -> StepContext:
    known = SimpleNamespace(master_seen_mm=SPHERES_MM.tolist(), assistant_seen_mm=(900.0, 0.0, 0.0))
    arms = [SimpleNamespace(name="arm", place=ArmPlace(PlaceKind.HOME))]
    arms.append(SimpleNamespace(name="assistant", place=ArmPlace(assistant_place)))
    workcell = SimpleNamespace(assistant=arms[1], supervised_arms=arms)
    fields = {"workcell": workcell, "result_among": lambda _model, pick: pick([known])}
    return cast("StepContext", SimpleNamespace(**fields))


@pytest.mark.hazard(61)
def test_platforms_are_compared_with_both_arms_home_and_by_what_is_seen_where_it_was(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shift_mm = np.zeros(3)
    there_mm = np.array([900.0, 0.0, 0.0])
    monkeypatch.setattr(
        base_to_base, "_see_platforms", lambda *_: (SPHERES_MM + shift_mm, there_mm + shift_mm)
    )
    require_platforms_unmoved(context_with_bases())
    with pytest.raises(GateFailed, match=r"both arms home.*not home: assistant"):
        require_platforms_unmoved(context_with_bases(PlaceKind.AWAY))
    shift_mm[1] = 8.5
    with pytest.raises(GateFailed, match="too little of what showed"):
        require_platforms_unmoved(context_with_bases())


@pytest.mark.hazard(64)
@pytest.mark.parametrize(("seen_mm", "refused"), [((0.0, 0.7, 0.0), False), ((0.0, 0.9, 0.0), True)])
def test_a_cart_pushed_since_the_look_over_the_guide_keeps_the_instrument_where_it_is(
    monkeypatch: pytest.MonkeyPatch, seen_mm: tuple[float, float, float], refused: bool
) -> None:
    localized = Transform.of(Frame.ROBOT, Frame.TRACKER)
    reading = SimpleNamespace(joints_rad=(0.0,) * 6)
    assistant = SimpleNamespace(
        arm=SimpleNamespace(observe=lambda: SimpleNamespace(reading=reading)),
        base=Transform.of(Frame.ROBOT, Frame.ASSISTANT),
        calibrated=SimpleNamespace(forward=lambda _joints: Pose((0.0, 0.0, 0.0))),
        flange_from_clamp=Transform.of(Frame.FLANGE, Frame.TOOL),
        holder=SimpleNamespace(frame="assistant_frame"),
        place=SimpleNamespace(axis=SimpleNamespace(held=Transform.of(Frame.ASSISTANT, Frame.TOOL))),
    )
    watched = AssistantFrame(cast("Any", assistant))
    watched.begin_at(Transform.of(Frame.TRACKER, Frame.MARKER), localized)
    memory = CaseMemory()
    memory.keep(watched)
    pose = Transform.of(Frame.TRACKER, Frame.MARKER, translation_mm=seen_mm)
    seen = SimpleNamespace(validity=Validity.OK, transform=lambda _target, _source: pose)
    frames = [SimpleNamespace(tool=lambda _name: seen)] * READINGS
    monkeypatch.setattr(assisted_insertion, "read_localized", lambda _context: frames)
    fields = {
        "trajectory": "T1",
        "setting": SimpleNamespace(memory=memory),
        "result": lambda _model: SimpleNamespace(robot_from_tracker=SimpleNamespace(transform=localized)),
    }
    context = cast("StepContext", SimpleNamespace(**fields))
    if refused:
        with pytest.raises(InsertionDisturbed, match="PRO-054"):
            _look_before_retreat(context)
    else:
        assert _look_before_retreat(context) == ""


@pytest.mark.hazard(64)
def test_a_repeated_step_leads_no_instrument_out_beside_the_bore(monkeypatch: pytest.MonkeyPatch) -> None:
    def seen_beside(*_args: object) -> str:
        raise InsertionDisturbed("a cart was displaced")

    led_out: list[str] = []

    def retreat(*, doubt: str) -> None:
        led_out.append(doubt)

    assistant = SimpleNamespace(place=SimpleNamespace(is_on_axis=True), retreat=retreat)
    workcell = SimpleNamespace(assistant=assistant, start=lambda: None)
    fields = {
        "workcell": workcell,
        "trajectory": "T1",
        "result_among": lambda _model, pick: pick([BASES]),
        "setting": SimpleNamespace(memory=CaseMemory()),
    }
    context = cast("StepContext", SimpleNamespace(**fields))
    monkeypatch.setattr(assisted_insertion, "look_before_retreat", seen_beside)
    with pytest.raises(InsertionDisturbed):
        insert_with_assistant(context, cast("Any", None))
    assert not led_out
