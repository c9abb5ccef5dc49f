"""GenICam description of the camera, generated from its features, standard registers and events."""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from xml.etree import ElementTree

from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import Bootstrap
from sim.basler.camera.features import Feature, Kind
from sim.basler.control.feature_table import FEATURES, MAXIMUM_OFFSET, MINIMUM_OFFSET, STEP_OFFSET, address_of
from sim.basler.settings import EventKind


@dataclass(frozen=True)
class EventData:
    """A value carried by an event, at `offset` in its message item."""

    kind: EventKind
    what: str
    offset: int
    length: int
    about: str

    @property
    def name(self) -> str:
        """Node name, spelled as in the camera family."""
        return f"{self.kind.feature_name}Event{self.what}"

    @property
    def category(self) -> str:
        """Node category."""
        return f"{self.kind.feature_name}EventData"

    @property
    def port(self) -> str:
        """Name of the event's port node."""
        return f"{self.kind.feature_name}EventPort"


def _event_data() -> Iterator[EventData]:
    for kind in EventKind:
        yield EventData(kind, "StreamChannelIndex", 4, 2, "Stream channel of the event.")
        if kind is EventKind.EXPOSURE_END:
            yield EventData(kind, "FrameID", gev.EVENT_ITEM_BYTES, 4, "Block ID of the exposed frame.")
        yield EventData(kind, "Timestamp", 8, 8, "Time of the event, ticks.")


EVENT_DATA = tuple(_event_data())


def add_event_data(root: ElementTree.Element) -> None:
    """Add the nodes, registers and ports for all kinds of events.

    Each kind has a port of its own, which a client fills from messages; addresses are offsets in an item.
    """
    for data in EVENT_DATA:
        node = _add_node(root, "Integer", data.name)
        _add_child(node, "ToolTip", data.about)
        _add_child(node, "pValue", f"{data.name}Register")
        _add_integer_register(root, f"{data.name}Register", data.offset, "RO", data.length, port=data.port)
    for kind in EventKind:
        port = _add_node(root, "Port", f"{kind.feature_name}EventPort")
        _add_child(port, "EventID", f"{kind:x}")


def _add_node(root: ElementTree.Element, kind: str, name: str) -> ElementTree.Element:
    return ElementTree.SubElement(root, kind, {"Name": name, "NameSpace": "Standard"})


def _add_child(node: ElementTree.Element, tag: str, text: str) -> None:
    ElementTree.SubElement(node, tag).text = text


NAMESPACE = "http://www.genicam.org/GenApi/Version_1_1"
SCHEMA = f"{NAMESPACE} http://www.genicam.org/GenApi/GenApiSchema_Version_1_1.xsd"
PORT = "Device"
VERSION_PLACE = "00000000-0000-0000-0000-000000000000"
LOCK = "TLParamsLocked"


@dataclass(frozen=True)
class StandardFeature:
    """A feature with a standard register; `command` is the value written to execute it."""

    name: str
    category: str
    kind: str
    address: Bootstrap
    about: str
    access: str = "RO"
    size: int = gev.REGISTER_BYTES
    command: int | None = None


def _text_feature(name: str, address: Bootstrap, about: str, access: str = "RO") -> StandardFeature:
    size = gev.TEXT_BYTES[address]
    return StandardFeature(name, "DeviceInformation", "StringReg", address, about, access, size)


def _integer_feature(
    name: str, address: Bootstrap, about: str, access: str = "RW", size: int = gev.REGISTER_BYTES
) -> StandardFeature:
    return StandardFeature(name, "TransportLayer", "Integer", address, about, access, size)


def _time_command(name: str, about: str, value: int) -> StandardFeature:
    address = Bootstrap.TIMESTAMP_CONTROL
    return StandardFeature(name, "TransportLayer", "Command", address, about, "WO", command=value)


STANDARD_FEATURES = (
    _text_feature("DeviceVendorName", Bootstrap.MANUFACTURER_NAME, "Name of the manufacturer."),
    _text_feature("DeviceModelName", Bootstrap.MODEL_NAME, "Model."),
    _text_feature(
        "DeviceManufacturerInfo", Bootstrap.MANUFACTURER_INFO, "Information from the manufacturer."
    ),
    _text_feature("DeviceVersion", Bootstrap.DEVICE_VERSION, "Version of the camera."),
    _text_feature("DeviceFirmwareVersion", Bootstrap.DEVICE_VERSION, "Version of its firmware."),
    _text_feature("DeviceID", Bootstrap.SERIAL_NUMBER, "Serial number."),
    _text_feature("DeviceUserID", Bootstrap.USER_DEFINED_NAME, "User-defined name.", "RW"),
    _integer_feature("GevHeartbeatTimeout", Bootstrap.HEARTBEAT_TIMEOUT_MS, "Heartbeat timeout, ms."),
    _integer_feature("GevSCPD", Bootstrap.SCPD, "Pause between packets, ticks."),
    _integer_feature(
        "GevTimestampTickFrequency", Bootstrap.TICK_FREQUENCY_HIGH, "Ticks per second.", "RO", 8
    ),
    _time_command("GevTimestampControlLatch", "Latch the current time stamp.", gev.TIMESTAMP_LATCH),
    _time_command("GevTimestampControlReset", "Reset the time stamp to zero.", gev.TIMESTAMP_RESET),
    _integer_feature(
        "GevTimestampValue", Bootstrap.TIMESTAMP_HIGH, "The latched time stamp, ticks.", "RO", 8
    ),
    _integer_feature(
        "GevMCPHostPort", Bootstrap.MCP, "UDP port of the message channel's receiver; 0: closed."
    ),
    _integer_feature("GevMCDA", Bootstrap.MCDA, "Address of the message channel's receiver."),
    _integer_feature("GevMCTT", Bootstrap.MCTT_MS, "Timeout of a message acknowledge, ms."),
    _integer_feature("GevMCRC", Bootstrap.MCRC, "Number of retransmissions of a message."),
    _integer_feature("GevMCSP", Bootstrap.MCSP, "UDP source port of messages.", "RO"),
)


@cache
def camera_xml() -> bytes:
    """Generate the GenICam XML, versioned by content so that no client uses an outdated copy."""
    root = ElementTree.Element(
        "RegisterDescription",
        {
            "xmlns": NAMESPACE,
            "xmlns:xsi": "http://www.w3.org/2001/XMLSchema-instance",
            "xsi:schemaLocation": SCHEMA,
            "ModelName": gev.ACA2000_50GM_NIR,
            "VendorName": gev.BASLER,
            "ToolTip": "Monochrome near-infrared camera",
            "StandardNameSpace": "GEV",
            "SchemaMajorVersion": "1",
            "SchemaMinorVersion": "1",
            "SchemaSubMinorVersion": "0",
            "MajorVersion": "1",
            "MinorVersion": "0",
            "SubMinorVersion": "0",
            "ProductGuid": str(uuid.uuid5(uuid.NAMESPACE_URL, f"{NAMESPACE}/{gev.ACA2000_50GM_NIR}")),
            "VersionGuid": VERSION_PLACE,
        },
    )
    _add_categories(root)
    for standard in STANDARD_FEATURES:
        _add_standard(root, standard)
    for feature in FEATURES:
        _add_feature(root, feature)
    add_event_data(root)
    _add_node(root, "Port", PORT)
    ElementTree.indent(root, space=" ")
    text: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    version = uuid.UUID(bytes=hashlib.sha256(text).digest()[:16], version=4)
    return text.replace(VERSION_PLACE.encode(), str(version).encode())


def _add_categories(root: ElementTree.Element) -> None:
    members: dict[str, list[str]] = {}
    named = [(each.category, each.name) for each in STANDARD_FEATURES]
    named += [(feature.category, feature.name) for feature in FEATURES]
    named += [(data.category, data.name) for data in EVENT_DATA]
    for category, name in named:
        members.setdefault(category, []).append(name)
    top = _add_node(root, "Category", "Root")
    for category in members:
        _add_child(top, "pFeature", category)
    for category, names in members.items():
        node = _add_node(root, "Category", category)
        for name in names:
            _add_child(node, "pFeature", name)


def _add_standard(root: ElementTree.Element, it: StandardFeature) -> None:
    node = _add_node(root, it.kind, it.name)
    _add_child(node, "ToolTip", it.about)
    if it.kind == "StringReg":
        _locate(node, it.address, it.access, it.size)
        return
    _add_child(node, "pValue", f"{it.name}Register")
    if it.command is not None:
        _add_child(node, "CommandValue", str(it.command))
    _add_integer_register(root, f"{it.name}Register", it.address, it.access, it.size)


def _add_feature(root: ElementTree.Element, feature: Feature) -> None:
    node = _add_node(root, feature.kind.value, feature.name)
    _add_child(node, "ToolTip", feature.about)
    if feature.visibility != "Beginner":
        _add_child(node, "Visibility", feature.visibility)
    if feature.locked and feature.kind is not Kind.COMMAND:
        _add_child(node, "pIsLocked", LOCK)
    for name, value in feature.entries.items():
        entry = ElementTree.SubElement(node, "EnumEntry", {"Name": name, "NameSpace": "Standard"})
        _add_child(entry, "Value", str(int(value)))
    register = f"{feature.name}Register"
    _add_child(node, "pValue", register)
    address = address_of(feature.name)
    if feature.kind is Kind.COMMAND:
        _add_child(node, "CommandValue", "1")
    if feature.kind is Kind.BOOLEAN:
        _add_child(node, "OnValue", "1")
        _add_child(node, "OffValue", "0")
    _add_limits(root, node, feature, address)
    if feature.unit:
        _add_child(node, "Unit", feature.unit)
    if feature.kind is Kind.FLOAT:
        _add_child(node, "Representation", "Linear")
    for selected in feature.selects:
        _add_child(node, "pSelected", selected)
    access = "WO" if feature.read is None else ("RO" if feature.write is None else "RW")
    invalidators = [one.name for one in FEATURES if feature.name in one.selects]
    _add_number_register(root, register, feature, address, access, invalidators)


def _add_limits(root: ElementTree.Element, node: ElementTree.Element, feature: Feature, address: int) -> None:
    if feature.limits is None:
        return
    limits = [("Min", MINIMUM_OFFSET), ("Max", MAXIMUM_OFFSET)]
    if feature.kind is Kind.INTEGER:
        limits.append(("Inc", STEP_OFFSET))
    for word, offset in limits:
        name = f"{feature.name}Register{word}"  # WidthMax is the name of a feature
        _add_child(node, f"p{word}", name)
        _add_number_register(root, name, feature, address + offset, "RO", ())


def _add_number_register(
    root: ElementTree.Element, name: str, feature: Feature, address: int, access: str, more: Sequence[str]
) -> None:
    if feature.kind is Kind.FLOAT:
        node = _add_node(root, "FloatReg", name)
        _locate(node, address, access, gev.REGISTER_BYTES, more)
        _add_child(node, "Endianess", "BigEndian")
        return
    _add_integer_register(root, name, address, access, gev.REGISTER_BYTES, more)


def _add_integer_register(
    root: ElementTree.Element,
    name: str,
    address: int,
    access: str,
    size: int,
    invalidators: Sequence[str] = (),
    port: str = PORT,
) -> None:
    node = _add_node(root, "IntReg", name)
    _locate(node, address, access, size, invalidators, port)
    _add_child(node, "Sign", "Unsigned")
    _add_child(node, "Endianess", "BigEndian")


def _locate(
    node: ElementTree.Element,
    address: int,
    access: str,
    size: int,
    invalidators: Sequence[str] = (),
    port: str = PORT,
) -> None:
    _add_child(node, "Address", f"0x{address:X}")
    _add_child(node, "Length", str(size))
    _add_child(node, "AccessMode", access)
    _add_child(node, "pPort", port)
    # Limits, status and payload size change on their own: a client must always read them.
    _add_child(node, "Cachable", "NoCache")
    for invalidator in invalidators:
        _add_child(node, "pInvalidator", invalidator)
