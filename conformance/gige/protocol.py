"""GigE Vision protocol suite: numbered checklist, cases, and simulator.

All lines are about the camera, on the wire; a case's number is G and its line.
"""

from __future__ import annotations

from conformance.gige import control_cases, line_cases, stream_cases
from conformance.protocol import Checklist, ProtocolCases

_LINES: dict[int, str] = {
    1: "listens on UDP 3956 on its own address and on the broadcast address",
    2: "DISCOVERY is answered with 0x0003, status 0, 248 bytes equal to memory 0, and the request id",
    3: "DISCOVERY is answered whether or not another application has control",
    4: "datagrams without key 0x42 or shorter than 8 bytes are ignored",
    5: "unknown commands return 0x8001; commands without the acknowledge flag get no answer",
    6: "READREG serves lists of addresses in order",
    7: "READMEM serves 536 bytes; misaligned addresses return 0x8005",
    8: "nonexistent addresses return 0x8003",
    9: "writes to read-only registers return 0x8004",
    10: "writes without control return 0x8006",
    11: "WRITEREG of several pairs stops at the first failure and returns its index",
    12: "control, exclusive, release; a second application is refused with 0x8006",
    13: "under control access others may read; under exclusive access they get 0x8006",
    14: "every command of the owner restarts the heartbeat timer; other clients' commands do not",
    15: "the heartbeat time-out releases control, closes the stream and stops the acquisition",
    16: "heartbeat time-outs below 500 ms are raised to 500",
    17: "the XML is complete, parses, and its registers exist",
    18: "the XML has the essential names",
    19: "PayloadSize equals width x height x bits / 8 after every change",
    20: "values out of range are refused or clamped, never stored",
    21: "no area reaches beyond the sensor",
    22: "Width, Height and PixelFormat are locked while the acquisition runs",
    23: "a test packet has the requested size, comes once and clears its bit",
    24: "destination 0.0.0.0 means the application in control",
    25: "streaming only with an open channel, control held and AcquisitionStart done",
    26: "leader, payload, trailer have ids 0, 1..n, n+1; only the last payload is short",
    27: "block ids start at 1, step 1, wrap from 65535 to 1",
    28: "the leader's geometry, format and offsets are those of the features",
    29: "time stamps are ticks, strictly increasing, taken when the exposure starts",
    30: "the time-stamp counter can be latched and reset, and agrees with the leaders",
    31: "PACKETRESEND resends the exact bytes of the last 16 frames",
    32: "a request for a discarded packet is answered by a header with 0x800C or 0x8012",
    33: "one frame per software trigger, none without; triggers while busy are dropped and counted",
    34: "a retried command with the same request id is not executed twice",
    35: "ACTION with matching keys and mask fires one frame; others ignore it",
    36: "two cameras differ in MAC, serial and address, and run at 50 frames/s together without loss",
    37: "an exposure longer than the frame period lowers the rate, and ResultingFrameRateAbs reports it",
    38: "AcquisitionStop ends the stream after at most the frame in progress",
    39: "user set Default restores the power-on values",
    40: "killing any client at any moment never needs a restart",
    41: "an output line follows UserOutputValue and LineInverter, and LineStatus shows its level",
    42: "an output line of source ExposureActive is high during the exposure only",
}
# Requirements of a line beyond its cases, and where they are tested.
_REMARKS: dict[int, str] = {
    14: "other clients' commands: covered by G15, where another client keeps polling",
    27: "the wrap-around needs 65,535 images: tests/unit/sim_basler/test_camera_stream.py",
    29: "the time of exposure needs a stopped clock: tests/unit/sim_basler/test_camera_stream.py",
    36: "the rate needs minutes: tests/soak/test_camera_stream.py, benchmarks/stereo_head/stereo_rate.py",
    40: "a silent client is covered; for a killed one see tests/system/cameras/test_basler_driver_sim.py",
}

GIGE_CHECKLIST = Checklist(letters="G", lines=_LINES, remarks=_REMARKS, also={40: ("G15",)})


PROTOCOL = ProtocolCases(
    cases=(*control_cases.CASES.cases, *stream_cases.CASES.cases, *line_cases.CASES.cases),
    checklist=GIGE_CHECKLIST,
    simulator=lambda: ("basler",),
)
