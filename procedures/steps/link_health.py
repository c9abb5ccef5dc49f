"""Health of the robot's real-time link, as a step leaves it in its record before the link is ended."""

from __future__ import annotations

from procedures.engine.step import StepContext


def link_payload(context: StepContext) -> dict[str, object]:
    """Counters, turnaround and jitter since the arm was last activated, as plain numbers."""
    statistics = context.devices.arm.link_statistics()
    return {
        # Without the host's pace a turnaround says nothing about real time; it is kept, and marked.
        "lock_step": not context.clock.paced,
        "cycles": statistics.cycles,
        "late_cycles": statistics.late_cycles,
        "lost_cycles": statistics.lost_cycles,
        "rejected_telegrams": statistics.rejected_telegrams,
        "foreign_telegrams": statistics.foreign_telegrams,
        "turnaround_median_us": statistics.turnaround_median_us,
        "turnaround_p99_us": statistics.turnaround_p99_us,
        "jitter_median_us": statistics.jitter_median_us,
        "jitter_p99_us": statistics.jitter_p99_us,
        "histogram_edges_us": list(statistics.histogram_edges_us),
        "histogram_counts": list(statistics.histogram_counts),
        "jitter_counts": list(statistics.jitter_counts),
    }
