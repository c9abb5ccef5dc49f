"""An assistant in the guide is compared with its frame before a resumed case moves anything."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from procedures.guards.assistant_frame import SHIFTED_MM
from procedures.journal.journal import Line
from procedures.runs import assistant_comparison
from procedures.runs.assistant_comparison import compare_assistant
from procedures.runs.comparison import Comparison
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.two_arms.base_to_base import KnownBases
from procedures.steps.clinical.two_arms.seen_on_axis import LOOK_AT_CART
from procedures.workcell import tracker_look
from procedures.workcell.arm_history import InsertionAxis
from procedures.workcell.tracker_move import UNPUSHED
from ronna_hw.errors import LinkTimeout
from ronna_hw.frames import Frame, Transform

DOWN = Transform.of(Frame.ASSISTANT, Frame.TOOL, quaternion_wxyz=(0.0, 1.0, 0.0, 0.0))
ON_MASTER, ON_ASSISTANT = "robot_frame", "assistant_frame"
Place = tuple[float, float, float]
LINES: tuple[Line, ...] = ()


def posed(pose: Transform) -> Any:
    return SimpleNamespace(transform=pose)


def compare_seen(monkeypatch: pytest.MonkeyPatch, seen_mm: Place | None, **lacking: Any) -> Comparison:
    """Compare an assistant on an axis that leads down; both flanges are at the origin by the joints."""
    arm = {
        "joints_rad": lambda: (0.0,) * 6,
        "flange_pose": lambda _joints, _arrived: Transform.of(Frame.ROBOT, Frame.FLANGE),
    }
    axis = InsertionAxis("T1", DOWN, 180.0)
    assistant = SimpleNamespace(
        place=SimpleNamespace(axis=axis, is_out=True),
        holder=SimpleNamespace(frame=ON_ASSISTANT),
        history=SimpleNamespace(base=object()),
        require_on_axis=lambda: None,
        **arm | {"flange_pose": lambda _joints, _arrived: Transform.of(Frame.ASSISTANT, Frame.FLANGE)},
    )
    workcell = SimpleNamespace(
        assistant=assistant,
        place=SimpleNamespace(axis=None),
        calibrations=SimpleNamespace(tracker_frame=SimpleNamespace(tool=ON_MASTER)),
        tracker=None,
        tracker_move=lambda _localization: UNPUSHED,
        **arm,
    )
    flange = posed(Transform.of(Frame.FLANGE, Frame.MARKER))
    bases = SimpleNamespace(
        flange_from_frame=flange,
        flange_from_master_frame=flange,
        robot_from_tracker=posed(Transform.of(Frame.ROBOT, Frame.TRACKER)),
        robot_from_base=posed(Transform.of(Frame.ROBOT, Frame.ASSISTANT)),
    )
    results = {KnownBases: bases, GlobalLocalization: None}
    places = {ON_MASTER: (0.0, 0.0, 0.0), ON_ASSISTANT: seen_mm}

    def mean_pose(_frames: object, name: str, _least: int) -> Transform | None:
        place = places[name]
        return None if place is None else Transform.of(Frame.TRACKER, Frame.MARKER, translation_mm=place)

    patches = {
        "_find_last": lambda _engine, model: (SimpleNamespace(identifier="05"), results[model]),
        "read_frames_at_rest": lambda *_args, **_named: ([], 0),
        "mean_pose": mean_pose,
    } | lacking
    for name, patch in patches.items():
        module = tracker_look if name == "mean_pose" else assistant_comparison
        monkeypatch.setattr(module, name, patch)
    engine = SimpleNamespace(setting=SimpleNamespace(workcell=workcell, clock=None))
    left = SimpleNamespace(chain=SimpleNamespace(lines=LINES, torn=b""), lost=())
    comparison = Comparison()
    compare_assistant(cast("Any", engine), cast("Any", left), comparison)
    return comparison


@pytest.mark.hazard(64)
def test_a_displaced_assistant_leads_no_instrument_out_of_the_guide(monkeypatch: pytest.MonkeyPatch) -> None:
    (refused,) = compare_seen(monkeypatch, (0.0, 1.1 * SHIFTED_MM, 0.0)).differences
    assert refused.startswith("PRO-054")
    assert "open the clamp of the assistant's holder" in refused


def test_an_assistant_beside_nothing_or_shifted_along_the_axis_may_lead_it_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    comparison = compare_seen(monkeypatch, (0.0, 0.9 * SHIFTED_MM, 3.0))
    assert comparison.differences == comparison.warnings == []
    assert "across the axis of T1" in comparison.notes[0]


def unreadable(*_args: object, **_named: object) -> None:
    raise LinkTimeout("no reply")


@pytest.mark.hazard(64)
@pytest.mark.parametrize(
    ("seen_mm", "lacking"),
    [
        (None, {}),
        ((0.0, 0.0, 0.0), {"read_frames_at_rest": unreadable}),
        ((0.0, 0.0, 0.0), {"_find_last": lambda _engine, _model: None}),
    ],
)
def test_staff_look_at_an_assistant_that_the_tracker_cannot_compare(
    monkeypatch: pytest.MonkeyPatch, seen_mm: Place | None, lacking: dict[str, Any]
) -> None:
    comparison = compare_seen(monkeypatch, seen_mm, **lacking)
    assert comparison.differences == []
    assert LOOK_AT_CART in comparison.warnings[0]
