"""Arrangement of a page's views: one large, three small beside it, and one out of sight."""

from __future__ import annotations

from enum import StrEnum


class PlanView(StrEnum):
    """Views of a page: four CT slices and the head in three dimensions."""

    AXIAL = "axial"
    CORONAL = "coronal"
    SAGITTAL = "sagittal"
    HEAD = "head"
    ALONG = "along"


NAMES = {
    PlanView.AXIAL: "axial",
    PlanView.CORONAL: "coronal",
    PlanView.SAGITTAL: "sagittal",
    PlanView.HEAD: "3-D",
    PlanView.ALONG: "along trajectory",
}
SMALL_ONES = 3


class Size(StrEnum):
    """Size of a view on the page, which is its CSS class."""

    LARGE = "large"
    SMALL = "small"
    UNSEEN = "unseen"


def arrange(large: PlanView) -> dict[PlanView, Size]:
    """Return the size of each view. The small ones are the first three of the others."""
    others = [view for view in PlanView if view is not large]
    small = dict.fromkeys(others[:SMALL_ONES], Size.SMALL)
    return {large: Size.LARGE, **small, **dict.fromkeys(others[SMALL_ONES:], Size.UNSEEN)}
