"""Structures to avoid, as they are drawn and imported."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from console.planning.draft import Draft
from console.planning.structure_panel import STEP_MM, draw_stroke, free_name, import_structure, set_margin
from procedures.imaging.volume import VoxelGeometry
from procedures.planning.errors import PlanMistakes

GEOMETRY = VoxelGeometry((67, 67, 67), np.full(3, -99.0), np.eye(3)[::-1], np.full(3, 3.0))


def test_a_stroke_is_sampled_along_its_line_and_keeps_its_margin() -> None:
    draft = draw_stroke(Draft("HFS", 4), "vessel", (0.0, 0.0, 0.0), None)
    draft = set_margin(draft, "vessel", 5.0)
    draft = draw_stroke(draft, "vessel", (9.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    (vessel,) = draft.structures
    assert vessel.margin_mm == 5.0
    assert vessel.points_mm[0] == (0.0, 0.0, 0.0)
    assert vessel.points_mm[-1] == (9.0, 0.0, 0.0)
    assert max(math.dist(a, b) for a, b in pairwise(vessel.points_mm)) <= STEP_MM


def test_an_imported_structure_never_replaces_another() -> None:
    draft = import_structure(Draft("HFS", 4), "S1", b"1,2,3\n", "a.csv", GEOMETRY)
    with pytest.raises(PlanMistakes, match=r"PLAN-002.*S1 already.*another name"):
        import_structure(draft, "S1", b"4,5,6\n", "a.csv", GEOMETRY)
    assert free_name(draft) == "S2"


@pytest.mark.parametrize("name", ["", "-", "a" * 40, "a\nb"])
def test_an_invalid_structure_name_is_refused(name: str) -> None:
    with pytest.raises(PlanMistakes, match="PLAN-002"):
        draw_stroke(Draft("HFS", 4), name, (0.0, 0.0, 0.0), None)


@pytest.mark.parametrize(
    ("margin_mm", "said"),
    [(-1.0, "-1"), (31.0, "31"), (math.inf, "inf"), (0.003, r"vessel\.margin_mm: 0\.003 mm .* not metres")],
)
def test_an_invalid_margin_is_refused(margin_mm: float, said: str) -> None:
    draft = draw_stroke(Draft("HFS", 4), "vessel", (0.0, 0.0, 0.0), None)
    with pytest.raises(PlanMistakes, match=f"PLAN-002.*{said}"):
        set_margin(draft, "vessel", margin_mm)
