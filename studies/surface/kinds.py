"""Kinds of misfit by their part in the study. Free of numerics, since commands import this at start-up."""

from __future__ import annotations

from enum import StrEnum


class Kinds(StrEnum):
    """Kinds of misfit that a study runs: those that judge, those seen during development, or both."""

    ALL = "all"
    JUDGED = "judged"
    DEVELOPMENT = "development"
