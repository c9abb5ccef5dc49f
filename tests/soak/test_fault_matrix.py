"""Every fault of the three devices in every step in which it can happen, on the mini scene.

A cell passes when the case ends as promised: at its target, or with one of the codes of that fault, in time.
A case that failed moved nothing after the failure, its journal is whole, and no process is left.
"""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from user_commands import Commands

from procedures.engine.journal import JOURNAL_FILE, Entry, read_journal

pytestmark = [pytest.mark.soak, pytest.mark.timeout(300)]

LARGEST_ERROR_MM = 1.5
WITHIN_S = (
    150.0  # host time for a whole case, on a busy computer; one that does not settle takes 60 s of theatre
)
DONE = "done"
STEPS = {
    "tracker": ("set_up", "global_localization"),
    "robot": ("set_up", "relocalization", "tool_change", "positioning", "at_target", "retreat"),
    "camera": ("set_up", "relocalization"),
}
STOPPED = frozenset({"EKI-007", "EKI-008", "EKI-010"})  # by the controller: before, or while the stream runs
REFUSED_PAIR = frozenset({"STE-011", "STE-012", "PRO-008"})
# Fault -> the codes that a case may end with, whatever the step; where the device does nothing at that moment
# the case goes on.
TRACKER = {
    "occlude marker 1": {"PRO-007", "REG-008", "REG-009"},
    "occlude tool robot_frame": {"PRO-007"},
    "occlude tool robot_frame marker 1": {"PRO-007"},
    "bend tool robot_frame 2 mm": {"PRO-007", "REG-008", "REG-009"},
    "turn tool robot_frame 3 deg": {"PRO-007", "PRO-008", "REG-008", "REG-009", "PLAN-007"},
    "move tool robot_frame +5 +0 +0 mm": {"PRO-007", "PRO-008", "REG-009"},
    "interference tool robot_frame": {"PRO-007"},
    "sunlight": {"PRO-007", "REG-008", "REG-009"},
    "strays 2": {"REG-008", "REG-009"},
    "reflections 2": set(),
    "phantoms 3 mm": {"REG-009"},
    "bump": {"NDI-021"},
    "cold": {"NDI-022"},
    "hot": {"NDI-022"},
    "alert 3": {"NDI-020", "NDI-037"},
    "power off": {"NDI-001", "NDI-002", "NDI-007"},
    "restart": {"NDI-007", "NDI-008"},
    "watchdog": {"NDI-007"},
    "repeat frames": {"PRO-007"},
    "skip 2 frames": set(),
    "garble commands 5 %": {"NDI-003", "NDI-006"},
    "garble replies 5 %": {"NDI-003"},
    "drop bytes 5 %": {"NDI-003"},
    "double bytes 5 %": {"NDI-003"},
    "cut replies 5 %": {"NDI-002", "NDI-003"},
    "lose replies 5 %": {"NDI-002"},
    "delay replies 0.5 s": {"NDI-002", "NDI-007", "PRO-007"},
    "slow TSTART 1 s": set(),
}
ROBOT = {
    "drop 10 % for 1 s": set(),
    "delay 2 cycles for 0.5 s": STOPPED,
    "duplicate 20 % for 1 s": set(),
    "reorder 10 % for 1 s": set(),
    "corrupt replies 5 % for 1 s": set(),
    "wrong ipoc 5 % for 1 s": set(),
    "future ipoc 5 % for 1 s": set(),
    "constant ipoc": {*STOPPED, "RSI-003"},
    "missing ipoc 5 % for 1 s": set(),
    "wrong type 5 % for 1 s": set(),
    "bad number 5 % for 1 s": set(),
    "corrupt telegrams 5 % for 1 s": set(),
    "lose telegrams 5 % for 1 s": set(),
    "network cut": {*STOPPED, "RSI-002", "RSI-003"},
    "foreign sender": set(),
    "emergency stop": STOPPED,
    "guard open": STOPPED,
    "mode T1": {*STOPPED, "EKI-006"},
    "drives off": STOPPED,
    "trip torque": STOPPED,
    "clamp 1 deg": {"RSI-005"},
    "collision": STOPPED,
    "overload": {"RSI-005", *STOPPED},
    "stick axis 3": {"RSI-005", "RSI-011"},
    "program restart": {*STOPPED, "RSI-008"},
    "eki cut": {"EKI-002"},
    "eki overflow": {"EKI-002"},
    "eki half telegram": {"EKI-004"},
    "eki garbage": set(),
    "eki padding": set(),
    "eki silence": {"EKI-001", "EKI-003"},
    "short first telegram": set(),
    "start key held": set(),
}
CAMERA = {
    "stain marker 1 20 %": set(),
    "glare left 20 px": set(),
    "occlude left 20 %": set(),
    "occlude left 60 %": REFUSED_PAIR,
    "twist left +0.2 deg": {"STE-014"},
    "drop 2 %": set(),
    "lose left 5 %": set(),
    "forget left": {"STE-012", "GEV-014"},
    "omit leader left": set(),
    "omit trailer left": set(),
    "omit frames left": set(),
    "shuffle both": set(),
    "duplicate left 20 %": set(),
    "shift area left": REFUSED_PAIR,
    "truncate left": REFUSED_PAIR,
    "unplug left": {"GEV-001", "GEV-014"},
    "ignore heartbeat left": {"GEV-014", "GEV-009"},
    "seize left": {"GEV-009", "GEV-014"},
    "delay answers left 50 ms": set(),
    "lose answers left 10 %": set(),
    "restart left": {"GEV-009", "GEV-014", *REFUSED_PAIR},
    "miss triggers left": REFUSED_PAIR,
    "expose late left 5 ms": REFUSED_PAIR,
    "drift left +200 ppm": REFUSED_PAIR,
    "reset clock left": REFUSED_PAIR,
    "saturate both": REFUSED_PAIR,
    "darken both": REFUSED_PAIR,
    "defocus left 3 px": REFUSED_PAIR,
    "dust left 50 spots": set(),
    "narrow path left 600 bytes": {"GEV-010", *REFUSED_PAIR},
    "announce answers left 50 ms": set(),
    "lose events left 50 %": set(),
}
CELLS = [
    (f"when step == {step}: {device} {fault}", frozenset(codes))
    for device, faults in (("tracker", TRACKER), ("robot", ROBOT), ("camera", CAMERA))
    for fault, codes in faults.items()
    for step in STEPS[device]
]


@pytest.fixture
def commands() -> Iterator[Commands]:
    started = Commands()
    yield started
    assert started.await_no_survivors() == []


def test_the_matrix_has_three_hundred_cells() -> None:
    assert len(CELLS) >= 300


@pytest.mark.parametrize(("line", "codes"), CELLS, ids=[line for line, _ in CELLS])
def test_under_a_fault_a_case_ends_as_promised(
    commands: Commands, tmp_path: Path, line: str, codes: frozenset[str]
) -> None:
    script = tmp_path / "faults.txt"
    script.write_text(line + "\n")
    case = ("--scene", "mini", "--seed", "3", "--faults", str(script), "--out", str(tmp_path / "runs"))
    ended = commands.run("ronna-procedure", "run", "--sim", *case, "--json", timeout_s=WITHIN_S)
    outcome = json.loads(ended.stdout)
    journal = list(read_journal(tmp_path / "runs" / outcome["run"] / JOURNAL_FILE))
    kinds = [entry["entry"] for entry in journal]
    assert kinds[-1] == Entry.CLOSED
    if outcome["outcome"] == DONE:
        assert outcome["max_application_error_mm"] <= LARGEST_ERROR_MM
        return
    assert outcome["error"]["code"] in codes, ended.stderr
    assert Entry.MOTION not in kinds[kinds.index(Entry.FAILED) :]
