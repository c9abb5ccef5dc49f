"""Set-up: connect, identify and configure devices; check calibrations and tool records."""

from __future__ import annotations

import json
from collections.abc import Mapping
from itertools import combinations
from typing import Any

from pydantic import Field

from procedures.calibration.validity import require_valid
from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.journal.results import StepResult, Values
from procedures.operator.question import Topic
from procedures.planning.tool_records import check_patient_frame
from procedures.relocalization.triangulation import check_serial
from procedures.workcell import MountedTool
from procedures.workcell.tools import require_this_arm, require_two_arms
from ronna_hw.collision_config import CollisionConfig
from ronna_hw.config import Calibrations, DeviceConfig, ProcedureSettings
from ronna_hw.devices.lifecycle import Identity, Lifecycle
from ronna_hw.roles import ASSISTANT, MASTER
from ronna_hw.tool_record import ToolRecord
from ronna_hw.vectors import JointVector


class DeviceIdentity(Values):
    """Identity reported by a device."""

    vendor: str = Field(description="Maker.")
    model: str = Field(description="Model.")
    serial: str = Field(description="Serial number.")
    firmware: str = Field(description="Version of its firmware.")

    @classmethod
    def from_identity(cls, identity: Identity) -> DeviceIdentity:
        """Convert the identity reported by a driver."""
        return cls.model_validate(identity, from_attributes=True)


class DriverSettings(Values):
    """Driver of a device and its options, as the theatre file states them; addresses may change."""

    driver: str = Field(description="Name of the driver.")
    options: dict[str, str] = Field(description="Each stated option, in JSON.")

    @classmethod
    def of(cls, config: DeviceConfig) -> DriverSettings:
        """Take the settings from a device's table."""
        return cls(
            driver=config.driver,
            options={name: json.dumps(value, default=str) for name, value in sorted(config.options.items())},
        )


class CheckedSetUp(StepResult, kind="set_up", version=2):
    """Devices, calibrations, tools and cell used in the case."""

    identities: dict[str, DeviceIdentity] = Field(
        description="By role: tracker, arm, stereo, and device.NAME as in the theatre file."
    )
    drivers: dict[str, DriverSettings] = Field(
        default_factory=dict, description="Drivers and their options by table: tracker, robot.NAME, stereo."
    )
    notices: tuple[str, ...] = Field(description="Notices of the drivers for the operator.")
    calibrations: Calibrations = Field(description="The calibration records in use.")
    tools: dict[str, ToolRecord] = Field(description="The records of the tools, by name.")
    flange: str = Field(description="Name of the flange that the tools are mounted on.")
    cell: CollisionConfig = Field(description="The bodies around the arm, with those of the tools.")
    settings: ProcedureSettings = Field(description="Settings and assumptions of the procedure.")
    homes_rad: dict[str, JointVector] = Field(
        description="Measured joints of each arm at the start, by its role; there it also parks."
    )

    @classmethod
    def renew(cls, plain: Mapping[str, Any]) -> Mapping[str, Any]:
        """Read a result that has a field for the home of each arm."""
        if "home_rad" not in plain:
            return plain
        homes = {MASTER: plain["home_rad"], ASSISTANT: plain.get("assistant_home_rad")}
        newer = {name: value for name, value in plain.items() if not name.endswith("home_rad")}
        return newer | {"homes_rad": {role: home for role, home in homes.items() if home is not None}}


def run(context: StepContext) -> Outcome[CheckedSetUp]:
    """Connect and configure all devices; check calibrations, serial numbers and the mounted tool.

    Raises CAL-001 for an expired record, TOOL-002 and TOOL-003 for an unfit tool record, TOOL-008 for a
    patient's frame that is another one. Raises DEV-003 for a frame unknown to the tracker, CAL-013 for
    another arm, DUAL-004 for one arm in both roles, STE-010 for another camera, PRO-009 for another tool.
    Raises CAL-020 and CAL-021 for an arm calibrated with another stereo head or tip. Raises PRO-002 unless
    the position of an arm left by an earlier run is confirmed.
    """
    workcell = context.workcell
    calibrations = workcell.calibrations.of_arms(workcell.arms)
    require_valid(calibrations, context.setting.today(), starts=context.setting.starts)
    workcell.tools.check(calibrations, context.setting.today())
    workcell.tools.check_frames(calibrations, workcell.tracker.tools)
    if (on_clamp := workcell.patient_frame) is not None:
        check_patient_frame(on_clamp, calibrations, workcell.tracker.markers_mm)
    devices = workcell.devices
    identities: dict[str, DeviceIdentity] = {}
    for number, (role, device) in enumerate(devices.items()):
        context.progress(number / len(devices), f"connecting the {role}")
        identities[role] = DeviceIdentity.from_identity(device.connect())
        device.configure()
    notices = tuple(f"{role}: {notice}" for role, device in devices.items() for notice in device.notices)
    for one, other in combinations((identities[arm.name] for arm in workcell.arms.values()), 2):
        require_two_arms((one.model, one.serial), (other.model, other.serial))
    for role, arm in workcell.arms.items():
        require_this_arm(calibrations.arms, identities[arm.name].serial, role)
    left, right = workcell.stereo.serials
    check_serial(calibrations.stereo_head.left, left)
    check_serial(calibrations.stereo_head.right, right)
    workcell.master.mount.check(MountedTool.STEREO_HEAD)
    if context.setting.arm_not_home is not None:
        subject = "Take the arm's present position as its home, where tools are exchanged and the case ends?"
        context.confirm(Topic.RESUME, subject, context.setting.arm_not_home)
    return Outcome(
        CheckedSetUp(
            identities=identities,
            drivers={name: DriverSettings.of(config) for name, config in workcell.device_tables.items()},
            notices=notices,
            calibrations=calibrations,
            tools=dict(workcell.tools.records),
            flange=workcell.tools.flange,
            cell=context.setting.surroundings,
            settings=context.setting.settings,
            homes_rad={role: arm.set_home() for role, arm in workcell.arms.items()},
        ),
        summary="; ".join(
            [", ".join(f"{role} {identity.model}" for role, identity in identities.items()), *notices]
        ),
    )


def _needs_disconnection(context: StepContext) -> tuple[str, ...]:
    """Require all devices disconnected, since a second connection would conflict with the first."""
    connected = [
        role
        for role, device in context.workcell.devices.items()
        if device.state is not Lifecycle.DISCONNECTED
    ]
    return (f"already connected: {', '.join(connected)}",) if connected else ()


STEP = StepSpec(
    CheckedSetUp,
    "Connect and check the devices",
    Phase.PREPARATION,
    run,
    asks=(Topic.RESUME,),
    preconditions=_needs_disconnection,
)
