"""Pairs of cameras on the searched networks, each as a theatre file entry."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations
from typing import Any

from drivers.basler_stereo.control.broadcast_discovery import discover_cameras
from drivers.basler_stereo.control.identity import CameraIdentity
from drivers.basler_stereo.options import BaslerOptions
from ronna_hw.devices.probing import Option, Progress, Proposal, Search, documented_options
from ronna_hw.wire import gige_vision as gev

DRIVER = "basler_stereo"
SIDES = ("left", "right")
EXAMPLE_ADDRESSES = ("192.168.3.10", "192.168.3.11")
EXAMPLE_SERIALS = ("21904411", "21904412")
WHICH_IS_LEFT = "left and right: cover one lens and see which image goes dark; swap both lines if necessary."
NAMES_TELL = "The names stored in the cameras identify left and right."


def find_pairs(search: Search, progress: Progress) -> Sequence[Proposal]:
    """Every ordered pair of cameras of one model, starting with those whose own names say left and right.

    Each network is queried with one broadcast; no camera is controlled.
    """
    cameras: dict[str, CameraIdentity] = {}  # by address
    for number, network in enumerate(search.interfaces, start=1):
        cameras |= {each.address: each for each in discover_cameras(network)}
        progress(number / len(search.interfaces))
    pairs = [pair for pair in permutations(cameras.values(), 2) if _a_pair(*pair)]
    named = [pair for pair in pairs if tuple(each.user_name.lower() for each in pair) == SIDES]
    return [_proposal(*pair, named=pair in named) for pair in named or pairs]


def _a_pair(one: CameraIdentity, other: CameraIdentity) -> bool:
    return one.model == other.model and one.serial != other.serial


def example_pair() -> Proposal:
    """The table for a pair that was not found."""
    chosen = dict(zip(("left_serial", "right_serial"), EXAMPLE_SERIALS, strict=True))
    return Proposal(DRIVER, "", _endpoints(EXAMPLE_ADDRESSES), _options(chosen), (WHICH_IS_LEFT,))


def _proposal(left: CameraIdentity, right: CameraIdentity, *, named: bool) -> Proposal:
    chosen = {"left_serial": left.serial, "right_serial": right.serial}
    if left.model != gev.ACA2000_50GM_NIR:
        chosen["expected_model"] = left.model
    return Proposal(
        DRIVER,
        f"{left.vendor} {left.model} {left.serial} (left) and {right.serial} (right)",
        _endpoints((left.address, right.address)),
        _options(chosen),
        (NAMES_TELL if named else WHICH_IS_LEFT,),
    )


def _endpoints(addresses: tuple[str, str]) -> dict[str, str]:
    return {side: f"gev://{address}" for side, address in zip(SIDES, addresses, strict=True)}


def _options(chosen: dict[str, Any]) -> tuple[Option, ...]:
    return documented_options(BaslerOptions, chosen)
