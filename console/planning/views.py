"""Arrangement of a page's views: one large, three small beside it, and one out of sight."""

from __future__ import annotations

from enum import StrEnum


class View(StrEnum):
    """Views of a page: four CT slices and the head in three dimensions."""

    AXIAL = "axial"
    CORONAL = "coronal"
    SAGITTAL = "sagittal"
    HEAD = "head"
    ALONG = "along"


NAMES = {
    View.AXIAL: "axial",
    View.CORONAL: "coronal",
    View.SAGITTAL: "sagittal",
    View.HEAD: "3-D",
    View.ALONG: "along trajectory",
}
SMALL_ONES = 3


class Size(StrEnum):
    """Size of a view on the page, which is its CSS class."""

    LARGE = "large"
    SMALL = "small"
    UNSEEN = "unseen"


def arrange(large: View) -> dict[View, Size]:
    """Return the size of each view. The small ones are the first three of the others."""
    others = [view for view in View if view is not large]
    small = dict.fromkeys(others[:SMALL_ONES], Size.SMALL)
    return {large: Size.LARGE, **small, **dict.fromkeys(others[SMALL_ONES:], Size.UNSEEN)}
