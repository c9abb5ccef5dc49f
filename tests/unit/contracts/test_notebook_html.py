"""Results as a notebook shows them: every column with its unit, no text taken for HTML, bounded in length."""

from __future__ import annotations

import numpy as np
from prepared_results import checked_plan

from procedures.exchange.recorded_tables import ShownPictures
from procedures.registration import register
from ronna_hw import Frame
from ronna_hw.frames import Transform
from ronna_hw.loaded_run import RunColumn, RunTable
from ronna_hw.notebook_html import MOST_ROWS

COLUMNS = (
    RunColumn("name", str, ""),
    RunColumn("error_mm", float, ""),
    RunColumn("target_ct_mm", float, "", (3,)),
)


def shown(rows: int, name: str = "T1", error_mm: float = 0.123456789) -> str:
    return RunTable.of(COLUMNS, [(name, error_mm, (1.0, 2.5, -3.0))] * rows)._repr_html_()


def test_a_table_shows_its_columns_with_units_and_a_vector_in_one_cell() -> None:
    html = shown(1)
    assert "<th>name</th><th>error_mm</th><th>target_ct_mm</th>" in html
    assert "<td>T1</td><td>0.12346</td><td>1, 2.5, -3</td>" in html


def test_a_row_shows_its_columns_by_name() -> None:
    row = RunTable.of(COLUMNS, [("T1", 0.123456789, (1.0, 2.5, -3.0))])[0]
    assert repr(row) == "<row: name=T1, error_mm=0.12346, target_ct_mm=(1, 2.5, -3)>"
    assert "<td>error_mm</td><td>0.12346</td>" in row._repr_html_()
    assert row.target_ct_mm.tolist() == [1.0, 2.5, -3.0]


def test_pictures_of_a_look_are_shown_by_their_size() -> None:
    pictures = ShownPictures(np.zeros((3, 4), np.uint8), None)
    assert repr(pictures) == "<StereoPictures: left 4 x 3 px uint8, right did not arrive>"
    assert pictures._repr_html_().count('src="data:image/png;base64,') == 1


def test_a_long_table_says_how_many_rows_it_leaves_out() -> None:
    html = shown(MOST_ROWS + 3)
    assert html.count("<td>T1</td>") == MOST_ROWS
    assert "and 3 more rows" in html


def test_text_is_no_html_and_an_unknown_number_is_empty() -> None:
    html = shown(1, name="<script>", error_mm=np.nan)
    assert "<script>" not in html
    assert "<td></td>" in html


def test_a_transform_shows_its_frames_and_its_matrix() -> None:
    html = Transform.of(Frame.ROBOT, Frame.CT, translation_mm=(1.0, 2.0, 3.5))._repr_html_()
    assert "robot &lt;- ct" in html
    assert "<td>0</td><td>0</td><td>1</td><td>3.5</td>" in html


def test_a_plan_shows_its_trajectories_in_mm_of_the_ct() -> None:
    plan = checked_plan().plan
    html = plan._repr_html_()
    assert "<th>entry_ct_mm</th><th>target_ct_mm</th><th>depth_mm</th><th>margin_mm</th>" in html
    assert all(f"<td>{one.id}</td>" in html for one in plan.trajectories)
    assert f"instrument {plan.instrument_length_mm:g} mm" in html


def test_a_registration_shows_each_residual_and_that_it_is_no_error_at_a_target() -> None:
    image_mm = np.array([(0.0, 0.0, 0.0), (50.0, 0.0, 0.0), (0.0, 60.0, 0.0), (0.0, 0.0, 70.0)])
    html = register(image_mm, image_mm + np.array((1.0, 2.0, 3.0)))._repr_html_()
    assert "<th>residual_mm</th><th>distance_mm</th>" in html
    assert "4 pairs, FRE 0.000 mm: not the error at a target" in html
