"""NDI Polaris protocol suite: numbered checklist, cases in checklist order, and simulator.

S lines are about the unit, on the wire; D lines about the driver. A case's number is P or D and its line.
"""

from __future__ import annotations

from conformance.case import CHECKED_REPLIES
from conformance.device_under_test import DeviceUnderTest
from conformance.polaris import driver_cases, frame_cases, unit_cases, volume_cases
from conformance.polaris.fixtures import POLARIS_BYTES, SERIAL_LINE, TOOL_DEFINITION, ReportsDefinitions
from conformance.protocol import Checklist, ProtocolCases

_LINES: dict[int, str] = {
    1: "S: power-up and break cause RESET with its CRC at 9600 baud, 8N1",
    2: "S: every text reply ends in four upper-case hex digits of CRC and CR",
    3: "S: a command with a wrong CRC returns ERROR04 and has no effect",
    4: "S: a command with a space needs no CRC; its reply has one",
    5: "S: INIT without a separator is accepted",
    6: "S: an unknown name returns ERROR01",
    7: "S: commands that arrive byte by byte work",
    8: "S: OKAY to COMM goes out at the old rate",
    9: "S: before INIT, set-up commands return ERROR10",
    10: "S: INIT is answered within 150 ms",
    11: "D: waits for the unit's own limit plus the transfer before a time-out",
    12: "D: discards stale input before each command",
    13: "D: checks the CRC of every reply, both of BX",
    14: "D: recovers from a lost byte by one retry of harmless commands, never of PHRQ",
    15: "D: turns each ERRORhh into a typed error with its code",
    16: "D: treats WARNING as success and reports it",
    17: "S: PHRQ returns distinct nonzero handles, PHF frees them",
    18: "S: PHSR 00 to 04 list the right handles at each step",
    19: "S: PVWR takes 64-byte blocks up to 07C0, in upper- or lower-case hex",
    20: "S: PINIT refuses a wrong checksum",
    21: "S: PENA before PINIT returns ERROR0E, a wrong priority ERROR09",
    22: "S: PHINF 0001 has 33 characters and agrees with the definition, 0004 has 20",
    23: "S: PHINF 0025 has 67 characters",
    24: "S: TSTART, PHSR and PENA while tracking return ERROR0C",
    25: "S: TX, BX and TSTOP outside tracking return ERROR0C, as text",
    26: "S: TSTART 80 restarts the frame number",
    27: "S: the frame number advances at 60 per second, never backwards",
    28: "S: TX has its exact form",
    29: "S: quaternion of norm 1 within 1e-3, z negative, error 0 or more",
    30: "S: TX and BX of one frame agree to 0.005 mm and 5e-5",
    31: "S: MISSING keeps status and frame number, DISABLED carries neither",
    32: "S: BX has the right length and CRCs, and no byte after it",
    33: "S: BX contains little-endian float32",
    34: "S: option 0002 adds 22 hex digits to TX and 11 bytes to BX",
    35: "S: without 0800 a tool out of the volume is MISSING with status bit 0040",
    36: "S: strays only while a passive handle is enabled, at most 50, with correct in and out flags",
    37: "D: uses 1801 and filters strays by its own test of the volume and by the tools' markers",
    38: "D: normalises the quaternions of TX",
    39: "D: orders by frame number, and detects repeats and gaps",
    40: "D: sets the illuminators to 60 Hz and the fastest common rate, and confirms that by a command",
    41: "D: on closing TSTOP, PHF, COMM 00000",
    42: "D: reads New Alerts on system status 0100, and a bump is a safety event",
    43: "D: uses no pose on system status 0200 or 0010",
    44: "S: GET of an unknown name returns ERROR34, SET of a read-only one ERROR39",
    45: "S: SFLIST 03 returns the two volumes of a Spectra",
    46: "S: the status of markers follows the formulas of those volumes",
    47: "S: a generated definition and one of the vendor both load",
    48: "S: ndicapi and scikit-surgerynditracker work unmodified, over pty and TCP",
    49: "S: DSTART and DSTOP work in their modes",
    50: "S: every fault can be switched on at run time without touching the link",
}
# Generic cases that also check a line.
_ALSO: dict[int, tuple[str, ...]] = {
    11: ("T18",),
    12: ("T20",),
    13: ("T22",),
    14: ("T22",),
    27: ("T06",),
    29: ("P33", "T10", "T11"),
    38: ("T10",),
    39: ("T06", "T20"),
    41: ("T14", "T19"),
}
_ELSEWHERE: dict[int, str] = {
    48: "one client cannot represent others: tests/system/tracker/test_polaris_sim_strangers.py drives "
    "the simulator with both packages, each in its own process",
    50: "simulator only: tests/unit/sim_polaris, tests/system/case/test_live_faults.py",
}
# Requirements of a line beyond its cases, and where they are tested.
_REMARKS: dict[int, str] = {
    1: "power-up cannot be triggered over the line; needs --allow destructive",
    9: "needs --allow destructive: the unit is reset first",
    36: "strays on both sides of the volume: tests/unit/sim_polaris/test_sight_faults.py",
    40: "the command after COMM is the driver's choice: tests/unit/ndi_polaris",
    47: "the vendor's files may not be copied; the suite makes a definition from published numbers",
}

POLARIS_CHECKLIST = Checklist(letters="PD", lines=_LINES, remarks=_REMARKS, elsewhere=_ELSEWHERE, also=_ALSO)


CASE_MODULES = (unit_cases, frame_cases, volume_cases, driver_cases)


def offers(dut: DeviceUnderTest) -> frozenset[str]:
    """Return the requirements of Polaris cases that the device under test meets."""
    met = {CHECKED_REPLIES}
    if dut.config.endpoint is not None:
        met.add(POLARIS_BYTES)
        if dut.endpoint.scheme == "serial":
            met.add(SERIAL_LINE)
    tracker = dut.make()
    if isinstance(tracker, ReportsDefinitions) and tracker.definition_blocks:
        met.add(TOOL_DEFINITION)
    return frozenset(need.name for need in met)


PROTOCOL = ProtocolCases(
    cases=tuple(
        sorted(
            (case for module in CASE_MODULES for case in module.CASES.cases),
            key=lambda case: ("PD".index(case.number[0]), case.number[1:]),
        )
    ),
    checklist=POLARIS_CHECKLIST,
    offers=offers,
    simulator=lambda: ("polaris",),
)
