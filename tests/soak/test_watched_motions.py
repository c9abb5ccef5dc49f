"""Half a millimetre of head movement at random moments of thousands of motions; as many quiet motions."""

import pytest
from frame_trials import frames_to_alarm

pytestmark = [pytest.mark.soak, pytest.mark.hazard(12), pytest.mark.timeout(900)]

TRIALS = 10_000
MOST_FRAMES = 12


def test_a_shift_is_detected_within_twelve_frames_in_ten_thousand_motions() -> None:
    noticed = [frames_to_alarm(trial, 0.5) for trial in range(TRIALS)]
    assert all(count is not None and 0 < count <= MOST_FRAMES for count in noticed)


def test_ten_thousand_quiet_motions_raise_no_alarm() -> None:
    assert {frames_to_alarm(trial, 0.0) for trial in range(TRIALS)} == {None}
