"""Both cameras at full rate and size, on a network that loses packets: every frame arrives complete."""

from __future__ import annotations

from pathlib import Path

import pytest
from camera_stream import lossy_cameras, stream_pairs

LOST_PERCENT = 0.2


@pytest.mark.parametrize(
    "pairs", [pytest.param(30, marks=pytest.mark.slow), pytest.param(3000, marks=pytest.mark.soak)]
)
def test_no_frame_is_lost_when_packets_are_lost(tmp_path: Path, pairs: int) -> None:
    with lossy_cameras(tmp_path, LOST_PERCENT) as cameras:
        addresses = [cameras.ready["endpoints"][side].removeprefix("gev://") for side in ("left", "right")]
        streamed = stream_pairs(addresses, pairs)
    assert streamed.repeated > 0
    assert (streamed.lost, streamed.broken) == (0, 0)
