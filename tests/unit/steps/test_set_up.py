"""The set-up step connects every device, and hands on what is no error but should be known."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from procedures.engine.errors import WrongTool
from procedures.steps import set_up
from ronna_hw.devices.lifecycle import Identity
from sim.theatre.scene.named_scenes import built_in_scene

NOTICE = "left: the camera sends no test packets; packets of 1500 bytes"


class Room:
    """Devices that only connect, with records that hold."""

    def __init__(self, mounted: int = 1) -> None:
        scene = built_in_scene("mini")
        record = SimpleNamespace(
            check_valid_at=lambda now: None,
            model_dump=lambda mode: {},
            left=scene.left,
            right=scene.right,
        )
        self.configured: list[str] = []
        self.calibrations = SimpleNamespace(stereo_head=record, tool_tip=record, tracker_frame=record)
        arm = self._device(
            "arm",
            read_tool_identity=lambda: SimpleNamespace(number=mounted),
            read_state=lambda: SimpleNamespace(joints_rad=(0.0,) * 6),
        )
        stereo = self._device("stereo", serials=(scene.left.serial, scene.right.serial), notices=(NOTICE,))
        self.devices = SimpleNamespace(tracker=self._device("tracker"), arm=arm, stereo=stereo)

    def progress(self, share: float, text: str) -> None:
        assert 0.0 <= share < 1.0

    def _device(self, name: str, **more: Any) -> SimpleNamespace:
        return SimpleNamespace(
            connect=lambda: Identity("Test", f"a {name}", "1", "0"),
            configure=lambda: self.configured.append(name),
            **more,
        )


def test_all_devices_are_configured_and_their_notices_are_told() -> None:
    room = Room()
    outcome = set_up.run(room)  # type: ignore[arg-type]
    assert room.configured == ["tracker", "arm", "stereo"]
    assert outcome.summary == f"a tracker, a arm, a stereo; stereo: {NOTICE}"
    assert outcome.payload["notices"] == [f"stereo: {NOTICE}"]


def test_another_tool_is_refused() -> None:
    with pytest.raises(WrongTool, match="expected 1, got 2"):
        set_up.run(Room(mounted=2))  # type: ignore[arg-type]
