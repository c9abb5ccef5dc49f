"""Diagnosis of an unresponsive arm, and an example of its table in a theatre file."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.universal_robots.arm import UniversalRobotsArm
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.probing import (
    Diagnostic,
    Inspection,
    Progress,
    connect_and_identify,
    inspect_nothing,
)


class UrProbe:
    """Diagnosis for the Universal Robots driver."""

    def __call__(
        self, name: str, config: DeviceConfig, progress: Progress, inspect: Inspection = inspect_nothing
    ) -> Sequence[Diagnostic]:
        """Connect, read identity and calibration, without starting anything or moving the arm."""
        return connect_and_identify(name, config, UniversalRobotsArm, inspect=inspect)


probe = UrProbe()
