"""The page on chapter 2 of the thesis shows what Python answers, and its pictures are drawn from runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from documented import run_exercises
from user_commands import Commands

from procedures.registration.correspondence import MatchStatus
from studies.thesis_figures import MATRIX_FIDUCIALS, draw_matrix_run, figures

PAGE = "docs/reference/thesis-chapter-2.md"
PNG = b"\x89PNG"


def test_the_page_shows_what_python_answers(commands: Commands, tmp_path: Path) -> None:
    assert run_exercises(PAGE, commands, tmp_path) >= 20


def test_the_matrix_of_figure_11_loses_a_point_in_every_iteration_until_the_pairs_stand_out() -> None:
    steps, found = draw_matrix_run()
    sizes = [len(step.rows) + len(step.columns) for step in steps]
    assert np.diff(sizes).tolist() == [-1] * (len(sizes) - 1)
    assert found.status is MatchStatus.UNIQUE
    assert len(found.pairs) == MATRIX_FIDUCIALS
    last = steps[-1]
    for image, physical in found.pairs.tolist():
        cell = last.matrix[last.rows.tolist().index(image), last.columns.tolist().index(physical)]
        assert cell == MATRIX_FIDUCIALS - 1


@pytest.mark.slow
def test_every_figure_is_drawn() -> None:
    assert {name.split("-")[1] for name, picture in figures().items() if picture.startswith(PNG)} == {
        "4",
        "5",
        "6",
        "11",
    }
