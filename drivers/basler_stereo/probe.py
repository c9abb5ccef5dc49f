"""Diagnosis of unresponsive cameras and search for camera pairs on local networks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations

from pydantic import ValidationError

from drivers.basler_stereo.camera_check import (
    ExpectedCamera,
    camera_diagnostic,
    check_camera,
    diagnose_output_line,
    discovery_diagnostic,
)
from drivers.basler_stereo.identity import CameraIdentity, discover_cameras
from drivers.basler_stereo.options import BaslerOptions, ProjectorOptions
from drivers.basler_stereo.pair import BaslerStereoPair
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.probing import (
    Diagnostic,
    Inspection,
    Progress,
    Proposal,
    Search,
    connect_and_identify,
    describe_options,
    inspect_nothing,
    reporting,
)
from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.host.network import find_interface
from ronna_hw.text import printable
from ronna_hw.wire import gige_vision as gev

DRIVER = "basler_stereo"
SIDES = ("left", "right")
EXAMPLE_ADDRESSES = ("192.168.3.10", "192.168.3.11")
EXAMPLE_SERIALS = ("21904411", "21904412")
SIDES_REMARK = "left and right: cover one lens and see which image goes dark; swap both lines if necessary."
NAMED_REMARK = "The names stored in the cameras identify left and right."
CAMERAS_SHARE = 0.5  # of the whole probe; the rest is for connecting


class BaslerProbe:
    """Diagnosis and discovery for the Basler driver."""

    endpoint_schemes = frozenset({"gev"})
    table = "stereo"

    def __call__(
        self, name: str, config: DeviceConfig, progress: Progress, inspect: Inspection = inspect_nothing
    ) -> Sequence[Diagnostic]:
        diagnostics = self._diagnose_cameras(
            _read_expected_cameras(config), lambda share: progress(CAMERAS_SHARE * share)
        )
        diagnostics = [*diagnostics, *_diagnose_projector(config)]
        advice = next((diagnostic.advice for diagnostic in diagnostics if not diagnostic.well), "")
        return (*diagnostics, *connect_and_identify(name, config, BaslerStereoPair, advice, inspect))

    def probe_endpoints(self, endpoints: Sequence[Endpoint], progress: Progress) -> Sequence[Diagnostic]:
        return self._diagnose_cameras([ExpectedCamera(endpoint) for endpoint in endpoints], progress)

    def find(self, search: Search, progress: Progress) -> Sequence[Proposal]:
        """Propose pairs of cameras of the same model and owner; those named left and right take precedence.

        Each network is queried with one broadcast; no camera is controlled.
        """
        cameras: dict[str, CameraIdentity] = {}  # by address
        for network in reporting(search.interfaces, progress):
            cameras |= {each.address: each for each in discover_cameras(network)}
        pairs = [
            (camera_a, camera_b)
            for camera_a, camera_b in permutations(cameras.values(), 2)
            if (camera_a.model, camera_a.info) == (camera_b.model, camera_b.info)
            and camera_a.serial != camera_b.serial
        ]
        named = [pair for pair in pairs if tuple(each.user_name.lower() for each in pair) == SIDES]
        return [_make_proposal(*pair, named=pair in named) for pair in named or pairs]

    def example(self, search: Search) -> Proposal:
        chosen = dict(zip(("left_serial", "right_serial"), EXAMPLE_SERIALS, strict=True))
        options = describe_options(BaslerOptions, chosen)
        return Proposal(DRIVER, "", _endpoints(EXAMPLE_ADDRESSES), options, (SIDES_REMARK,))

    def _diagnose_cameras(
        self, cameras: Sequence[ExpectedCamera], progress: Progress
    ) -> Sequence[Diagnostic]:
        """Broadcast discovery on the cameras' own networks, then check each address."""
        own_networks = filter(None, (find_interface(camera.endpoint.host) for camera in cameras))
        networks = {network: discover_cameras(network) for network in dict.fromkeys(own_networks)}
        named = {camera.endpoint.host for camera in cameras}
        replies = [each for replied in networks.values() for each in replied]
        found = sorted(replies, key=lambda each: each.address not in named)  # our own first
        diagnostics = [
            discovery_diagnostic(network, replied) for network, replied in networks.items() if replied
        ]
        for camera in reporting(cameras, progress):
            diagnostics.append(camera_diagnostic(check_camera(camera.endpoint), found, camera))
        return diagnostics


probe = BaslerProbe()


def _read_expected_cameras(config: DeviceConfig) -> list[ExpectedCamera]:
    """List the cameras of a theatre file; the driver itself reports invalid options."""
    model = _option_text(config, "expected_model")
    sides = {side: parse_endpoint(text) for side, text in config.endpoints.items()}
    return [
        ExpectedCamera(endpoint, _option_text(config, f"{side}_serial"), model)
        for side, endpoint in sides.items()
        if endpoint.scheme == "gev"
    ]


def _diagnose_projector(config: DeviceConfig) -> Iterator[Diagnostic]:
    """Yield the finding on the projector's line, if a valid projector is named and its camera replies."""
    try:
        projector = ProjectorOptions.model_validate(config.options["projector"])
        endpoint = parse_endpoint(config.endpoints[projector.camera])
    except (KeyError, ValidationError):  # the driver itself reports invalid options
        return
    if (found := diagnose_output_line(endpoint, projector)) is not None:
        yield found


def _option_text(config: DeviceConfig, option: str) -> str | None:
    value = config.options.get(option)
    return value if isinstance(value, str) else None


def _make_proposal(left: CameraIdentity, right: CameraIdentity, *, named: bool) -> Proposal:
    chosen = {"left_serial": left.serial, "right_serial": right.serial}
    if left.model != gev.ACA2000_50GM_NIR:
        chosen["expected_model"] = left.model
    whose = f", {printable(left.info)}" if left.info else ""
    return Proposal(
        DRIVER,
        f"{left.vendor} {left.model} {left.serial} (left) and {right.serial} (right){whose}",
        _endpoints((left.address, right.address)),
        describe_options(BaslerOptions, chosen),
        (NAMED_REMARK if named else SIDES_REMARK,),
    )


def _endpoints(addresses: tuple[str, str]) -> dict[str, str]:
    return {side: f"gev://{address}" for side, address in zip(SIDES, addresses, strict=True)}
