"""The two connections to the controller: EKI, and the real-time process behind the RSI port."""

from __future__ import annotations

from drivers.kuka_rsi import stream
from drivers.kuka_rsi.eki.client import EkiClient, Listener
from drivers.kuka_rsi.eki.controller_state import ControllerState
from drivers.kuka_rsi.errors import ControllerNotFound, NoTelegram
from drivers.kuka_rsi.link_bytes import LinkBytes
from drivers.kuka_rsi.link_client import LinkClient
from drivers.kuka_rsi.options import KukaOptions
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.errors import RonnaError
from ronna_hw.wire.kuka_context import RsiContext


class Connections:
    """Opened and closed one by one; accessing one that is not open raises."""

    def __init__(self, name: str, config: DeviceConfig, options: KukaOptions, context: RsiContext) -> None:
        """Opens nothing. Raises CFG-001 or CFG-002 for a missing or invalid endpoint."""
        self._name = name
        self._rsi = config.address("rsi").require("udp")
        self._eki_address = config.address("eki_project").require("tcp")
        self._options = options
        self._context = context
        self.open_eki: EkiClient | None = None
        self.open_link: LinkClient | None = None
        self.bytes = LinkBytes(name)
        self.verified = False  # the controller reports that it runs our context

    @property
    def said(self) -> ControllerState | None:
        """The last state reported by the controller, requested or not."""
        return None if self.open_eki is None else self.open_eki.latest

    @property
    def eki(self) -> EkiClient:
        """The EKI connection; raises EKI-001 if there is none."""
        if self.open_eki is None:
            raise ControllerNotFound(f"{self._name}: no EKI connection is open")
        return self.open_eki

    @property
    def link(self) -> LinkClient:
        """The real-time process; raises RSI-002 if there is none."""
        if self.open_link is None:
            raise NoTelegram(f"{self._name}: no real-time process is running")
        return self.open_link

    def eki_answers(self, limit_s: float) -> bool:
        """Whether there is an EKI connection, unbroken, on which the controller replies in time."""
        if self.open_eki is None or self.open_eki.failure is not None:
            return False
        try:
            self.open_eki.status(limit_s)
        except RonnaError:
            return False
        return True

    def find_controller(self, timeout_s: float, listener: Listener, *, retry: bool = False) -> Identity:
        """Open the EKI connection and identify the controller; `retry`: repeatedly until the time limit.

        Raises EKI-001 when nothing answers, EKI-005 or EKI-006 for a different controller or set-up.
        """
        self.close_eki()
        opening = stream.reopen_controller if retry else stream.open_controller
        found = opening(self._eki_address, self._context, self._options, timeout_s, self.bytes.of_eki)
        self.open_eki, identity, self.verified = found
        self.open_eki.listen(listener)
        return identity

    def start_link(self, timeout_s: float) -> None:
        """Start the real-time process, which binds the RSI port. Raises RSI-001."""
        self.close_link()
        settings = stream.link_settings(self._rsi, self._context, self._options)
        self.open_link = LinkClient(settings, timeout_s, self.bytes.of_rsi)

    def close_eki(self) -> None:
        """End the EKI connection, if there is one."""
        if self.open_eki is not None:
            self.open_eki.close()
            self.open_eki = None

    def close_link(self) -> None:
        """End the real-time process, if there is one."""
        if self.open_link is not None:
            self.open_link.close()
            self.open_link = None
