"""Listens on a camera's message channel: acknowledges every message and counts it once."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Mapping

from drivers.basler_stereo.control.channel import ControlChannel
from drivers.basler_stereo.errors import CommandRefused
from drivers.basler_stereo.events.messages import WANTED, EventCounters, decode_message
from drivers.basler_stereo.features.feature_map import FeatureMap
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import Bootstrap

LOOK_UP_S = 0.2  # how soon the thread notices that it must end
JOIN_LIMIT_S = 1.0
DATAGRAM_LIMIT_BYTES = 2048
ACKNOWLEDGE_LIMIT_MS = 300  # a busy driver acknowledges late; then the camera repeats
RETRIES = 5
NOTIFICATION_ON = ("On", "GenICamEvent")  # the second in older cameras of the vendor


class EventListener:
    """A thread that receives from one camera; `names` are the events by their id on the wire."""

    def __init__(self, local_address: str, camera_address: str, names: Mapping[int, str], side: str) -> None:
        self.counters = EventCounters()
        self._camera_address = camera_address
        self._names = names
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((local_address, 0))
        self._socket.settimeout(LOOK_UP_S)
        self._last_id: int | None = None
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"stereo-{side}-events", daemon=True)
        self._thread.start()

    @property
    def address(self) -> tuple[str, int]:
        """Where the camera must send its messages."""
        host, port = self._socket.getsockname()
        return str(host), int(port)

    def close(self) -> None:
        """End the thread."""
        self._ending.set()
        self._thread.join(JOIN_LIMIT_S)
        self._socket.close()

    def _run(self) -> None:
        while not self._ending.is_set():
            try:
                datagram, sender = self._socket.recvfrom(DATAGRAM_LIMIT_BYTES)
            except TimeoutError:
                continue
            except OSError:
                return
            if sender[0] == self._camera_address:
                self._take(datagram, sender)

    def _take(self, datagram: bytes, sender: tuple[str, int]) -> None:
        message = decode_message(datagram)
        if message is None:
            return
        if message.wants_acknowledge:
            with contextlib.suppress(OSError):
                self._socket.sendto(message.acknowledge(), sender)
        if message.wants_acknowledge and message.request_id == self._last_id:
            self.counters.repeated_messages += 1
            return
        self._last_id = message.request_id
        for item in message.items:
            self.counters.count(self._names.get(item.event_id))


def subscribe(
    control: ControlChannel, features: FeatureMap, listener: EventListener, deadline_s: float
) -> tuple[str, ...]:
    """Point the message channel here and enable the wanted events; returns those that the camera has.

    Raises GEV-006, GEV-007.
    """
    host, port = listener.address
    control.write_register(Bootstrap.MCDA, int.from_bytes(socket.inet_aton(host), "big"), deadline_s)
    for register, value in ((Bootstrap.MCTT_MS, ACKNOWLEDGE_LIMIT_MS), (Bootstrap.MCRC, RETRIES)):
        with contextlib.suppress(CommandRefused):  # optional or restricted: its own values apply
            control.write_register(register, value, deadline_s)
    control.write_register(Bootstrap.MCP, port & gev.MCP_PORT_MASK, deadline_s)
    selectable = [name for name in WANTED if name in features.entries("EventSelector")]
    for name in selectable:
        features.choose("EventSelector", name)
        entries = features.entries("EventNotification")
        features.choose("EventNotification", next(entry for entry in NOTIFICATION_ON if entry in entries))
    return tuple(selectable)


def has_events(control: ControlChannel, features: FeatureMap, deadline_s: float) -> bool:
    """True for a camera with a message channel and selectable events."""
    with contextlib.suppress(CommandRefused):
        return (
            control.read_register(Bootstrap.MESSAGE_CHANNELS, deadline_s) > 0
            and features.has("EventSelector")
            and any(entry in features.entries("EventNotification") for entry in NOTIFICATION_ON)
        )
    return False
