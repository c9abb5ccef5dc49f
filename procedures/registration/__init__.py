"""Point correspondence, rigid registration, and prediction of the registration error.

    from procedures.registration import match, register

Names load on first use, so that importing this package is cheap.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from procedures.registration.cloud_registration import CloudFit, register_clouds
    from procedures.registration.correspondence import Hypothesis, Match, MatchStatus, Prior
    from procedures.registration.matching import match
    from procedures.registration.point_registration import Caveat, Registration, TargetError, register
    from procedures.registration.template import FoundLayout, find_layout, match_by_template
    from procedures.registration.verification import RoomPoint, TwoWayTable, verify_two_way

__all__ = [
    "Caveat",
    "CloudFit",
    "FoundLayout",
    "Hypothesis",
    "Match",
    "MatchStatus",
    "Prior",
    "Registration",
    "RoomPoint",
    "TargetError",
    "TwoWayTable",
    "find_layout",
    "match",
    "match_by_template",
    "register",
    "register_clouds",
    "verify_two_way",
]

_MODULES = (
    "correspondence",
    "matching",
    "point_registration",
    "verification",
    "template",
    "cloud_registration",
)


def __getattr__(name: str) -> Any:
    for module in _MODULES if name in __all__ else ():
        home = import_module(f"procedures.registration.{module}")
        if hasattr(home, name):
            globals()[name] = getattr(home, name)
            return globals()[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
