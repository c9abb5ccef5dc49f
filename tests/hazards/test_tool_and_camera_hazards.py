"""Hazards 3, 25, 26, 37: the wrong tool, a swapped camera, an old calibration; refused before any motion."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, cast

import pytest

from procedures.engine.case import Case
from procedures.engine.devices import DeviceSet
from procedures.engine.errors import WrongTool
from procedures.engine.step import StepContext, StepKey
from procedures.relocalization.errors import WrongCamera
from procedures.steps import positioning, set_up
from ronna_hw.calibration import CalibrationExpired
from ronna_hw.clock import HostClock
from ronna_hw.config import TheatreFile, parse_theatre
from ronna_hw.devices.lifecycle import Identity, Lifecycle
from ronna_hw.devices.readings import Stamp, ToolIdentity
from ronna_hw.errors import EXIT_REFUSED
from sim.theatre.scene.named_scenes import built_in_scene
from sim.theatre.theatre_file import theatre_content

ENDPOINTS = {
    "polaris": "tcp://127.0.0.1:8765",
    "kuka": {"rsi": "udp://127.0.0.1:59152", "eki_project": "tcp://127.0.0.1:54602"},
    "basler": {"left": "gev://127.77.0.1", "right": "gev://127.77.0.2"},
}
STEREO_HEAD, GUIDE = 1, 2


class Anything:
    """A device that answers and notes what is asked of it."""

    notices: tuple[str, ...] = ()

    def __init__(self, serials: tuple[str, str] = ("", ""), tool: int = STEREO_HEAD) -> None:
        self.serials = serials
        self.tool = tool
        self.state = Lifecycle.CONFIGURED
        self.calls: list[str] = []

    def connect(self) -> Identity:
        return Identity(vendor="", model="", serial="", firmware="")

    def read_tool_identity(self) -> ToolIdentity:
        return ToolIdentity(Stamp(1, 0, 0.0), self.tool)

    def __getattr__(self, name: str) -> Any:
        def note(*_: Any, **__: Any) -> None:
            self.calls.append(name)

        return note


@pytest.fixture
def theatre() -> TheatreFile:
    scene = built_in_scene("mini", seed=3)
    return parse_theatre(theatre_content(scene, ENDPOINTS, "host:", {}, 1.0))


Refuser = Callable[..., StepContext]


@pytest.fixture
def context(theatre: TheatreFile, tmp_path: Path) -> Refuser:
    """A step's context over devices that move nothing; the operator must not even be asked."""

    def make(step: str, *, tool: int, serials: tuple[str, str] | None = None, **changed: Any) -> StepContext:
        calibrations = theatre.calibration
        assert calibrations is not None
        calibrations = calibrations.model_copy(update=changed)
        sides = serials or (calibrations.stereo_head.left.serial, calibrations.stereo_head.right.serial)
        devices = DeviceSet(
            cast("Any", Anything()), cast("Any", Anything(tool=tool)), cast("Any", Anything(sides))
        )
        return StepContext(
            key=StepKey(step, "T1"),
            case=Case(tmp_path, tmp_path, tmp_path),
            theatre=theatre,
            calibrations=calibrations,
            devices=devices,
            clock=HostClock(),
            operator=cast("Any", None),
            trajectories=("T1",),
            progress=lambda _share, _text: None,
            record_confirmation=lambda _question, _answer: None,
        )

    return make


def _moves(context: StepContext) -> list[str]:
    arm = cast("Anything", context.devices.arm)
    return [call for call in arm.calls if call.startswith(("move", "activate"))]


@pytest.mark.hazard(3)
@pytest.mark.hazard(37)
@pytest.mark.parametrize("mounted", [0, STEREO_HEAD, GUIDE + 1])
def test_nothing_moves_to_a_target_while_another_tool_than_the_guide_hangs_there(
    context: Refuser, mounted: int
) -> None:
    wrong = context("positioning", tool=mounted)
    with pytest.raises(WrongTool):
        positioning.run(wrong)
    assert _moves(wrong) == []


@pytest.mark.hazard(37)
@pytest.mark.parametrize("mounted", [0, GUIDE])
def test_the_case_does_not_begin_while_another_tool_than_the_stereo_head_hangs_there(
    context: Refuser, mounted: int
) -> None:
    wrong = context("set_up", tool=mounted)
    with pytest.raises(WrongTool):
        set_up.run(wrong)
    assert _moves(wrong) == []


@pytest.mark.hazard(25)
def test_swapped_cameras_are_refused_at_set_up(context: Refuser, theatre: TheatreFile) -> None:
    assert theatre.calibration is not None
    head = theatre.calibration.stereo_head
    swapped = context("set_up", tool=STEREO_HEAD, serials=(head.right.serial, head.left.serial))
    with pytest.raises(WrongCamera) as refused:
        set_up.run(swapped)
    assert refused.value.exit_code == EXIT_REFUSED


@pytest.mark.hazard(26)
@pytest.mark.parametrize("record", ["stereo_head", "tool_tip", "tracker_frame"])
def test_an_expired_calibration_is_refused_at_set_up(
    context: Refuser, theatre: TheatreFile, record: str
) -> None:
    calibration = getattr(theatre.calibration, record)
    expired = calibration.model_copy(update={"expires": datetime.now(UTC) - timedelta(seconds=1)})
    late = context("set_up", tool=STEREO_HEAD, **{record: expired})
    with pytest.raises(CalibrationExpired) as refused:
        set_up.run(late)
    assert refused.value.exit_code == EXIT_REFUSED
    # With the records as they were, set-up goes on to the tool: the date is the only difference.
    with pytest.raises(WrongTool):
        set_up.run(context("set_up", tool=0))
