"""Takes control of a camera, waiting while a dead controller still has it.

A camera keeps the privilege of a dead client until that client's heartbeat times out.
"""

from __future__ import annotations

import time

from drivers.basler_stereo.control.channel import ControlChannel
from drivers.basler_stereo.errors import CommandRefused, ControlLost, ControlTaken
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import Bootstrap, GevStatus

ASK_AGAIN_S = 0.1
LAPSE_MARGIN_S = 0.5  # cameras check their timer only now and then


def take_control(control: ControlChannel, who: str, deadline_s: float) -> None:
    """Take the control privilege; `who` names the camera in the message.

    Retries until the current controller's heartbeat time-out has passed, within the deadline (host monotonic
    time). Raises GEV-005 when that controller is alive or time is up, GEV-006, GEV-007.
    """
    give_up_s: float | None = None
    while (refusal := _ask(control, deadline_s)) is not None:
        if give_up_s is None:
            give_up_s = _lapse_s(control, deadline_s)
        if time.monotonic() + 2 * ASK_AGAIN_S >= give_up_s:  # time for one more try, not two
            raise ControlTaken(f"{who} is controlled by another application", got=refusal)
        time.sleep(ASK_AGAIN_S)


def require_control(control: ControlChannel, deadline_s: float) -> None:
    """Raise GEV-015 unless we control the camera, GEV-007 when it does not reply."""
    try:
        privilege = control.read_register(Bootstrap.CCP, deadline_s)
    except CommandRefused as error:  # while another client has exclusive access, even reading is rejected
        raise ControlLost(f"{control.address} is controlled by another application") from error
    if not privilege & (gev.CCP_CONTROL | gev.CCP_EXCLUSIVE):
        raise ControlLost(f"{control.address} has released control", got=f"privilege {privilege}")


def _ask(control: ControlChannel, deadline_s: float) -> str | None:
    """None if we have control, otherwise the reason for the refusal."""
    try:
        control.write_register(Bootstrap.CCP, gev.CCP_CONTROL, deadline_s)
        privilege = control.read_register(Bootstrap.CCP, deadline_s)
    except CommandRefused as error:
        if error.status != GevStatus.ACCESS_DENIED:
            raise
        return "access denied"
    return None if privilege & gev.CCP_CONTROL else f"privilege {privilege}"


def _lapse_s(control: ControlChannel, deadline_s: float) -> float:
    """When a controller that is dead now will lose control; never later than the deadline."""
    try:
        timeout_ms = control.read_register(Bootstrap.HEARTBEAT_TIMEOUT_MS, deadline_s)
    except CommandRefused:  # exclusive access: others cannot even read
        return deadline_s
    return min(deadline_s, time.monotonic() + timeout_ms / 1000.0 + LAPSE_MARGIN_S)
