"""KUKA RSI and EKI protocol suite: numbered checklist, cases, and simulator.

S lines are about the controller, on the wire (cases K), D lines about the driver (cases L).
"""

from __future__ import annotations

from conformance.kuka import controller_cases, driver_cases
from conformance.protocol import Checklist, ProtocolCases
from ronna_hw.host.network import own_udp_endpoint
from ronna_hw.wire.kuka_context import OWN_CONTEXT

_LINES: dict[int, str] = {
    1: "S: the controller sends first",
    2: "S: a telegram every 4 or 12 ms on an absolute schedule, the median within 1 % over 1,000",
    3: "S: one source port within a run; D: answers to the sender",
    4: "S: no white space between elements, double quotes, closed without a blank",
    5: "S: elements and attributes in the order of the configuration, IPOC last",
    6: "S: the root has Type KUKA",
    7: "S: six values of EIPos, always",
    8: "S: as many decimals as Precision states",
    9: "S: Delay D is an integer",
    10: "S: IPOC increases by exactly the cycle time and never repeats",
    11: "D: the IPOC is echoed unchanged, as an integer",
    12: "D: one reply per telegram; after a stall only to the newest",
    13: "D: the reply's Type is SENTYPE",
    14: "S: a reply with a wrong Type, a wrong IPOC or broken XML does not count",
    15: "S: the socket is drained each cycle; one late reply delays no other",
    16: "S: HOLDON 1 keeps and 0 zeroes, element by element",
    17: "S: late cycles are counted in D and end the run at Timeout, in both counting modes",
    18: "S: ONLYSEND never counts and ignores replies",
    19: "S: the wiring defines the meaning of a tag: AK, AKorr, RKorr",
    20: "S: ABSOLUTE is start plus value, RELATIVE adds the value every cycle",
    21: "S: the first telegram has AIPos = ASPos; corrections do not move ASPos and RSol",
    22: "S: clamps at the object's limits and reports it in Stat",
    23: "S: beyond the monitor's limit the run ends; 6 mm and 6 deg when none is wired",
    24: "S: too large a step, speed or acceleration, or an end switch, is a fault, never a jump",
    25: "S: RIst is the flange for AIPos with tool and base, within 0.001 mm and deg",
    26: "S: A B C pass the golden poses",
    27: "S: a rising edge of Stop ends the stream within two cycles and RSI_OFF",
    28: "S: a new run has a new IPOC and port; D: starts again without a jump",
    29: "D: no step above its limit, the first correction zero",
    30: "D: silence is detected within its limit, reported, and stops the motion",
    31: "D: late cycles by D and its own turnaround are reported",
    32: "D: works with RSIPI's echo server as controller",
    33: "S: works with RSIPI and the two C++ clients",
    34: "S: EKI serves one client, writes one telegram at a time and nothing else",
    35: "S: EKI accepts padding with NUL, split and merged requests",
    36: "S: EKI has separate end tags, Status in the SDK's order",
    37: "S: every request is answered within 4 s, an invalid one by event 7",
    38: "D: EKI elements are delimited by their end tags",
    39: "S: Status once after connect and on every change, never two in a segment",
    40: "S: a lost connection can be reopened; D: reconnects and reads the state, never assumes it",
    41: "S: an EKI memory overflow (512) closes the connection",
    42: "S: emergency stop, guard, drives and mode show within 100 ms and stop RSI's motion",
    43: "S: every fault can be injected by name and at a given cycle, and is logged with IPOC",
    44: "D: no start outside EXT (or T1, confirmed), nor with emergency stop, guard or a message",
}
_SDK_CHANNEL = "a channel not used by any driver here: tests/system/robot/kuka_sim/test_eki_channels.py"
_ELSEWHERE: dict[int, str] = {
    18: "needs a dedicated context: tests/unit/sim_kuka",
    19: "needs dedicated contexts: tests/unit/sim_kuka, tests/system/robot/test_kuka_sim_rsipi.py",
    22: "our context reaches to the end switches; a narrow one: tests/unit/sim_kuka",
    23: "our monitor reaches to the end switches; a narrow one: tests/unit/sim_kuka",
    24: "not run on a real arm: tests/unit/sim_kuka/test_signal_flow.py",
    26: "needs large motions: tests/unit/sim_kuka, tests/unit/arm",
    32: "needs RSIPI: tests/system/robot/test_kuka_link_rsipi.py",
    33: "needs RSIPI: tests/system/robot/test_kuka_sim_rsipi.py; the C++ clients are not on the Python index",
    36: _SDK_CHANNEL,
    37: _SDK_CHANNEL,
    39: _SDK_CHANNEL,
    41: "not safe on a running controller: tests/unit/sim_kuka, tests/system/robot/kuka_sim",
    42: "the suite cannot open the guard: tests/system/robot/kuka_sim/test_cell_faults.py",
    43: "simulator only: tests/unit/sim_kuka/test_rsi_link.py, tests/system/robot/kuka_sim",
    44: "the suite cannot open the guard: tests/unit/kuka_rsi",
}
# Requirements of a line beyond its cases, and where they are tested.
_REMARKS: dict[int, str] = {
    16: "HOLDON 0 needs a dedicated context: tests/unit/sim_kuka",
    17: "needs --allow destructive; the second counting mode: tests/unit/sim_kuka",
    20: "RELATIVE needs a dedicated program: tests/system/robot/test_kuka_sim_rsipi.py",
    21: "our context sends neither: tests/unit/sim_kuka, tests/system/robot/test_kuka_sim_rsipi.py",
    30: "needs --allow destructive: the controller ends the run as well",
}

# Generic cases, and cases of another line, that also check a line.
_ALSO: dict[int, tuple[str, ...]] = {
    3: ("L11",),  # its tap only receives what is sent to the tap's port
    6: ("K04",),
    28: ("R10", "R17"),
    29: ("R06",),
}

KUKA_CHECKLIST = Checklist(letters="KL", lines=_LINES, remarks=_REMARKS, elsewhere=_ELSEWHERE, also=_ALSO)


def simulator() -> tuple[str, ...]:
    """Return the `ronna-sim` arguments for a simulated controller, whose client binds the RSI endpoint."""
    any_port = "tcp://127.0.0.1:0"
    addresses = ("--rsi", own_udp_endpoint(), "--eki", any_port, "--eki-project", any_port)
    return ("kuka", "--rsi-context", str(OWN_CONTEXT), *addresses)


PROTOCOL = ProtocolCases(
    cases=(*controller_cases.CASES.cases, *driver_cases.CASES.cases),
    checklist=KUKA_CHECKLIST,
    simulator=simulator,
)
