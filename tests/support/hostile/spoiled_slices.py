"""Changes to single slices of a DICOM series, or to all."""

from __future__ import annotations

from collections.abc import Callable

from pydicom.dataset import Dataset


def only(number: int, change: Callable[[Dataset], object]) -> Callable[[Dataset, int], None]:
    """An edit of one slice."""

    def edit(data: Dataset, at: int) -> None:
        if at == number:
            change(data)

    return edit


def every(change: Callable[[Dataset], object]) -> Callable[[Dataset, int], None]:
    return lambda data, at: change(data) and None


def setting(**values: object) -> Callable[[Dataset], None]:
    def change(data: Dataset) -> None:
        for keyword, value in values.items():
            setattr(data, keyword, value)

    return change
