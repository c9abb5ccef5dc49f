"""Names of the strategies, with what each does, for commands and messages; imports nothing heavy."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

DEFAULT_STRATEGY = "ocs"
SCAN_OF_SKIN = "surface"  # not chosen by name: the plan decides
STRATEGY_NAMES: Mapping[str, str] = MappingProxyType(
    {
        "ocs": "as at the target (recommended)",
        "thesis-ocs": "ocs as published, for comparisons",
        "nos": "straight down, once for all targets",
        "jdms": "joints turned least",
        "improved": "where the arm errs most nearly as at the target, for a calibrated arm",
        "best": "whichever of ocs, jdms and improved predicts the smallest error",
        "learning": "poses of all of these, chosen to learn the arm's errors during the case",
    }
)
