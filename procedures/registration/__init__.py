"""Correspondence, rigid fit and the prediction of its error.

    from procedures.registration import match, register

The names load on first use, so that importing this package costs nothing until it computes.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from procedures.registration.cloud_registration import CloudFit, register_clouds
    from procedures.registration.correspondence import Hypothesis, Match, MatchStatus, Prior
    from procedures.registration.error_theory import (
        FreGate,
        fle_from_fre_mm,
        fle_of_one_space_mm,
        fre_gate,
        fre_limit_mm,
    )
    from procedures.registration.layout import FoundLayout, find_layout
    from procedures.registration.matching import match
    from procedures.registration.point_registration import (
        Caveat,
        Registration,
        TargetError,
        drop_one_explanations,
        register,
    )
    from procedures.registration.template import match_by_template
    from procedures.registration.verification import (
        RoomPoint,
        TwoWayTable,
        verify_two_way,
    )

__all__ = [
    "Caveat",
    "CloudFit",
    "FoundLayout",
    "FreGate",
    "Hypothesis",
    "Match",
    "MatchStatus",
    "Prior",
    "Registration",
    "RoomPoint",
    "TargetError",
    "TwoWayTable",
    "drop_one_explanations",
    "find_layout",
    "fle_from_fre_mm",
    "fle_of_one_space_mm",
    "fre_gate",
    "fre_limit_mm",
    "match",
    "match_by_template",
    "register",
    "register_clouds",
    "verify_two_way",
]

_HOMES = {
    "cloud_registration": ("CloudFit", "register_clouds"),
    "error_theory": (
        "FreGate",
        "fle_from_fre_mm",
        "fle_of_one_space_mm",
        "fre_gate",
        "fre_limit_mm",
    ),
    "point_registration": ("Caveat", "Registration", "TargetError", "drop_one_explanations", "register"),
    "correspondence": ("Hypothesis", "Match", "MatchStatus", "Prior"),
    "layout": ("FoundLayout", "find_layout"),
    "matching": ("match",),
    "template": ("match_by_template",),
    "verification": ("RoomPoint", "TwoWayTable", "verify_two_way"),
}


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names:
            value = getattr(import_module(f"procedures.registration.{module}"), name)
            globals()[name] = value
            return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
