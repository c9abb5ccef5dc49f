"""Point correspondence, rigid registration, and prediction of the registration error.

    from procedures.registration import match, register

Names load on first use, so that importing this package is cheap.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ronna_hw.lazy_names import resolve_lazily

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

__getattr__ = resolve_lazily(__name__, __all__, _MODULES)


def __dir__() -> list[str]:
    return list(__all__)
