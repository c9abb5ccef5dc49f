"""A planner's desk on a small scan, and what a person does at it."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import numpy as np

from console.planning.plan_editor import PlanDesk
from procedures.imaging.volume import Volume, VoxelGeometry

SERIES = "1.2.826.0.1.3680043.8.498.7"
ENTRY, TARGET = (10.0, -50.0, 60.0), (5.0, -20.0, 20.0)


def scan(series: str = SERIES) -> Volume:
    """Tissue below a slanting plane, air above it; no sphere."""
    geometry = VoxelGeometry(
        (67, 67, 67),
        np.full(3, -99.0),
        np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
        np.full(3, 3.0),
    )
    z, y, _ = np.meshgrid(*[np.arange(-99.0, 100.0, 3.0)] * 3, indexing="ij")
    return Volume(
        np.where(0.8 * z - 0.6 * y < 79.0, 40, -1000).astype(np.int16), geometry, series, "1.2.3", "HFS"
    )


def draw(desk: PlanDesk, standoff_mm: float = 30.0) -> None:
    draft = replace(desk.draft, instrument_length_mm=250.0, standoff_mm=standoff_mm)
    desk.change(draft.with_way("T1", replace(draft.way("T1"), entry_mm=ENTRY, target_mm=TARGET)))


def save(desk: PlanDesk, author: str = "Dr Test") -> None:
    asyncio.run(desk.save(author))


def reopened(desk: PlanDesk) -> PlanDesk:
    """By the next planner."""
    desk.close()
    return PlanDesk(scan(), desk.file, None)
