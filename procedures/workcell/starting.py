"""Starts devices; an arm that needs a person's word before gets it from the operator, or stays off."""

from __future__ import annotations

from collections.abc import Iterable

from procedures.workcell.supervised_motion import SupervisedMotion
from ronna_hw.devices.lifecycle import Device, Lifecycle
from ronna_hw.devices.robot import ConfirmedStart

OPERATOR = "the operator of the case"  # who the person is stands in the journal, with the answer


def start(devices: Iterable[Device], motion: SupervisedMotion) -> None:
    """Activate those that are configured. Raises PRO-002 unless the operator confirms what a driver asks."""
    for device in devices:
        if device.state is not Lifecycle.CONFIGURED:
            continue
        words = device.to_confirm if isinstance(device, ConfirmedStart) else None
        if isinstance(device, ConfirmedStart) and words is not None and motion.confirm_start(words):
            device.confirm_start(OPERATOR)
            motion.start(device.activate)
        else:
            device.activate()
