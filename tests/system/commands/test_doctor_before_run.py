"""The doctor reports what `set_up` would refuse, with the same code, and nothing else is refused."""

from __future__ import annotations

import json
import re
import socket
import tomllib
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from user_commands import in_this_process

import drivers.ndi_polaris
from procedures.cli.doctor import inspection
from procedures.cli.procedure import app
from procedures.journal.journal import Journal
from procedures.steps.clinical import set_up
from procedures.workcell import Workcell
from ronna_hw.control_port import ask_control_port
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.errors import EXIT_DONE, EXIT_NOT_FOUND, EXIT_REFUSED, RonnaError
from ronna_hw.evidence.manifest import sha256_of
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.registry import load_driver
from ronna_hw.theatre import Theatre

STEREO_HEAD, GUIDE, NOTHING = 1, 2, 0
MOST_TRIES = 5
SKULL_FRAME = Path(drivers.ndi_polaris.__path__[0]) / "definitions" / "x_frame.rom"
Change = Callable[[str], str]


def _as_it_is(text: str) -> str:
    return text


def _replaced(old: str, new: str) -> Change:
    def change(text: str) -> str:
        assert old in text
        return text.replace(old, new)

    return change


def _in_millennium(digit: str) -> Change:
    """With all records of another millennium: the first digit of each year."""

    def change(text: str) -> str:
        return re.sub(r"^(created|expires) = 2", rf"\1 = {digit}", text, flags=re.MULTILINE)

    return change


def _without(table: str) -> Change:
    """Without a table and those below it."""

    def change(text: str) -> str:
        kept, within = [], False
        for line in text.splitlines():
            if line.startswith("["):
                within = line.strip("[]").split(".")[: table.count(".") + 1] == table.split(".")
            if not within:
                kept.append(line)
        return "\n".join(kept)

    return change


def _swapped(text: str) -> str:
    left, right = (f"{side} = " for side in ("left", "right"))
    return text.replace(left, "SIDE = ").replace(right, left).replace("SIDE = ", right)


def _with_a_record_of_another_arm(text: str) -> str:
    head = tomllib.loads(text)["calibration"]["stereo_head"]
    return _with_arm(text, "kr6_r900_2", head["created"].isoformat())


def _with_a_record_of_another_of_the_model(text: str) -> str:
    head = tomllib.loads(text)["calibration"]["stereo_head"]
    return _with_arm(text, "kr6_r900_sixx", head["created"].isoformat(), 'serial = "1"')


def _with_an_arm_found_with_another_head(text: str) -> str:
    head = tomllib.loads(text)["calibration"]["stereo_head"]
    place = "stereo_head_mm = [218.0, 1.0, 60.0]"
    return _with_arm(text, "kr6_r900_sixx", head["created"].isoformat(), place)


def _with_an_arm_older_than_the_head(text: str) -> str:
    return _with_arm(text, "kr6_r900_sixx", "2026-01-01T00:00:00Z")


def _with_arm(text: str, arm: str, created: str, more: str = "") -> str:
    zeros = {3: "[0.0, 0.0, 0.0]", 2: "[0.0, 0.0]", 1: "0.0"}
    deviations = {"link_translation_mm": 3, "link_rotation_rad": 3, "sine_rad": 2, "cosine_rad": 2}
    deviations |= dict.fromkeys(("joint_offset_rad", "sag_rad", "backlash_rad"), 1)
    dates = f"created = {created}\nexpires = 2126-01-01T00:00:00Z"
    lines = [f"{name} = [{', '.join(6 * [zeros[count]])}]" for name, count in deviations.items()]
    head = f'identifier = "other"\n{dates}\nmade_by = "test"\nstated_error_mm = 0.1\nscatter_mm = 0.1'
    return "\n".join((text, "[calibration.arm]", head, f'arm = "{arm}"', more, *lines))


def _with_another_definition(text: str) -> str:
    return re.sub(r'sha256 = "\w{64}"', f'sha256 = "{64 * "0"}"', text)


def _with_the_frame_of_the_skull_on_the_clamp(text: str) -> str:
    tool = "[[tracker.options.tools]]\n"
    skull = f"{tool}name = \"on_clamp\"\nrom = '{SKULL_FRAME}'\nsha256 = '{sha256_of(SKULL_FRAME)}'\n\n"
    with_it = text.replace(tool, skull + tool, 1)
    return with_it.replace("[procedure]\n", '[procedure]\npatient_frame = "on_clamp"\n')


def _optioned(table: str, line: str) -> Change:
    """With one more option of a device."""
    tools = "[[tracker.options.tools]]\n" if table == "tracker" else ""
    header = f"[{table}.options]\n"
    return lambda text: text.replace(tools or header, f"{header}{line}\n{tools}", 1)


@dataclass(frozen=True)
class Trouble:
    """Something that `set_up` refuses with `code`: a fault, another tool, or a change of the theatre file."""

    code: str
    named: str = ""  # what the verdict names instead of the code
    exit_code: int = EXIT_NOT_FOUND  # of the doctor
    fault: str | None = None
    tool: int = STEREO_HEAD
    change: Change = _as_it_is
    stream_port_taken: bool = False
    advice: str = ""  # begins with that


TROUBLES = {
    "records expired": Trouble("CAL-001", change=_in_millennium("1")),
    "dated in the future": Trouble("CAL-001", change=_in_millennium("9")),
    "no calibrations": Trouble("DEV-007", "calibration", change=_without("calibration")),
    "record of another arm": Trouble("CAL-013", change=_with_a_record_of_another_arm),
    "record of another arm of the model": Trouble("CAL-013", change=_with_a_record_of_another_of_the_model),
    "arm found with another head": Trouble("CAL-020", change=_with_an_arm_found_with_another_head),
    "arm older than the head": Trouble("CAL-021", change=_with_an_arm_older_than_the_head),
    "records of other cameras": Trouble(
        "STE-010",
        change=_replaced('\nserial = "21904412"', '\nserial = "21900001"'),
        advice="The right camera was exchanged: 21904412 replied, the calibration record is of 21900001",
    ),
    "cameras swapped": Trouble("GEV-004", change=_swapped),
    "tools of another flange": Trouble("TOOL-003", change=lambda text: text.replace("flange =", "#", 1)),
    "no record of the guide": Trouble("TOOL-002", change=_without("tools.guide")),
    "frame on the guide not tracked": Trouble(
        "DEV-003", change=_replaced('tool = "guide_frame"', 'tool = "pointer"')
    ),
    "patient's frame misspelt": Trouble(
        "DEV-003", change=_replaced("[procedure]\n", '[procedure]\npatient_frame = "clamp"\n')
    ),
    "patient's frame of the skull's shape": Trouble(
        "TOOL-008", change=_with_the_frame_of_the_skull_on_the_clamp
    ),
    "no cameras": Trouble("DEV-007", "without stereo", EXIT_REFUSED, change=_without("stereo")),
    "clock gone": Trouble("CLK-001", change=_replaced("shm:///proc/", "shm:///proc/0")),
    "no banner": Trouble("CFG-004", exit_code=EXIT_REFUSED, change=_replaced("banner = ", 'banner = "" # ')),
    "guide mounted": Trouble("PRO-009", tool=GUIDE),
    "nothing mounted": Trouble("PRO-009", tool=NOTHING),
    "camera unplugged": Trouble(
        "GEV-001", fault="camera unplug left", advice="The left camera 21904411 was not found"
    ),
    "camera seized": Trouble("GEV-005", fault="camera seize left"),
    "tracker without power": Trouble("NDI-002", fault="tracker power off"),
    "tracker faulty": Trouble("NDI-020", fault="tracker alert 2"),
    "EKI taken": Trouble("EKI-002", fault="robot eki taken"),
    "EKI silent": Trouble("EKI-001", fault="robot eki silence"),
    "stream port in use": Trouble("RSI-001", stream_port_taken=True),
    "tool definition gone": Trouble("NDI-011", change=_replaced("robot_frame.rom", "gone.rom")),
    "tool definition changed": Trouble("NDI-013", change=_with_another_definition),
    "tracker's line gone": Trouble(
        "NDI-001", change=_replaced("serial:///dev/pts/", "serial:///dev/pts/9999")
    ),
    "another tracker": Trouble("NDI-004", change=_optioned("tracker", 'expected_model = "vicra"')),
    "tracker's option misspelt": Trouble("NDI-010", change=_optioned("tracker", 'expected_modell = "vega"')),
    "cameras of another model": Trouble("GEV-002", change=_optioned("stereo", 'expected_model = "acA1300"')),
    "another camera": Trouble(
        "GEV-003",
        change=_replaced('left_serial = "2', 'left_serial = "3'),
        advice='left_serial = "31904411" is probably mistyped: camera 21904411 replied',
    ),
    "cameras' option misspelt": Trouble("GEV-016", change=_replaced("left_serial = ", "left_seriall = ")),
    "no such driver": Trouble("DEV-002", change=_replaced('"basler_stereo"', '"basler"')),
    "controller of another cycle": Trouble("EKI-005", change=_optioned("robot.master", "cycle_ms = 12")),
    "arm's option misspelt": Trouble("RSI-013", change=_replaced("silence_limit_s", "silence_limits")),
    "program for another arm": Trouble(
        "RSI-017", change=_replaced('variant = "kr6_r900_sixx"', 'variant = "kr6_r900_2"')
    ),
    "tracker bumped": Trouble("NDI-021", fault="tracker bump"),  # the last: it stays until it is acknowledged
}
AS_A_CASE_DOES = (
    "the doctor connects and configures as a case does; no simulated device can be made to answer so"
)
UNTRIED = {
    "ARM-009": "the arm of a driver from another package that has not registered it: no driver here has one",
    "PRO-002": "a question to a person; what it asks about is a line of the doctor's, see test_left_away.py",
    "PRO-003": "there is no journal before a run; the doctor judges the disk that it is written to",
    "CFG-001": "the doctor reads the same file",
    "DUAL-004": "the theatre here has one arm; tests/unit/cli/doctor compares two",
    "CFG-002": "the doctor reads the same file",
    "EKI-006": AS_A_CASE_DOES,
    "NDI-003": AS_A_CASE_DOES,
    "NDI-012": "refused where NDI-011 is, and needs definitions that no theatre has",
    **{f"NDI-03{number}": AS_A_CASE_DOES for number in range(8)},
    **{f"GEV-{number:03}": AS_A_CASE_DOES for number in range(6, 13)},
}
CODES = re.compile(r"([A-Z]+-)(\d{3})(?: to [A-Z]+-(\d{3}))?")


def _named_codes() -> set[str]:
    """Every code that set_up, the workcell and the three drivers say they refuse a case with."""
    drivers = [cast("Any", load_driver(name)) for name in ("kuka_rsi", "ndi_polaris", "basler_stereo")]
    ways = [
        each for driver in drivers for each in (driver, driver.__init__, driver.connect, driver.configure)
    ]
    found = (CODES.findall(each.__doc__ or "") for each in (set_up.run, Workcell.__init__, *ways))
    return {
        f"{package}{number:03}"
        for codes in found
        for package, first, last in codes
        for number in range(int(first), int(last or first) + 1)
    }


def test_each_refusal_that_a_case_begins_with_is_tried_or_says_why_not() -> None:
    tried = {trouble.code for trouble in TROUBLES.values()}
    assert _named_codes() - tried == set(UNTRIED)


@dataclass
class Room:
    """A simulated theatre, its file and its control port."""

    file: Path
    control: str


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Room]:
    folder = tmp_path_factory.mktemp("theatre")
    with ChildProcess(
        "ronna-sim theatre", command("sim.cli", "theatre", "--scene", "mini", "--out", str(folder))
    ) as child:
        yield Room(Path(child.ready["file"]), child.ready["endpoints"]["control"])


@pytest.fixture(autouse=True)
def _few_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inspection, "PAIRS_LOOKED_AT", 2)
    monkeypatch.setattr(inspection, "FRAMES_LOOKED_AT", 3)


def _refusal(file: Path, folder: Path) -> RonnaError | None:
    """What building the workcell or the step `set_up` raises in that theatre."""
    try:
        with closing(Journal(folder)) as journal, closing(Theatre.from_file(file)) as theatre:
            workcell = Workcell(theatre, journal)
            setting = SimpleNamespace(
                today=lambda: datetime.now(UTC),
                arm_not_home=None,
                starts=frozenset(),
                settings=theatre.file.procedure,
                surroundings=theatre.file.cell_with_tools,
            )
            context = SimpleNamespace(workcell=workcell, setting=setting, progress=lambda *_: None)
            set_up.run(cast("Any", context))
    except RonnaError as error:
        return error
    return None


def _awaited_refusal(file: Path, folder: Path) -> RonnaError | None:
    """The same, once a fault that was just injected acts: a busy simulator takes a moment."""
    for number in range(MOST_TRIES):
        again = folder / str(number)
        again.mkdir()
        if (refused := _refusal(file, again)) is not None:
            return refused
    return None


@pytest.mark.slow
@pytest.mark.parametrize("name", ["nothing", *TROUBLES])
def test_the_doctor_predicts_each_refusal_of_set_up(name: str, room: Room, tmp_path: Path) -> None:
    trouble = TROUBLES.get(name)
    file = room.file
    taken = None
    if trouble is not None:
        file = room.file.with_name("troubled.toml")
        file.write_text(trouble.change(room.file.read_text()))
        ask_control_port(room.control, "mount", number=trouble.tool)
        if trouble.fault is not None:
            ask_control_port(room.control, "fault", line=trouble.fault)
        if trouble.stream_port_taken:
            rsi = parse_endpoint(Theatre.from_file(room.file).file.robot["master"].endpoints["rsi"])
            taken = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            taken.bind((rsi.host, rsi.port))
    try:
        refused = None if trouble is None else _awaited_refusal(file, tmp_path)
        done = in_this_process(app, "doctor", "--config", file, "--json")
        refused = _refusal(file, tmp_path) if trouble is None else refused
    finally:
        ask_control_port(room.control, "clear_faults")
        ask_control_port(room.control, "mount", number=STEREO_HEAD)
        if taken is not None:
            taken.close()
    report = json.loads(done.stdout)
    (case,) = (verdict for verdict in report["verdicts"] if verdict["of"] == "case")
    if trouble is None:
        assert refused is None
        assert case == {"of": "case", "ready": True, "because": []}
        assert done.returncode == EXIT_DONE
        (guide,) = (one for one in report["findings"] if one["subject"].endswith("visibility of guide_frame"))
        assert (guide["well"], guide["advice"]) == (True, "")  # it comes with the guide
        return
    assert refused is not None
    assert refused.code == trouble.code, refused
    assert not case["ready"]
    said = " ".join(finding["seen"] for finding in report["findings"] if not finding["well"])
    if trouble.named:
        assert trouble.named in " ".join(case["because"])
    else:
        assert trouble.code in said, said
    assert done.returncode == trouble.exit_code
    assert any(one["advice"].startswith(trouble.advice) for one in report["findings"] if not one["well"])
