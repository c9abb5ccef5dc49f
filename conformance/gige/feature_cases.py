"""Cases for a camera's features: names, limits, locks, rates, user sets."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from conformance.case import CaseList, check
from conformance.device_under_test import DeviceUnderTest
from conformance.gige.link import cameras
from conformance.gige.stream import GigeStream, controlled_stream, leader_of, started
from ronna_hw.wire.gige_vision import Bootstrap, GevStatus, GvcpCommand

# no client works without these
ESSENTIAL = (
    "PayloadSize", "TLParamsLocked", "AcquisitionStart", "AcquisitionStop", "AcquisitionMode", "Width",
    "Height", "PixelFormat", "TriggerSelector", "TriggerMode",
)  # fmt: skip
AREAS = ((64, 32), (256, 64), (512, 17))
BITS = {"Mono8": 8, "Mono12": 16, "Mono12Packed": 12}
LONG_EXPOSURE_US = 100_000.0
RATE_SLACK = 0.02
REFUSALS = (GevStatus.ACCESS_DENIED, GevStatus.BUSY)

CASES = CaseList()
case = CASES.case


def streams(dut: DeviceUnderTest) -> Iterator[GigeStream]:
    """Each camera in turn, under control, with small frames and an open channel."""
    for camera in cameras(dut):
        with controlled_stream(camera) as stream:
            yield stream


@case("G17a", "every register of the description exists")
def described_registers_exist(dut: DeviceUnderTest) -> None:
    for stream in streams(dut):
        for address in stream.features.addresses():
            answer = stream.link.exchange(GvcpCommand.READREG, struct.pack(">I", address))
            check(answer.status != GevStatus.INVALID_ADDRESS, f"a register at 0x{address:X}", "none")


@case("G18", "the description has the essential features")
def essential_names(dut: DeviceUnderTest) -> None:
    for stream in streams(dut):
        missing = [name for name in ESSENTIAL if not stream.features.has(name)]
        check(not missing, "all essential features", f"without {', '.join(missing)}")


@case("G19", "the payload size is width times height times bits after every change")
def payload_follows(dut: DeviceUnderTest) -> None:
    for stream in streams(dut):
        for name, bits in BITS.items():
            stream.features.set("PixelFormat", name)
            for width, height in AREAS:
                stream.features.set("Width", width)
                stream.features.set("Height", height)
                found = stream.features.whole("PayloadSize")
                check(found == width * height * bits // 8, f"{width}x{height} at {bits} bits", found)


@case("G20", "values out of range are refused or clamped, never stored")
def limits_hold(dut: DeviceUnderTest) -> None:
    for stream in streams(dut):
        features = stream.features
        for name in ("Width", "Height", "OffsetX", "OffsetY", "GainRaw", "ExposureTimeAbs"):
            low, high = features.limit(name, "Min"), features.limit(name, "Max")
            for value in (low - 1, high + 1):
                if value >= 0:
                    features.write(name, value)
                    found = features.get(name)
                    check(low <= found <= high, f"{name} between {low} and {high}", found)


@case("G21", "no area reaches beyond the sensor")
def areas_stay_on_the_sensor(dut: DeviceUnderTest) -> None:
    for stream in streams(dut):
        features = stream.features
        for offset, size, sensor in (
            ("OffsetX", "Width", "SensorWidth"),
            ("OffsetY", "Height", "SensorHeight"),
        ):
            whole = features.whole(sensor)
            features.write(offset, features.limit(offset, "Max"))
            features.write(size, whole)
            end = features.whole(offset) + features.whole(size)
            check(end <= whole, f"{offset} + {size} up to {whole}", end)
            features.set(offset, 0)


@case("G22", "geometry and pixel format are locked while the acquisition runs")
def format_is_locked(dut: DeviceUnderTest) -> None:
    for stream in streams(dut):
        started(stream)
        pixel_format = stream.features.entry("PixelFormat", "Mono12")
        for name, value in (("Width", 512), ("Height", 32), ("PixelFormat", pixel_format)):
            status = stream.features.write(name, value)
            check(status in REFUSALS, f"{name} refused", f"status 0x{status:04X}")


@case("G37", "an exposure longer than the frame period lowers the rate, and the camera reports it")
def long_exposures_lower_the_rate(dut: DeviceUnderTest) -> None:
    for stream in streams(dut):
        stream.features.set("TriggerMode", "Off")
        stream.features.set("ExposureTimeAbs", LONG_EXPOSURE_US)
        found = float(stream.features.get("ResultingFrameRateAbs"))
        most = 1e6 / LONG_EXPOSURE_US
        check(0 < found <= most * (1 + RATE_SLACK), f"at most {most:g} frames/s", found)
        started(stream)
        before, after = (leader_of(stream.frame()).ticks for _ in range(2))
        high, low = stream.link.registers(Bootstrap.TICK_FREQUENCY_HIGH, Bootstrap.TICK_FREQUENCY_LOW)
        rate = (high << 32 | low) / (after - before)
        check(rate <= most * (1 + RATE_SLACK), f"images at no more than {most:g} frames/s", f"{rate:.1f}")


@case("G39", "the default user set restores the power-on values")
def default_user_set(dut: DeviceUnderTest) -> None:
    for stream in streams(dut):
        features = stream.features
        features.execute("UserSetLoad")
        names = ("Width", "Height", "OffsetX", "PixelFormat", "GainRaw", "TriggerMode", "ExposureTimeRaw")
        before = {name: features.get(name) for name in names if features.has(name)}
        stream.small_frames(PixelFormat="Mono12", GainRaw=features.limit("GainRaw", "Max"))
        features.execute("UserSetLoad")
        after = {name: features.get(name) for name in before}
        check(after == before, f"the values {before}", after)
