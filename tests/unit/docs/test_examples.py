"""The files shown on the reference pages are accepted as they are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from reference_tables import REFERENCE

from procedures.planning.plan_file import read_plan
from procedures.runs.answers import read_answers


@pytest.mark.parametrize(
    ("page", "read"), [("plan-file.md", read_plan), ("answers.md", read_answers)], ids=["plan", "answers"]
)
def test_the_example_of_a_reference_page_is_accepted(
    page: str, read: Callable[[Path], object], tmp_path: Path
) -> None:
    text = (REFERENCE / page).read_text(encoding="utf-8")
    (example,) = (part.partition("\n```")[0] for part in text.split("```toml\n")[1:])
    file = tmp_path / "example.toml"
    file.write_text(example, encoding="utf-8")
    read(file)
