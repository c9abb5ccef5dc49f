"""The counters of a run's links are added up."""

from __future__ import annotations

from typing import Any

from procedures.reporting.run_statistics import link_counters


def deactivated(frames: int, commands: int) -> dict[str, Any]:
    counts = {"frames": {"frames": frames}, "link": {"commands": commands}}
    return {"event": "configured", "device": "tracker", "before": "active", **counts}


CONNECTED = {"event": "connected", "device": "tracker", "before": "disconnected"}


def test_the_counters_of_a_device_are_added_up_over_the_run_and_its_connections() -> None:
    log = [CONNECTED, deactivated(12, 60), deactivated(60, 122), CONNECTED, deactivated(30, 130)]
    assert link_counters(log) == (("tracker", "3 times", "frames 102, commands 252"),)
    assert link_counters([CONNECTED]) == ()
