"""A motion driven set-point by set-point under the monitor."""

from __future__ import annotations

from ronna_hw.arm.clearance.live_watch import Violation
from ronna_hw.arm.monitor import Monitor
from ronna_hw.arm.motion.set_points import PathMotion


def drive_monitored(motion: PathMotion, monitor: Monitor, *, slower_after: int = 0) -> Violation | int:
    """Send all set-points; returns their number, or the first violation. Each stop passes the monitor too.

    With `slower_after` cycles the motion is reduced to a quarter of its speed.
    """
    cycles = 0
    while not motion.is_finished:
        prepared = motion.prepare()
        violation = monitor.check(prepared.go_rad)
        if violation is not None:
            return violation
        assert monitor.check(prepared.stop_rad) is None
        motion.take_go()
        monitor.sent(prepared.go_rad)
        cycles += 1
        if cycles == slower_after:
            motion.limit_speed(0.25)
    return cycles
