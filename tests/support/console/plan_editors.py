"""A plan editor on a small scan, and a person's actions in it."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import numpy as np

from console.planning.plan_editor import PlanEditor
from procedures.imaging.volume import Volume, VoxelGeometry
from ronna_hw.errors import RonnaError

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


def draw(editor: PlanEditor, standoff_mm: float = 30.0) -> None:
    draft = replace(editor.draft, instrument_length_mm=250.0, standoff_mm=standoff_mm)
    editor.change(draft.with_way("T1", replace(draft.way("T1"), entry_mm=ENTRY, target_mm=TARGET)))


def save(editor: PlanEditor, author: str = "Dr Test") -> None:
    asyncio.run(editor.save(author))


def reopened(editor: PlanEditor) -> PlanEditor:
    """By the next planner."""
    editor.close()
    return PlanEditor(scan(), editor.file, None)


def code_of(error: RonnaError | None) -> str:
    return error.code if error else ""
