"""Bootstrap registers required by the GigE Vision standard, including those of the message channel."""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable
from dataclasses import dataclass

from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import Bootstrap, GevStatus, GvcpCapability
from sim.basler.control.privilege import Privilege
from sim.basler.control.registers import Memory, RegisterMap, RegisterRefusal, RegisterWord
from sim.basler.control.xml import camera_xml
from sim.basler.message_channel import MessageChannel
from sim.basler.settings import Ticks
from sim.basler.stream_channel import (
    LARGEST_PACKET_SIZE,
    PACKET_SIZE_STEP,
    SMALLEST_PACKET_SIZE,
    StreamChannel,
    UdpChannel,
)

XML_ADDRESS = 0x100000
XML_NAME = "acA2000_50gmNIR.xml"
VERSION = 1 << 16 | 2
BASLER_MAC_PREFIX = bytes((0x00, 0x30, 0x53))
SERIAL_DIGITS_IN_MAC = 24  # bits
IP_CONFIGURATION_SUPPORTED, IP_CONFIGURATION = 7, 5  # persistent, DHCP, link-local; persistent, link-local
NETMASK = 0xFF000000  # of the loopback network
PENDING_TIMEOUT_MS = 5000
CHANNEL_CAPABILITY = 0x8000_0000  # of streams and messages: the source port is readable
DEVICE_VERSION = "1.0"
CAPABILITIES = (
    GvcpCapability.MULTIPLE_REGISTERS
    | GvcpCapability.WRITEMEM
    | GvcpCapability.PACKETRESEND
    | GvcpCapability.EVENT
    | GvcpCapability.EVENTDATA
    | GvcpCapability.ACTION
    | GvcpCapability.EXTENDED_STATUS
    | GvcpCapability.CCP_APPLICATION
    | GvcpCapability.SERIAL_NUMBER
    | GvcpCapability.USER_DEFINED_NAME
)

LONGEST_TIMEOUT_MS = 60_000
MOST_RETRIES = 100


@dataclass
class Identity:
    """Camera identity, of which a client may change only `user_name`."""

    address: str
    serial: str
    user_name: str
    info: str = "none"  # of the manufacturer; as a camera from the factory

    @property
    def mac(self) -> bytes:
        """Hardware address, composed of the vendor prefix and the end of the serial number."""
        number = int("".join(filter(str.isdigit, self.serial)) or "0") % (1 << SERIAL_DIGITS_IN_MAC)
        return BASLER_MAC_PREFIX + number.to_bytes(3, "big")

    @property
    def address_bytes(self) -> bytes:
        """IP address as four bytes."""
        return socket.inet_aton(self.address)


def add_bootstrap(
    registers: RegisterMap,
    identity: Identity,
    privilege: Privilege,
    channel: StreamChannel,
    ticks: Ticks,
    acquiring: Callable[[], bool],
) -> None:
    """Add the bootstrap registers of one camera, except CCP, which the control port writes itself."""
    _add_identity(registers, identity)
    _add_description(registers)
    _add_control(registers, privilege)
    _add_stream(registers, channel, acquiring)
    _add_time(registers, ticks)


def _add_identity(registers: RegisterMap, identity: Identity) -> None:
    texts = {
        Bootstrap.MANUFACTURER_NAME: gev.BASLER,
        Bootstrap.MODEL_NAME: gev.ACA2000_50GM_NIR,
        Bootstrap.DEVICE_VERSION: DEVICE_VERSION,
        Bootstrap.MANUFACTURER_INFO: identity.info,
        Bootstrap.SERIAL_NUMBER: identity.serial,
    }
    numbers = {
        Bootstrap.VERSION: VERSION,
        Bootstrap.DEVICE_MODE: gev.DEVICE_MODE_BIG_ENDIAN | gev.DEVICE_MODE_UTF8,
        Bootstrap.MAC_HIGH: int.from_bytes(identity.mac[:2], "big"),
        Bootstrap.MAC_LOW: int.from_bytes(identity.mac[2:], "big"),
        Bootstrap.IP_CONFIGURATION_SUPPORTED: IP_CONFIGURATION_SUPPORTED,
        Bootstrap.IP_CONFIGURATION: IP_CONFIGURATION,
        Bootstrap.CURRENT_ADDRESS: int.from_bytes(identity.address_bytes, "big"),
        Bootstrap.CURRENT_MASK: NETMASK,
        Bootstrap.CURRENT_GATEWAY: 0,
    }
    content = bytearray(Bootstrap.USER_DEFINED_NAME)
    for address, number in numbers.items():
        struct.pack_into(">I", content, address, number)
    for address, text in texts.items():
        value = text.encode()[: gev.TEXT_BYTES[address] - 1]
        content[address : address + len(value)] = value
    fixed = bytes(content)
    registers.add_memory(Memory(0, len(fixed), lambda: fixed))

    def rename(value: bytes) -> None:
        identity.user_name = value.split(b"\0")[0].decode(errors="replace")

    def name() -> bytes:
        return identity.user_name.encode()

    address = Bootstrap.USER_DEFINED_NAME
    registers.add_memory(Memory(address, gev.TEXT_BYTES[address], name, rename))


def _add_description(registers: RegisterMap) -> None:
    xml = camera_xml()
    padded = -(-len(xml) // 4) * 4
    registers.add_memory(Memory(XML_ADDRESS, padded, lambda: xml))
    url = f"{gev.URL_LOCAL}{XML_NAME};{XML_ADDRESS:x};{len(xml):x}".encode()
    registers.add_memory(Memory(Bootstrap.FIRST_URL, gev.TEXT_BYTES[Bootstrap.FIRST_URL], lambda: url))
    registers.add_memory(Memory(Bootstrap.SECOND_URL, gev.TEXT_BYTES[Bootstrap.SECOND_URL], lambda: b""))


def _add_control(registers: RegisterMap, privilege: Privilege) -> None:
    fixed = {
        Bootstrap.NETWORK_INTERFACES: 1,
        Bootstrap.PERSISTENT_ADDRESS: 0,
        Bootstrap.PERSISTENT_MASK: 0,
        Bootstrap.PERSISTENT_GATEWAY: 0,
        Bootstrap.MESSAGE_CHANNELS: 1,
        Bootstrap.STREAM_CHANNELS: 1,
        Bootstrap.MESSAGE_CHANNEL_CAPABILITY: CHANNEL_CAPABILITY,
        Bootstrap.STREAM_CHANNEL_CAPABILITY: CHANNEL_CAPABILITY,
        Bootstrap.GVCP_CAPABILITY: int(CAPABILITIES),
        Bootstrap.PENDING_TIMEOUT_MS: PENDING_TIMEOUT_MS,
    }
    for address, value in fixed.items():
        registers.add(address, _constant_word(value))
    registers.add(Bootstrap.HEARTBEAT_TIMEOUT_MS, _attribute_word(privilege, "heartbeat_ms"))
    registers.add(Bootstrap.CCP, RegisterWord(lambda: privilege.value))

    def owner() -> tuple[str, int]:
        return privilege.owner or ("0.0.0.0", 0)

    registers.add(Bootstrap.PRIMARY_APPLICATION_PORT, RegisterWord(lambda: owner()[1]))
    registers.add(Bootstrap.PRIMARY_APPLICATION_ADDRESS, RegisterWord(lambda: _address_number(owner()[0])))
    registers.add(Bootstrap.GVCP_CONFIGURATION, _stored_word(allowed=gev.GVCP_CONFIGURATION_EXTENDED_STATUS))


def _add_stream(registers: RegisterMap, channel: StreamChannel, acquiring: Callable[[], bool]) -> None:
    def set_port(value: int) -> None:
        if value & gev.SCP_PORT_MASK:
            channel.port = value & gev.SCP_PORT_MASK
        else:
            channel.shut()

    def size() -> int:
        return channel.packet_size | (gev.SCPS_DO_NOT_FRAGMENT if channel.do_not_fragment else 0)

    def set_size(value: int) -> None:
        requested_size = value & gev.SCPS_SIZE_MASK
        valid_size = (
            SMALLEST_PACKET_SIZE <= requested_size <= LARGEST_PACKET_SIZE
            and requested_size % PACKET_SIZE_STEP == 0
        )
        if not valid_size:
            raise RegisterRefusal(GevStatus.INVALID_PARAMETER)
        if acquiring() and requested_size != channel.packet_size:
            raise RegisterRefusal(GevStatus.BUSY)
        channel.packet_size = requested_size
        channel.do_not_fragment = bool(value & gev.SCPS_DO_NOT_FRAGMENT)
        if value & gev.SCPS_FIRE_TEST:
            channel.fire_test_packet(requested_size)

    registers.add(Bootstrap.SCP, RegisterWord(lambda: channel.port, set_port))
    registers.add(Bootstrap.SCPS, RegisterWord(size, set_size))
    registers.add(Bootstrap.SCPD, _attribute_word(channel, "delay_ticks"))
    registers.add(Bootstrap.SCDA, _destination_word(channel))
    registers.add(Bootstrap.SCSP, RegisterWord(lambda: channel.source_port))
    registers.add(Bootstrap.SCC, _constant_word(0))
    registers.add(
        Bootstrap.SCCFG, _stored_word(allowed=0)
    )  # clients request modes that this camera does not have


def _add_time(registers: RegisterMap, ticks: Ticks) -> None:
    def control(value: int) -> None:
        if value & gev.TIMESTAMP_RESET:
            ticks.reset()
        if value & gev.TIMESTAMP_LATCH:
            ticks.latch()

    registers.add(Bootstrap.TICK_FREQUENCY_HIGH, _constant_word(gev.TICK_FREQUENCY_HZ >> 32))
    registers.add(Bootstrap.TICK_FREQUENCY_LOW, _constant_word(gev.TICK_FREQUENCY_HZ & 0xFFFFFFFF))
    registers.add(Bootstrap.TIMESTAMP_CONTROL, RegisterWord(lambda: 0, control))
    registers.add(Bootstrap.TIMESTAMP_HIGH, RegisterWord(lambda: ticks.latched >> 32))
    registers.add(Bootstrap.TIMESTAMP_LOW, RegisterWord(lambda: ticks.latched & 0xFFFFFFFF))


def _constant_word(value: int) -> RegisterWord:
    return RegisterWord(lambda: value)


def _stored_word(allowed: int) -> RegisterWord:
    """Define a register that stores the permitted bits but has no other effect."""
    content = {"value": 0}
    return RegisterWord(lambda: content["value"], lambda value: content.update(value=value & allowed))


def _attribute_word(owner: object, name: str, most: int = 0xFFFFFFFF) -> RegisterWord:
    """Define a register backed by an attribute of a camera component."""

    def write(value: int) -> None:
        if value > most:
            raise RegisterRefusal(GevStatus.INVALID_PARAMETER)
        setattr(owner, name, value)

    return RegisterWord(lambda: int(getattr(owner, name)), write)


def _destination_word(channel: UdpChannel) -> RegisterWord:
    def write(value: int) -> None:
        channel.destination = socket.inet_ntoa(value.to_bytes(4, "big"))

    return RegisterWord(lambda: _address_number(channel.destination), write)


def _address_number(address: str) -> int:
    return int.from_bytes(socket.inet_aton(address), "big")


def add_message_channel(registers: RegisterMap, channel: MessageChannel) -> None:
    """Add the message channel registers: port, destination, time-out, retries and source port."""

    def set_port(value: int) -> None:
        channel.port = value & gev.MCP_PORT_MASK

    registers.add(Bootstrap.MCP, RegisterWord(lambda: channel.port, set_port))
    registers.add(Bootstrap.MCDA, _destination_word(channel))
    registers.add(Bootstrap.MCTT_MS, _attribute_word(channel, "timeout_ms", LONGEST_TIMEOUT_MS))
    registers.add(Bootstrap.MCRC, _attribute_word(channel, "retries", MOST_RETRIES))
    registers.add(Bootstrap.MCSP, RegisterWord(lambda: channel.source_port))
