"""A complete camera: settings, acquisition, channels, registers and control port."""

from __future__ import annotations

import time
from collections.abc import Callable
from copy import deepcopy

from ronna_hw.clock import SharedClock
from ronna_hw.wire.gige_vision import GevStatus
from sim.basler.camera.acquisition import Acquisition
from sim.basler.camera.photographer import Photographer
from sim.basler.control.bootstrap import Identity, add_bootstrap, add_message_channel
from sim.basler.control.feature_table import add_features
from sim.basler.control.output_line import exposure_level
from sim.basler.control.port import Actions, GvcpPort, ReplayCache
from sim.basler.control.privilege import Privilege
from sim.basler.control.registers import RegisterMap, RegisterRefusal
from sim.basler.faults import NO_FAULTS, CameraFaults
from sim.basler.message_channel import EventReporter, MessageChannel
from sim.basler.settings import CameraSettings, Ticks, TriggerMoments, UserSet
from sim.basler.stream_channel import StreamChannel


class SimulatedCamera:
    """A GigE Vision camera without a control socket; pass datagrams to `port`.

    `now_s` is the host's monotonic clock, used for the heartbeat; `is_line_lit` tells whether the line laser
    lights a frame that starts now.
    """

    def __init__(
        self,
        identity: Identity,
        source: Photographer,
        clock: SharedClock,
        moments: TriggerMoments,
        *,
        faults: CameraFaults = NO_FAULTS,
        now_s: Callable[[], float] = time.monotonic,
        is_line_lit: Callable[[], bool] = lambda: False,
    ) -> None:
        self.identity = identity
        self.settings = CameraSettings()
        self._user_sets: dict[int, CameraSettings] = {UserSet.DEFAULT: CameraSettings()}
        self.privilege = Privilege(now_s, self._release_control)
        self.faults = faults
        self.channel = StreamChannel(identity.address, self._owner_address, faults)
        self.messages = MessageChannel(identity.address, self._owner_address, now_s, faults)
        ticks = self._ticks = Ticks(clock, faults)
        self.acquisition = Acquisition(
            identity.user_name,
            lambda: self.settings,
            source,
            self.channel,
            clock,
            ticks,
            moments,
            EventReporter(lambda: self.settings, self.messages, ticks).report,
            faults,
            is_line_lit,
        )
        self.registers = RegisterMap()
        add_bootstrap(
            self.registers, identity, self.privilege, self.channel, ticks, lambda: self.acquisition.running
        )
        add_message_channel(self.registers, self.messages)
        add_features(self.registers, self)
        self.port = GvcpPort(
            self.registers,
            self.privilege,
            ReplayCache(now_s),
            Actions(self.channel.repeat, self._accept_action),
            mac=identity.mac,
            address=identity.address_bytes,
            refreshes_heartbeat=lambda: not faults.active("deaf"),
        )

    def open(self) -> None:
        """Start the acquisition thread."""
        self.acquisition.open()

    def close(self) -> None:
        """Stop acquiring and close the channels immediately."""
        self.acquisition.close()
        self.channel.shut()
        self.messages.shut()

    @property
    def output_held_low(self) -> bool:
        """Whether the output line does not follow its source."""
        return self.faults.active("hold_line")

    @property
    def lights_exposure(self) -> bool:
        """Whether the output line is high while a frame is exposed."""
        return exposure_level(self.settings) and not self.output_held_low

    def load_user_set(self) -> None:
        """Load the selected user set, or the power-on values if it was never saved."""
        selected, locked = self.settings.user_set_selector, self.settings.parameters_locked
        settings = deepcopy(self._user_sets.get(selected, self._user_sets[UserSet.DEFAULT]))
        settings.user_set_selector, settings.parameters_locked = selected, locked
        self.settings = settings

    def save_user_set(self) -> None:
        """Save the present settings to the selected user set; raises RegisterRefusal for the default set."""
        selected = self.settings.user_set_selector
        if selected == UserSet.DEFAULT:
            raise RegisterRefusal(GevStatus.WRITE_PROTECT)
        self._user_sets[selected] = deepcopy(self.settings)

    def apply_faults(self) -> None:
        """Apply the momentary faults since the last call, and any seized control privilege."""
        if self.faults.happened("restart"):
            self.restart()
        if self.faults.happened("pulse"):
            self.acquisition.line()
        self.privilege.seize(self.faults.active("taken"))

    def restart(self) -> None:
        """Power-cycle the camera: drop control and restore power-on settings, but keep saved user sets."""
        self.privilege.drop()
        self.acquisition.stop()
        self.channel.shut()
        self.messages.shut()
        self.settings = CameraSettings()
        self._ticks.reset()

    def _owner_address(self) -> str | None:
        owner = self.privilege.owner
        return None if owner is None else owner[0]

    def _release_control(self) -> None:
        """Stop all activity, because it requires an application in control."""
        self.acquisition.stop()
        self.channel.shut()
        self.messages.shut()
        self.settings.parameters_locked = 0

    def _accept_action(self, device_key: int, group_key: int, group_mask: int) -> bool:
        settings = self.settings
        addressed = (
            device_key == settings.action_device_key
            and group_key == settings.action_group_key
            and bool(group_mask & settings.action_group_mask)
        )
        if addressed:
            self.acquisition.action()
        return addressed
