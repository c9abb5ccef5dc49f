"""Every safety figure says at its definition what it is against, and where it comes from."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from reference_tables import ROOT
from safety_figures import PACKAGES, UNCONFIRMED, read_safety_figures

FIGURES = read_safety_figures()
NO_LIMITS = {
    *("BETWEEN_LOOKS_S", "DOUBT_MM"),  # when to look
    *("REPEATING_S", "LARGEST_STEP_S", "HEAD_LEVEL_MM", "HEAD_LEVEL_DEG"),  # beyond them only a finding
    *("ALIKE_MM", "ANOTHER_BALL_MM", "OVER_SPHERE_MM"),  # rounding; of a calibration; of a rehearsal
}
LIMIT_NAME = re.compile(r"[A-Z_]+_(MM|RAD|DEG|S)")


def test_every_safety_figure_has_a_source_or_is_said_to_be_unconfirmed() -> None:
    assert len(FIGURES) >= 127
    assert [f"{figure.path}: {figure.name}" for figure in FIGURES if not figure.source] == []


def test_no_safety_figure_is_listed_twice() -> None:
    assert len({(figure.path, figure.name) for figure in FIGURES}) == len(FIGURES)


@pytest.mark.parametrize(
    ("written", "source"),
    [
        ("# Safety against a fast arm. Source: ISO 10218-1.\nX_MM_S = 250.0\n", "ISO 10218-1"),
        ("# Half of what it can.\n# Safety against a fast arm (U).\nX_MM_S = 250.0  # why\n", UNCONFIRMED),
        ("# Safety against a fast arm.\nX_MM_S = 250.0  # an estimate (U)\n", UNCONFIRMED),
        ("# Safety against a fast arm.\nX_MM_S = 250.0  # why\n", ""),
    ],
)
def test_the_source_of_a_figure_is_read_from_the_comments_at_its_definition(
    written: str, source: str, tmp_path: Path
) -> None:
    (tmp_path / PACKAGES[0]).mkdir()
    (tmp_path / PACKAGES[0] / "limits.py").write_text(f"{written}Y_MM = 2.0\n\nZ_MM = 3.0\n")
    figures = read_safety_figures(tmp_path)
    assert [one.name for one in figures] == ["X_MM_S", "Y_MM"]  # up to a blank line
    assert (figures[0].hazard, figures[0].source, figures[0].value) == ("a fast arm", source, "250.0")


def test_a_figure_that_is_against_nothing_is_refused(tmp_path: Path) -> None:
    (tmp_path / PACKAGES[0]).mkdir()
    (tmp_path / PACKAGES[0] / "limits.py").write_text("# Safety against nothing\nX_MM = 1.0\n")
    with pytest.raises(ValueError, match=r"limits\.py:1"):
        read_safety_figures(tmp_path)


@pytest.mark.parametrize("room", ["guards", "steps", "workcell"])
def test_every_length_angle_or_time_of_a_case_that_something_is_compared_with_is_listed(room: str) -> None:
    listed = {(figure.path, figure.name) for figure in FIGURES}
    found = set()
    for module in (ROOT / "procedures" / room).rglob("*.py"):
        nodes = list(ast.walk(ast.parse(module.read_text(encoding="utf-8"))))
        parts = [part for node in nodes if isinstance(node, ast.Compare) for part in ast.walk(node)]
        compared = {one.id for one in parts if isinstance(one, ast.Name)}
        own = {one.id for one in nodes if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store)}
        limits = {one for one in compared & own if LIMIT_NAME.fullmatch(one)}
        if "calibration" not in module.parts:
            found |= {(module.relative_to(ROOT).as_posix(), name) for name in limits - NO_LIMITS}
    assert found
    assert sorted(found - listed) == []


def test_reduced_speed_stands_once_in_the_code() -> None:
    speed = re.compile(r"speed_mm_s\b.*[=:] *250(\.0)?\b|\b250 mm/s", re.IGNORECASE)
    places = [
        path.relative_to(ROOT).as_posix()
        for package in (*PACKAGES, "sim", "conformance", "console", "studies")
        for path in sorted((ROOT / package).rglob("*.py"))
        if speed.search(path.read_text(encoding="utf-8"))
    ]
    assert places == ["ronna_hw/arm/motion/limits.py"]
