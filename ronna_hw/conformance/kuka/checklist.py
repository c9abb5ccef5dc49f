"""The numbered checklist of KUKA's RSI and EKI, and which case looks at which line.

S lines are about the controller, on the wire (cases K), D lines about the driver (cases L).
"""

from __future__ import annotations

from ronna_hw.conformance.checklist import Checklist

_LINES: dict[int, str] = {
    1: "S: the controller sends first; nothing is expected from the client before",
    2: "S: a telegram every 4 or 12 ms on an absolute schedule, the median within 1 % over 1,000",
    3: "S: one source port within a run; D: answers to the sender",
    4: "S: no white space between elements, double quotes, closed without a blank",
    5: "S: elements and attributes in the order of the configuration, IPOC last",
    6: "S: the root says Type KUKA",
    7: "S: six values of EIPos, always",
    8: "S: the digits that Precision asks for",
    9: "S: Delay D is a whole number",
    10: "S: IPOC grows by exactly the cycle and never repeats",
    11: "D: the IPOC comes back unchanged, as whole number",
    12: "D: one reply to a telegram; after a stall only to the newest",
    13: "D: the reply's Type is SENTYPE",
    14: "S: a wrong Type, a wrong IPOC and broken XML are no reply",
    15: "S: the socket is drained each cycle; one late reply shifts none",
    16: "S: HOLDON 1 keeps and 0 zeroes, element by element",
    17: "S: late cycles are counted in D and end the run at Timeout, by both ways of counting",
    18: "S: ONLYSEND never counts and ignores replies",
    19: "S: what a tag means comes from the wiring: AK, AKorr, RKorr",
    20: "S: ABSOLUTE is start plus value, RELATIVE adds the value every cycle",
    21: "S: the first telegram has AIPos = ASPos; corrections do not move ASPos and RSol",
    22: "S: clamps at the object's limits and tells it in Stat",
    23: "S: beyond the monitor the run ends, at 6 mm and 6 deg when none is wired",
    24: "S: too large a step, speed or acceleration and end switches are faults, never a jump",
    25: "S: RIst is the flange for AIPos with tool and base, within 0.001 mm and deg",
    26: "S: A B C pass the golden poses",
    27: "S: Stop on its rising edge ends the stream within two cycles and RSI_OFF",
    28: "S: a new run has a new IPOC and port; D: begins anew without a jump",
    29: "D: no step above its limit, the first correction zero",
    30: "D: silence is noticed within its limit, told, and stops the motion",
    31: "D: the growth of D and its own turnaround are told",
    32: "D: works with RSIPI's echo server as controller",
    33: "S: works with RSIPI and the two C++ clients",
    34: "S: EKI serves one client, writes one telegram at a time and nothing else",
    35: "S: EKI takes NUL padding, split and merged requests",
    36: "S: EKI closes by end tags, Status in the SDK's order",
    37: "S: every request is answered within 4 s, event 7 for what does not fit",
    38: "D: EKI is read by element ends",
    39: "S: Status once after connect and on every change, never two in a segment",
    40: "S: a lost conversation is opened anew; D: connects again and reads the state, never assumes it",
    41: "S: an EKI memory that runs over (512) closes the connection",
    42: "S: emergency stop, guard, drives and mode show within 100 ms and stop RSI's motion",
    43: "S: every fault can be injected by name and at a given cycle, and is logged with IPOC",
    44: "D: no start outside EXT (or T1, confirmed), nor with emergency stop, guard or a message",
}
_ELSEWHERE: dict[int, str] = {
    18: "needs a context of its own: tests/unit/sim_kuka",
    19: "needs contexts of its own: tests/unit/sim_kuka, tests/system/test_kuka_sim_rsipi.py",
    22: "our context reaches to the end switches; a narrow one: tests/unit/sim_kuka",
    23: "our monitor reaches to the end switches; a narrow one: tests/unit/sim_kuka",
    26: "needs large motions: tests/unit/sim_kuka, tests/unit/arm",
    32: "needs that program: tests/system/test_kuka_link_rsipi.py",
    33: "needs that program: tests/system/test_kuka_sim_rsipi.py; the C++ ones are not on the index",
    41: "no safe way on a running controller: tests/unit/sim_kuka, tests/system/kuka_sim",
    43: "of a simulator only: tests/unit/sim_kuka/test_kuka_link_faults.py, tests/system/kuka_sim",
}
# What a line says beyond its cases, and why no case shows it.
_REMARKS: dict[int, str] = {
    16: "HOLDON 0 needs a context of its own: tests/unit/sim_kuka",
    17: "needs --allow destructive; the second way of counting: tests/unit/sim_kuka",
    20: "RELATIVE needs a program of its own: tests/system/test_kuka_sim_rsipi.py",
    21: "our context sends neither ASPos nor RSol: tests/unit/sim_kuka, tests/system/test_kuka_sim_rsipi.py",
    24: "needs a control port, by which a simulator is known: no arm of hardware is told to jump",
    30: "needs --allow destructive: the controller ends the run as well",
    42: "needs a control port: nobody stands at the cell's doors for the suite",
    44: "needs a control port; T1 with a person's confirmation: tests/unit/kuka_rsi",
}

# Cases of any arm, or of another line, that look at a line as well.
_ALSO: dict[int, tuple[str, ...]] = {
    3: ("L11",),  # its tap hears what is answered to the tap's own port, and nothing else
    28: ("R10", "R17"),
    29: ("R06",),
}

KUKA_CHECKLIST = Checklist(letters="KL", lines=_LINES, remarks=_REMARKS, elsewhere=_ELSEWHERE, also=_ALSO)
