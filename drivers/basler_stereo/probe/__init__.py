"""Diagnoses a camera that does not reply: checks each address, then connects as a procedure would."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from drivers.basler_stereo.control.broadcast_discovery import discover_cameras
from drivers.basler_stereo.pair import BaslerStereoPair
from drivers.basler_stereo.probe.camera_discovery import example_pair, find_pairs
from drivers.basler_stereo.probe.camera_state import look_at_camera
from drivers.basler_stereo.probe.diagnosis import Expected, camera_diagnostic, discovery_diagnostic
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.probing import (
    Diagnostic,
    Inspection,
    Progress,
    Proposal,
    Search,
    connect_and_leave,
    leave_alone,
)
from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.host.network import Interface, interface_of

CAMERAS_SHARE = 0.5  # of the whole probe; the rest is for connecting


class BaslerProbe:
    """The probe of this driver; its `look_at` also serves bare endpoints, its `find` a new theatre file."""

    endpoint_schemes = frozenset({"gev"})
    table = "stereo"

    def __call__(
        self, name: str, config: DeviceConfig, progress: Progress, inspect: Inspection = leave_alone
    ) -> Sequence[Diagnostic]:
        diagnostics = self._cameras(_expected(config), lambda share: progress(CAMERAS_SHARE * share))
        advice = next((diagnostic.advice for diagnostic in diagnostics if not diagnostic.well), "")
        return (*diagnostics, *connect_and_leave(name, config, BaslerStereoPair, advice, inspect))

    def look_at(self, endpoints: Sequence[Endpoint], progress: Progress) -> Sequence[Diagnostic]:
        return self._cameras([Expected(endpoint) for endpoint in endpoints], progress)

    def find(self, search: Search, progress: Progress) -> Sequence[Proposal]:
        return find_pairs(search, progress)

    def example(self, search: Search) -> Proposal:
        return example_pair()

    def _cameras(self, cameras: Sequence[Expected], progress: Progress) -> Sequence[Diagnostic]:
        """Broadcast discovery on the cameras' own networks, then each address."""
        networks = {network: discover_cameras(network) for network in dict.fromkeys(_networks(cameras))}
        named = {camera.endpoint.host for camera in cameras}
        replies = [each for replied in networks.values() for each in replied]
        found = sorted(replies, key=lambda each: each.address not in named)  # our own first
        diagnostics = [
            discovery_diagnostic(network, replied) for network, replied in networks.items() if replied
        ]
        for number, camera in enumerate(cameras, start=1):
            diagnostics.append(camera_diagnostic(look_at_camera(camera.endpoint), found, camera))
            progress(number / len(cameras))
        return diagnostics


def _networks(cameras: Sequence[Expected]) -> Iterator[Interface]:
    for camera in cameras:
        if (network := interface_of(camera.endpoint.host)) is not None:
            yield network


def _expected(config: DeviceConfig) -> list[Expected]:
    """The cameras of a theatre file; invalid options and endpoints are reported by the driver itself."""
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


probe = BaslerProbe()
