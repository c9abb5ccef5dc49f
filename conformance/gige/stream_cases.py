"""Cases for a GigE Vision camera's features, triggers and stream, packet by packet."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from conformance.case import HOST_TIME, CaseList, NotShown, check, require_present
from conformance.device_under_test import DeviceUnderTest
from conformance.gige.client import GigeLink, cameras
from conformance.gige.stream import (
    HEIGHT_PX,
    LEADER,
    PACKET_BYTES,
    PAYLOAD,
    TRAILER,
    WIDTH_PX,
    GigeStream,
    Packet,
    controlled_stream,
    decode_leader,
    require_leader,
    start_acquisition,
)
from ronna_hw.wire.gige_vision import (
    CCP_OPEN,
    GVSP_OVERHEAD_BYTES,
    IP_UDP_HEADER_BYTES,
    SCPS_FIRE_TEST,
    TIMESTAMP_RESET,
    Bootstrap,
    GevStatus,
    GvcpCommand,
    PayloadType,
)

# no client works without these
ESSENTIAL = (
    "PayloadSize", "TLParamsLocked", "AcquisitionStart", "AcquisitionStop", "AcquisitionMode", "Width",
    "Height", "PixelFormat", "TriggerSelector", "TriggerMode",
)  # fmt: skip
AREAS = ((64, 32), (256, 64), (512, 17))
BITS = {"Mono8": 8, "Mono12": 16, "Mono12Packed": 12}
RATE_LIMITING_EXPOSURE_US = 100_000.0
RATE_SLACK = 0.02
REFUSALS = (GevStatus.ACCESS_DENIED, GevStatus.BUSY)

CASES = CaseList()
on_camera = CASES.with_each(cameras)


def streams(dut: DeviceUnderTest) -> Iterator[GigeStream]:
    """Yield the stream of each camera, with small frames and an open channel."""
    for camera in cameras(dut):
        with controlled_stream(camera) as stream:
            yield stream


on_stream = CASES.with_each(streams)


@on_stream("G17a", "every register of the description exists")
def described_registers_exist(stream: GigeStream) -> None:
    for address in stream.features.addresses():
        answer = stream.link.exchange(GvcpCommand.READREG, struct.pack(">I", address))
        check(answer.status != GevStatus.INVALID_ADDRESS, f"a register at 0x{address:X}", "none")


@on_stream("G18", "the description has the essential features")
def essential_names(stream: GigeStream) -> None:
    missing = [name for name in ESSENTIAL if not stream.features.has(name)]
    check(not missing, "all essential features", f"without {', '.join(missing)}")


@on_stream("G19", "the payload size is width times height times bits after every change")
def payload_follows(stream: GigeStream) -> None:
    for name, bits in BITS.items():
        stream.features.set("PixelFormat", name)
        for width, height in AREAS:
            stream.features.set("Width", width)
            stream.features.set("Height", height)
            found = stream.features.whole("PayloadSize")
            check(found == width * height * bits // 8, f"{width}x{height} at {bits} bits", found)


@on_stream("G20", "values out of range are refused or clamped, never stored")
def limits_hold(stream: GigeStream) -> None:
    features = stream.features
    for name in ("Width", "Height", "OffsetX", "OffsetY", "GainRaw", "ExposureTimeAbs"):
        low, high = features.limit(name, "Min"), features.limit(name, "Max")
        for value in (low - 1, high + 1):
            if value >= 0:
                features.write(name, value)
                found = features.get(name)
                check(low <= found <= high, f"{name} between {low} and {high}", found)


@on_stream("G21", "no area reaches beyond the sensor")
def areas_stay_on_the_sensor(stream: GigeStream) -> None:
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


@on_stream("G22", "geometry and pixel format are locked while the acquisition runs")
def format_is_locked(stream: GigeStream) -> None:
    start_acquisition(stream)
    pixel_format = stream.features.entry("PixelFormat", "Mono12")
    for name, value in (("Width", 512), ("Height", 32), ("PixelFormat", pixel_format)):
        status = stream.features.write(name, value)
        check(status in REFUSALS, f"{name} refused", f"status 0x{status:04X}")


@on_stream("G37", "an exposure longer than the frame period lowers the rate, and the camera reports it")
def long_exposures_lower_the_rate(stream: GigeStream) -> None:
    stream.features.set("TriggerMode", "Off")
    stream.features.set("ExposureTimeAbs", RATE_LIMITING_EXPOSURE_US)
    found = float(stream.features.get("ResultingFrameRateAbs"))
    most = 1e6 / RATE_LIMITING_EXPOSURE_US
    check(0 < found <= most * (1 + RATE_SLACK), f"at most {most:g} frames/s", found)
    start_acquisition(stream)
    before, after = (require_leader(stream.frame()).ticks for _ in range(2))
    high, low = stream.link.read_registers(Bootstrap.TICK_FREQUENCY_HIGH, Bootstrap.TICK_FREQUENCY_LOW)
    rate = (high << 32 | low) / (after - before)
    check(rate <= most * (1 + RATE_SLACK), f"images at no more than {most:g} frames/s", f"{rate:.1f}")


@on_stream("G39", "the default user set restores the power-on values")
def default_user_set(stream: GigeStream) -> None:
    features = stream.features
    features.execute("UserSetLoad")
    names = ("Width", "Height", "OffsetX", "PixelFormat", "GainRaw", "TriggerMode", "ExposureTimeRaw")
    before = {name: features.get(name) for name in names if features.has(name)}
    stream.configure_small_frames(PixelFormat="Mono12", GainRaw=features.limit("GainRaw", "Max"))
    features.execute("UserSetLoad")
    after = {name: features.get(name) for name in before}
    check(after == before, f"the values {before}", after)


TEST_PACKET_BYTES = (576, 1500)
KEPT_FRAMES = 16
FRAMES = 4
TEST_LIMIT_S = 1.0
GONE = (GevStatus.PACKET_UNAVAILABLE, GevStatus.PACKET_REMOVED)
TRIGGERS = 5
LONG_EXPOSURE_US = 250_000.0  # longer than the trigger commands take
LATE_S = 1.5  # time limit for an image with such an exposure
DEVICE_KEY, GROUP_KEY, GROUP_MASK = 0x1234_5678, 3, 2


def take_frames(stream: GigeStream, count: int) -> list[list[Packet]]:
    """Trigger `count` times and return the frame received after each trigger."""
    taken = []
    for _ in range(count):
        stream.trigger()
        taken.append(stream.frame())
    return taken


@on_stream("G23", "a test packet has the requested size, comes once and clears its bit")
def test_packets(stream: GigeStream) -> None:
    for size in TEST_PACKET_BYTES:
        stream.link.write(Bootstrap.SCPS, size | SCPS_FIRE_TEST)
        data = stream.datagram(TEST_LIMIT_S)
        wanted = size - IP_UDP_HEADER_BYTES
        check(data is not None and len(data) == wanted, f"{wanted} bytes", data and len(data))
        check(stream.silent(), "no second packet")
        (found,) = stream.link.read_registers(Bootstrap.SCPS)
        check(not found & SCPS_FIRE_TEST, "the bit cleared", hex(found))


@on_stream("G24", "destination 0.0.0.0 is the application in control")
def nameless_destination(stream: GigeStream) -> None:
    stream.open_channel("0.0.0.0")
    take_frames(start_acquisition(stream), 1)


@on_stream("G25", "images need an open channel, control and a running acquisition")
def three_conditions(stream: GigeStream) -> None:
    stream.trigger()
    check(stream.silent(), "nothing before AcquisitionStart")
    start_acquisition(stream)
    stream.link.write(Bootstrap.SCP, 0)
    stream.trigger()
    check(stream.silent(), "nothing on a closed channel")
    stream.features.execute("AcquisitionStop")
    stream.open_channel()
    take_frames(start_acquisition(stream), 1)


@on_camera("G25a", "releasing control ends the stream")
def release_ends_the_stream(camera: GigeLink) -> None:
    with controlled_stream(camera) as stream:
        stream.features.set("TriggerMode", "Off")
        start_acquisition(stream).frame()
        camera.write(Bootstrap.CCP, CCP_OPEN)
        stream.drain_packets()
        check(camera.read_registers(Bootstrap.SCP) == [0], "the channel closed")
        camera.write(Bootstrap.CCP, 2)  # expected by the end of the block


@on_stream("G26", "leader, payload and trailer have ids 0, 1 to n, n+1; only the last payload is short")
def packets_are_numbered(stream: GigeStream) -> None:
    full = PACKET_BYTES - GVSP_OVERHEAD_BYTES
    (frame,) = take_frames(start_acquisition(stream), 1)
    check([p.packet_id for p in frame] == list(range(len(frame))), "ids in order from 0")
    kinds = [LEADER, *[PAYLOAD] * (len(frame) - 2), TRAILER]
    check([p.kind for p in frame] == kinds, "leader, payload, trailer")
    sizes = [len(p.content) for p in frame[1:-1]]
    check(all(size == full for size in sizes[:-1]), f"{full} bytes in each", sizes[:-1])
    check(sum(sizes) == WIDTH_PX * HEIGHT_PX, "the whole image", sum(sizes))


@on_stream("G28", "the leader has the geometry, format and offset that were set")
def leader_agrees(stream: GigeStream) -> None:
    stream.features.set("OffsetX", 64)
    stream.features.set("OffsetY", 32)
    (frame,) = take_frames(start_acquisition(stream), 1)
    leader = require_leader(frame)
    check(leader.payload_type == PayloadType.IMAGE, "an image", leader.payload_type)
    found = (leader.x, leader.y, leader.width, leader.height)
    check(found == (64, 32, WIDTH_PX, HEIGHT_PX), "the area that was set", found)
    pixel_format = stream.features.whole("PixelFormat")
    check(leader.pixel_format == pixel_format, hex(pixel_format), hex(leader.pixel_format))


@on_stream("G29", "time stamps count at the given frequency and always increase")
def stamps_grow(stream: GigeStream) -> None:
    high, low = stream.link.read_registers(Bootstrap.TICK_FREQUENCY_HIGH, Bootstrap.TICK_FREQUENCY_LOW)
    check(high << 32 | low > 0, "a nonzero frequency")
    ticks = [require_leader(frame).ticks for frame in take_frames(start_acquisition(stream), FRAMES)]
    check(ticks == sorted(set(ticks)), "increasing stamps", ticks)


@on_stream(
    "G30", "the counter can be latched and reset, and agrees with the images' stamps", needs=(HOST_TIME,)
)
def latch_and_reset(stream: GigeStream) -> None:
    start_acquisition(stream)
    before = stream.latch_ticks()
    (frame,) = take_frames(stream, 1)
    after = stream.latch_ticks()
    ticks = require_leader(frame).ticks
    check(before <= ticks <= after, f"a stamp between {before} and {after}", ticks)
    stream.link.write(Bootstrap.TIMESTAMP_CONTROL, TIMESTAMP_RESET)
    check(stream.latch_ticks() < after, "a smaller count after the reset")


@on_stream("G31", "packets of the last 16 images are resent byte by byte")
def packets_are_repeated(stream: GigeStream) -> None:
    taken = take_frames(start_acquisition(stream), KEPT_FRAMES)
    for frame in (taken[0], taken[-1]):
        for first in (frame[0], frame[2], frame[-1]):
            stream.request_resend(first.block_id, first.packet_id, first.packet_id)
            again = require_present(stream.packet(TEST_LIMIT_S), f"packet {first.packet_id} again")
            check(again.raw == first.raw, f"packet {first.packet_id} again")
            check(again.status in (0, GevStatus.PACKET_RESEND), "a resent packet")


@on_stream("G32", "a request for a discarded packet is answered by a header that says so")
def discarded_packets(stream: GigeStream) -> None:
    take_frames(start_acquisition(stream), 1)
    stream.request_resend(0x7000, 1, 1)
    answer = require_present(stream.packet(TEST_LIMIT_S), "a header with 0x800C or 0x8012", "nothing")
    check(answer.status in GONE and not answer.content, "0x800C or 0x8012", hex(answer.status))


@on_stream("G33", "one software trigger yields one image; a trigger while busy is dropped and counted")
def software_trigger(stream: GigeStream) -> None:
    check(start_acquisition(stream).silent(), "nothing without a trigger")
    take_frames(stream, 1)
    check(stream.silent(), "one image for one trigger")
    stream.features.set("ExposureTimeAbs", LONG_EXPOSURE_US)
    for _ in range(TRIGGERS):
        stream.trigger()
    taken = sum(packet.kind == TRAILER for packet in stream.drain_packets(LATE_S))
    check(0 < taken < TRIGGERS, "triggers while busy dropped", f"{taken} images for {TRIGGERS}")
    if stream.features.has("OvertriggerCount"):
        missed = stream.features.whole("OvertriggerCount")
        check(missed == TRIGGERS - taken, f"{TRIGGERS - taken} counted triggers while busy", missed)


@on_stream("G34", "a command repeated with its request id is executed once")
def repeated_commands_act_once(stream: GigeStream) -> None:
    start_acquisition(stream)
    trigger = struct.pack(">II", *stream.features.command("TriggerSoftware"))
    stream.link.exchange(GvcpCommand.WRITEREG, trigger)
    stream.frame()  # only then would the camera take another one
    check(stream.link.repeat_last(), "an answer to the repeated command", "none")
    check(stream.silent(), "one image for a repeated trigger")


@on_stream("G35", "an action with matching keys and mask triggers one image; others trigger none")
def actions(stream: GigeStream) -> None:
    if not stream.features.has("ActionDeviceKey"):
        raise NotShown("the camera does not support actions")
    stream.features.set("TriggerSource", "Action1")
    stream.features.set("ActionDeviceKey", DEVICE_KEY)
    stream.features.set("ActionGroupKey", GROUP_KEY)
    stream.features.set("ActionGroupMask", GROUP_MASK)
    start_acquisition(stream)
    for keys in ((1, GROUP_KEY, GROUP_MASK), (DEVICE_KEY, 4, GROUP_MASK), (DEVICE_KEY, GROUP_KEY, 1)):
        stream.link.send(GvcpCommand.ACTION, struct.pack(">III", *keys))
    check(stream.silent(), "nothing for other keys, groups or masks")
    stream.link.send(GvcpCommand.ACTION, struct.pack(">III", DEVICE_KEY, GROUP_KEY, GROUP_MASK))
    stream.frame()
    check(stream.silent(), "one image for one action")


@on_stream("G38", "AcquisitionStop ends the stream after at most the image in progress")
def stop_ends_the_stream(stream: GigeStream) -> None:
    stream.features.set("TriggerMode", "Off")
    start_acquisition(stream).frame()
    stream.features.execute("AcquisitionStop")
    stopped = stream.latch_ticks()
    # an image exposed before the stop may still arrive
    starts = [decode_leader(packet).ticks for packet in stream.drain_packets() if packet.kind == LEADER]
    late = [ticks for ticks in starts if ticks > stopped]
    check(not late, f"no image that starts after the stop at {stopped}", late)
