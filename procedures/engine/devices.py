"""The devices of one theatre, made from its file by the registry. Nothing is opened until a step asks."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

from procedures.engine.errors import IncompleteTheatre
from ronna_hw.clock import Clock
from ronna_hw.config import Calibrations, TheatreFile
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.robot import StopKind
from ronna_hw.errors import RonnaError
from ronna_hw.registry import make_device

if TYPE_CHECKING:
    from ronna_hw.devices import OpticalTracker, RobotArm, StereoPair

MASTER = "master"  # the arm that carries stereo head and guide


@dataclass(frozen=True)
class DeviceSet:
    """Tracker, master arm and stereo head."""

    tracker: OpticalTracker
    arm: RobotArm
    stereo: StereoPair

    def stop(self) -> None:
        """Bring the arm to rest as well as the link still allows; never raises."""
        if self.arm.state is Lifecycle.ACTIVE:
            with contextlib.suppress(RonnaError):
                self.arm.stop(StopKind.HOLD)

    def close(self) -> None:
        """End all sessions, the arm's first; never raises."""
        for device in (self.arm, self.stereo, self.tracker):
            device.close()


def make_devices(theatre: TheatreFile, clock: Clock) -> DeviceSet:
    """The devices that the procedure needs; raises PRO-006 naming each that the file lacks."""
    missing = [name for name in ("tracker", "stereo") if getattr(theatre, name) is None]
    if MASTER not in theatre.robot:
        missing.append(f"robot.{MASTER}")
    if missing or theatre.tracker is None or theatre.stereo is None:
        raise IncompleteTheatre(f"the theatre file has no {', '.join(missing)}")
    return DeviceSet(
        tracker=cast("OpticalTracker", make_device("tracker", theatre.tracker, clock)),
        arm=cast("RobotArm", make_device(f"robot.{MASTER}", theatre.robot[MASTER], clock)),
        stereo=cast("StereoPair", make_device("stereo", theatre.stereo, clock)),
    )


def calibrations_of(theatre: TheatreFile) -> Calibrations:
    """The calibration records; raises PRO-006 when the file has none."""
    if theatre.calibration is None:
        raise IncompleteTheatre("the theatre file has no calibration records")
    return theatre.calibration
