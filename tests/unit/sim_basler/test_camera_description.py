"""The camera's XML description, read as a client reads it, against the registers it describes."""

from __future__ import annotations

import struct
from typing import Any
from xml.etree import ElementTree

import pytest

from ronna_hw.wire.gige_vision import Bootstrap

READMEM = 0x84
FAMILY = """
DeviceVendorName DeviceModelName DeviceManufacturerInfo DeviceVersion DeviceFirmwareVersion DeviceID
DeviceUserID SensorWidth SensorHeight WidthMax HeightMax Width Height OffsetX OffsetY PixelFormat PixelSize
TestImageSelector AcquisitionMode AcquisitionStart AcquisitionStop AcquisitionAbort
AcquisitionFrameRateEnable AcquisitionFrameRateAbs ResultingFrameRateAbs AcquisitionStatusSelector
AcquisitionStatus AcquisitionFrameCount ExposureMode ExposureAuto ExposureTimeAbs ExposureTimeRaw
ExposureTimeBaseAbs ReadoutTimeAbs GainAuto GainSelector GainRaw BlackLevelSelector BlackLevelRaw
TriggerSelector TriggerMode TriggerSource TriggerActivation TriggerDelayAbs TriggerSoftware PayloadSize
GevVersionMajor GevVersionMinor GevSCPSPacketSize GevSCPD GevHeartbeatTimeout GevTimestampTickFrequency
GevTimestampControlLatch GevTimestampControlReset GevTimestampValue ActionDeviceKey ActionSelector
ActionGroupKey ActionGroupMask UserSetSelector UserSetLoad UserSetSave TLParamsLocked
LineSelector LineMode LineSource LineInverter LineStatus UserOutputSelector UserOutputValue
EventSelector EventNotification ExposureEndEventFrameID ExposureEndEventTimestamp
ExposureEndEventStreamChannelIndex FrameStartOvertriggerEventTimestamp EventOverrunEventTimestamp
"""
NAMES = frozenset(FAMILY.split())
REGISTERS = ("IntReg", "FloatReg", "StringReg")


def read(bench: Any, address: int, count: int) -> bytes:
    status, _, content = bench.ask(READMEM, struct.pack(">IHH", address, 0, count))
    assert status == 0, f"0x{address:X}"
    return bytes(content[4:])


def on_the_camera(node: ElementTree.Element) -> bool:
    """True for a register of the camera; others are places in a message with events."""
    return node.tag in REGISTERS and node.findtext("pPort") == "Device"


@pytest.fixture
def description(bench: Any) -> ElementTree.Element:
    """The XML from the place that the first URL names, exactly as long as it says, without namespaces."""
    url = read(bench, Bootstrap.FIRST_URL, 512).rstrip(b"\0").decode()
    scheme, _, rest = url.partition(":")
    assert scheme == "Local"
    name, address, length = rest.split(";")
    assert name.endswith(".xml")
    start, size = int(address, 16), int(length, 16)
    content = b"".join(read(bench, start + at, 512) for at in range(0, size - 512, 512))
    content += read(bench, start + len(content), -(-(size - len(content)) // 4) * 4)
    assert content[size:].strip(b"\0") == b""
    root = ElementTree.fromstring(content[:size])
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    return root


def test_every_reference_in_the_description_resolves(description: ElementTree.Element) -> None:
    names = {node.get("Name") for node in description}
    assert len(names) == len(list(description)), "a name occurs twice"
    for element in description.iter():
        if element.tag.startswith("p") and element.tag[1].isupper():
            assert element.text in names, f"{element.tag} names {element.text}"


def test_only_registers_described_as_read_only_refuse_writes(
    bench: Any, description: ElementTree.Element
) -> None:
    bench.take_control()
    for node in description:
        if not on_the_camera(node) or node.tag == "StringReg":
            continue
        address = int(node.findtext("Address", ""), 16)
        access = node.findtext("AccessMode")
        if node.get("Name", "").startswith(("Acquisition", "UserSet")) and access == "WO":
            continue
        status = bench.write(address, bench.read(address))
        assert (status == 0x8004) == (access == "RO"), node.get("Name")


def test_the_names_of_the_camera_family_are_present_and_reachable_from_the_root(
    description: ElementTree.Element,
) -> None:
    nodes = {node.get("Name"): node for node in description}
    assert set(nodes) >= NAMES
    reachable = set()
    for category in nodes["Root"].findall("pFeature"):
        reachable |= {feature.text for feature in nodes[category.text].findall("pFeature")}
    assert reachable >= NAMES
    selected = {entry.text for entry in nodes["TriggerSelector"].findall("pSelected")}
    assert {"TriggerMode", "TriggerSource", "TriggerSoftware"} <= selected
    for name in ("Width", "Height", "PixelFormat", "GevSCPSPacketSize"):
        assert nodes[name].findtext("pIsLocked") == "TLParamsLocked"


def test_the_limits_in_the_description_match_the_camera(bench: Any, description: ElementTree.Element) -> None:
    bench.take_control()
    nodes = {node.get("Name"): node for node in description}

    def value(name: str | None) -> int:
        return int(bench.read(int(nodes[name].findtext("Address", ""), 16)))

    for name in ("Width", "OffsetX", "OffsetY", "GainRaw", "ExposureTimeRaw", "BlackLevelRaw"):
        low = value(nodes[name].findtext("pMin"))
        high = value(nodes[name].findtext("pMax"))
        step = value(nodes[name].findtext("pInc"))
        assert bench.set(name, high) == bench.set(name, low) == 0
        assert bench.set(name, high + step) == 0x8002
        if low:
            assert bench.set(name, low - 1) == 0x8002


def test_the_description_has_its_own_version_guid(description: ElementTree.Element) -> None:
    assert description.get("VendorName") == "Basler"
    assert description.get("ModelName") == "acA2000-50gmNIR"
    version = description.get("VersionGuid", "")
    assert len(version) == 36
    assert version != "00000000-0000-0000-0000-000000000000"
