"""When a silent camera counts as lost, on a manually advanced clock."""

from __future__ import annotations

import threading

import pytest

from drivers.basler_stereo import control_channel
from drivers.basler_stereo.control_channel import SILENT_BEATS, Heartbeat
from drivers.basler_stereo.errors import CameraLost, ControlLost, NoReply
from ronna_hw.errors import RonnaError
from ronna_hw.wire.gige_vision import CCP_CONTROL, CCP_OPEN

HANG_LIMIT_S = 30.0
SILENT = None


class ScriptedCamera:
    """Answers each question for its privilege with the next of `answers`; each takes `takes_s`."""

    address = "192.168.3.11"

    def __init__(self, answers: list[int | None], takes_s: float) -> None:
        self.answers, self.takes_s = answers, takes_s
        self.now_s = 0.0
        self.asked = 0

    def monotonic(self) -> float:
        return self.now_s

    def read_register(self, _address: int, _deadline_s: float) -> int:
        self.now_s += self.takes_s
        answer = self.answers[min(self.asked, len(self.answers) - 1)]
        self.asked += 1
        if answer is SILENT:
            raise NoReply("no answer")
        return answer


def verdict(camera: ScriptedCamera, timeout_ms: int, monkeypatch: pytest.MonkeyPatch) -> RonnaError:
    said: list[RonnaError] = []
    heard = threading.Event()

    def lost(error: RonnaError) -> None:
        said.append(error)
        heard.set()

    monkeypatch.setattr(control_channel, "SLOWEST_BEAT_S", 0.0)
    beats = Heartbeat(camera, timeout_ms, lost, "test", monotonic=camera.monotonic)  # type: ignore[arg-type]
    assert heard.wait(HANG_LIMIT_S)
    beats.close()
    return said[0]


@pytest.mark.parametrize(("timeout_ms", "beats"), [(500, SILENT_BEATS), (3000, 3), (10_000, 10)])
def test_a_silent_camera_is_lost_once_its_time_out_has_passed(
    timeout_ms: int, beats: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = ScriptedCamera([CCP_CONTROL, SILENT], takes_s=1.0)
    error = verdict(camera, timeout_ms, monkeypatch)
    assert isinstance(error, CameraLost)
    assert camera.asked == 1 + beats
    assert f"silent for {beats}.0 s" in str(error)


def test_a_camera_that_answers_in_between_is_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = [SILENT, SILENT, CCP_CONTROL, SILENT, SILENT, CCP_CONTROL, CCP_OPEN]
    camera = ScriptedCamera(answers, takes_s=1.0)
    assert isinstance(verdict(camera, 3000, monkeypatch), ControlLost)
    assert camera.asked == len(answers)
