"""Diagnosis of cameras that do not reply, and search for pairs on the networks."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations
from typing import Any

from drivers.basler_stereo.camera_check import (
    Expected,
    camera_diagnostic,
    check_camera,
    discovery_diagnostic,
)
from drivers.basler_stereo.identity import CameraIdentity, discover_cameras
from drivers.basler_stereo.options import BaslerOptions
from drivers.basler_stereo.pair import BaslerStereoPair
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.probing import (
    Diagnostic,
    Inspection,
    Option,
    Progress,
    Proposal,
    Search,
    connect_and_leave,
    documented_options,
    leave_alone,
)
from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.host.network import interface_of
from ronna_hw.wire import gige_vision as gev

DRIVER = "basler_stereo"
SIDES = ("left", "right")
EXAMPLE_ADDRESSES = ("192.168.3.10", "192.168.3.11")
EXAMPLE_SERIALS = ("21904411", "21904412")
WHICH_IS_LEFT = "left and right: cover one lens and see which image goes dark; swap both lines if necessary."
NAMES_TELL = "The names stored in the cameras identify left and right."
CAMERAS_SHARE = 0.5  # of the whole probe; the rest is for connecting


class BaslerProbe:
    """Probe of this driver; `look_at` also serves bare endpoints, `find` a new theatre file."""

    endpoint_schemes = frozenset({"gev"})
    table = "stereo"

    def __call__(
        self, name: str, config: DeviceConfig, progress: Progress, inspect: Inspection = leave_alone
    ) -> Sequence[Diagnostic]:
        diagnostics = self._cameras(_expected_cameras(config), lambda share: progress(CAMERAS_SHARE * share))
        advice = next((diagnostic.advice for diagnostic in diagnostics if not diagnostic.well), "")
        return (*diagnostics, *connect_and_leave(name, config, BaslerStereoPair, advice, inspect))

    def look_at(self, endpoints: Sequence[Endpoint], progress: Progress) -> Sequence[Diagnostic]:
        return self._cameras([Expected(endpoint) for endpoint in endpoints], progress)

    def find(self, search: Search, progress: Progress) -> Sequence[Proposal]:
        """Propose every ordered pair of cameras of one model, first those named left and right.

        Each network is queried with one broadcast; no camera is controlled.
        """
        cameras: dict[str, CameraIdentity] = {}  # by address
        for number, network in enumerate(search.interfaces, start=1):
            cameras |= {each.address: each for each in discover_cameras(network)}
            progress(number / len(search.interfaces))
        pairs = [
            (one, other)
            for one, other in permutations(cameras.values(), 2)
            if one.model == other.model and one.serial != other.serial
        ]
        named = [pair for pair in pairs if tuple(each.user_name.lower() for each in pair) == SIDES]
        return [_proposal(*pair, named=pair in named) for pair in named or pairs]

    def example(self, search: Search) -> Proposal:
        chosen = dict(zip(("left_serial", "right_serial"), EXAMPLE_SERIALS, strict=True))
        return Proposal(DRIVER, "", _endpoints(EXAMPLE_ADDRESSES), _options(chosen), (WHICH_IS_LEFT,))

    def _cameras(self, cameras: Sequence[Expected], progress: Progress) -> Sequence[Diagnostic]:
        """Broadcast on the cameras' own networks, then check each address."""
        ours = filter(None, (interface_of(camera.endpoint.host) for camera in cameras))
        networks = {network: discover_cameras(network) for network in dict.fromkeys(ours)}
        named = {camera.endpoint.host for camera in cameras}
        replies = [each for replied in networks.values() for each in replied]
        found = sorted(replies, key=lambda each: each.address not in named)  # our own first
        diagnostics = [
            discovery_diagnostic(network, replied) for network, replied in networks.items() if replied
        ]
        for number, camera in enumerate(cameras, start=1):
            diagnostics.append(camera_diagnostic(check_camera(camera.endpoint), found, camera))
            progress(number / len(cameras))
        return diagnostics


probe = BaslerProbe()


def _expected_cameras(config: DeviceConfig) -> list[Expected]:
    """List the cameras of a theatre file; the driver itself reports invalid options and endpoints."""
    model = _text(config, "expected_model")
    sides = {side: parse_endpoint(text) for side, text in config.endpoints.items()}
    return [
        Expected(endpoint, _text(config, f"{side}_serial"), model)
        for side, endpoint in sides.items()
        if endpoint.scheme == "gev"
    ]


def _text(config: DeviceConfig, option: str) -> str | None:
    value = config.options.get(option)
    return value if isinstance(value, str) else None


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
