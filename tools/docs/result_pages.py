"""The page of the records of a run: what the result of each step holds, field by field."""

from __future__ import annotations

from collections.abc import Mapping

from model_tables import model_tables
from pydantic import BaseModel

PAGE = "records.md"
HEAD = """# Records of a run

Each step leaves one record, `records/ID.json` in the folder of the run: its identifier, its parents (the
records that the step read), its hash, and the result below. Lengths are millimetres, angles radians, and a
transform is target <- source.
"""


def records_page(results: Mapping[str, type[BaseModel]]) -> str:
    """The page in Markdown, from the name of each step to the model of its result."""
    return f"{HEAD}\n{model_tables(results)}"
