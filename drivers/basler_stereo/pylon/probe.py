"""Diagnosis of a pypylon pair: addresses without the library, then a connection with it."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.basler_stereo import probe as cameras
from drivers.basler_stereo.pylon.camera import EMULATED
from drivers.basler_stereo.pylon.pair import PylonStereoPair
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.probing import (
    Diagnostic,
    Inspection,
    Progress,
    connect_and_identify,
    endpoints_of,
    inspect_nothing,
)


def probe(
    name: str, config: DeviceConfig, progress: Progress, inspect: Inspection = inspect_nothing
) -> Sequence[Diagnostic]:
    """Diagnose a camera pair as described in `Probe`; emulated cameras have no address to check."""
    emulated = config.options.get("device_class") == EMULATED
    addresses = [each for each in endpoints_of(config) if each.scheme == "gev" and not emulated]
    found = cameras.probe.probe_endpoints(addresses, progress)
    advice = next((each.advice for each in found if not each.well), "")
    return (*found, *connect_and_identify(name, config, PylonStereoPair, advice, inspect))
