"""Set-up checks: every device answers, is the right one, is configured; the calibrations are valid."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from procedures.engine.errors import WrongTool
from procedures.engine.step import Outcome, StepContext, StepSpec
from procedures.relocalization.triangulation import check_serial
from ronna_hw.calibration import DatedRecord
from ronna_hw.devices.lifecycle import Device, Identity

STEREO_HEAD_NUMBER = 1  # as the controller's inputs report it; 0 is an empty mount


def run(context: StepContext) -> Outcome:
    """Connect and configure all devices; check calibrations, serial numbers and the mounted tool."""
    now = datetime.now(UTC)
    calibrations = context.calibrations
    for record in (calibrations.stereo_head, calibrations.tool_tip, calibrations.tracker_frame):
        record.check_valid_at(now)
    devices: dict[str, Device] = {
        "tracker": context.devices.tracker,
        "arm": context.devices.arm,
        "stereo": context.devices.stereo,
    }
    identities: dict[str, Any] = {}
    for number, (role, device) in enumerate(devices.items()):
        context.progress(number / len(devices), f"connecting the {role}")
        identities[role] = _payload(device.connect())
        device.configure()
    notices = [
        f"{role}: {notice}" for role, device in devices.items() for notice in getattr(device, "notices", ())
    ]
    left, right = context.devices.stereo.serials
    check_serial(calibrations.stereo_head.left, left)
    check_serial(calibrations.stereo_head.right, right)
    mounted = context.devices.arm.read_tool_identity().number
    if mounted != STEREO_HEAD_NUMBER:
        raise WrongTool("the stereo head is not mounted", expected=str(STEREO_HEAD_NUMBER), got=str(mounted))
    return Outcome(
        payload={
            "identities": identities,
            "notices": notices,
            "calibrations": {
                name: _calibration(getattr(calibrations, name))
                for name in ("stereo_head", "tool_tip", "tracker_frame")
            },
            "home_rad": list(context.devices.arm.read_state().joints_rad),
        },
        summary="; ".join([", ".join(identity["model"] for identity in identities.values()), *notices]),
    )


def _payload(identity: Identity) -> dict[str, Any]:
    return {
        "vendor": identity.vendor,
        "model": identity.model,
        "serial": identity.serial,
        "firmware": identity.firmware,
    }


def _calibration(record: DatedRecord) -> dict[str, Any]:
    return record.model_dump(mode="json")


STEP = StepSpec("set_up", "Connect and check the devices", needs=("plan_check",), run=run)
