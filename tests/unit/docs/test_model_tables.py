"""The tables of records, options and files are generated from the models alone."""

from __future__ import annotations

from model_tables import model_tables
from pydantic import BaseModel, Field


class Sphere(BaseModel):
    """One sphere."""

    radius_mm: float = Field(description="Its radius.")


class Spheres(BaseModel):
    """What was found."""

    spheres: list[Sphere] = Field(description="Each of them.")


class Check(BaseModel):
    """What was checked."""

    worst: Sphere = Field(description="The least round one.")


def test_each_step_lists_its_fields_and_a_shared_model_is_listed_once() -> None:
    page = model_tables({"localization": Spheres, "check": Check})
    assert "## localization\n\nWhat was found.\n" in page
    assert "| `spheres` | list of Sphere | required | Each of them. |" in page
    assert page.count("| `radius_mm` | number | required | Its radius. |") == 1
