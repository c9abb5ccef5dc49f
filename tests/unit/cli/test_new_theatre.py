"""A new theatre file holds the devices found and examples of the others; a mistake leaves no file."""

from __future__ import annotations

import io
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import pytest
from pydantic import BaseModel
from user_commands import in_this_process, one_error

from procedures.cli.doctor.theatre_checks import case_diagnostics
from procedures.cli.new_theatre import command
from procedures.cli.procedure import app
from ronna_hw import registry
from ronna_hw.config import parse_theatre, read_theatre_file
from ronna_hw.devices.probing import ONLY, Option, Progress, Proposal, Search
from ronna_hw.errors import EXIT_NOT_FOUND, EXIT_USAGE


class Settings(BaseModel):
    """Of a pair of cameras."""

    exposure_us: float = 2000.0
    trigger: Literal["software", "action"] = "software"


EXPOSURE = Option("exposure_us", 2000.0, False, "Exposure of both cameras.", Settings)
TRIGGER = Option("trigger", "software", False, "What triggers both cameras.", Settings)


def pair(left: str, right: str) -> Proposal:
    serials = (Option("left_serial", left, True, "Left."), Option("right_serial", right, True, "Right."))
    endpoints = {"left": "gev://192.168.3.1", "right": "gev://192.168.3.2"}
    return Proposal("cameras", f"{left} and {right}", endpoints, (*serials, EXPOSURE, TRIGGER))


class Cameras:
    """Finds what it is given, wherever it is asked to look."""

    table = "stereo"

    def __init__(self, *pairs: Proposal) -> None:
        self.pairs = pairs
        self.searches: list[Search] = []

    def find(self, search: Search, progress: Progress) -> Sequence[Proposal]:
        self.searches.append(search)
        progress(1.0)
        return self.pairs

    def example(self, search: Search) -> Proposal:
        return pair("1", "2")


class Tracker(Cameras):
    """A tracker at the line that is asked."""

    table = "tracker"

    def find(self, search: Search, progress: Progress) -> Sequence[Proposal]:
        tools = Option("tools", [{"name": "frame", "rom": "frame.rom"}], True, "What it sees.")
        return [Proposal("unit", "a unit", {ONLY: str(line)}, (tools,)) for line in search.lines]


@pytest.fixture
def cameras(monkeypatch: pytest.MonkeyPatch) -> Cameras:
    found = Cameras(pair("11", "12"))
    monkeypatch.setattr(registry, "load_finders", lambda: {"cameras": found, "unit": Tracker()})
    return found


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "lab.toml"


def stereo_of(out: Path) -> dict[str, object]:
    """Options of the cameras in the written file."""
    stereo = read_theatre_file(out).stereo
    assert stereo is not None
    return dict(stereo.options)


def new_theatre(out: Path, *more: object, serial: str = "/dev/ttyUSB7") -> tuple[int, str, str]:
    given = ("--no-check", "--interface", "lo", "--serial", serial, "--out", out)
    done = in_this_process(app, "new-theatre", *given, *more)
    return done.returncode, done.stdout, done.stderr


def test_the_file_contains_the_devices_that_were_found_where_searched_and_describes_what_is_missing(
    cameras: Cameras, out: Path
) -> None:
    code, _, _ = new_theatre(out, "--name", "our lab")
    file, text = read_theatre_file(out), out.read_text()
    assert code == 0
    assert file.theatre == "our lab"
    assert file.tracker is not None
    assert file.tracker.endpoint == "serial:///dev/ttyUSB7"
    assert file.tracker.options == {"tools": ({"name": "frame", "rom": "frame.rom"},)}
    assert stereo_of(out) == {"left_serial": "11", "right_serial": "12"}
    assert "# Exposure of both cameras.\n# exposure_us = 2000.0\n" in text
    assert file.calibration is None
    assert "# [calibration.tracker_frame]" in text
    assert "ronna-procedure calibrate tool-tip" in text
    (search,) = cameras.searches
    assert [each.name for each in search.interfaces] == ["lo"]
    assert [str(line) for line in search.lines] == ["serial:///dev/ttyUSB7"]


def test_a_device_that_was_not_found_becomes_a_commented_example(cameras: Cameras, out: Path) -> None:
    cameras.pairs = ()
    code, _, errors = new_theatre(out)
    text = out.read_text()
    assert code == EXIT_NOT_FOUND
    assert "stereo: not found" in errors
    assert read_theatre_file(out).stereo is None
    _, _, example = text.partition("NOT FOUND")
    uncommented = "\n".join(line[2:] for line in example.splitlines() if line.startswith("# "))
    (table,) = (number for number, line in enumerate(text.splitlines(), 1) if line == "# [stereo]")
    checks = case_diagnostics(read_theatre_file(out), out, out.parent)
    (missing,) = (one for one in checks if one.subject == "devices of a case")
    assert f"[stereo] stands as an example from line {table} of {out.name}" in missing.advice
    stereo = uncommented[uncommented.index("[stereo]") : uncommented.index("tracker:")]
    read = parse_theatre(tomllib.loads('theatre = "lab"\n' + stereo))
    assert read.stereo is not None


def test_no_network_is_searched_without_an_interface(cameras: Cameras, out: Path) -> None:
    in_this_process(app, "new-theatre", "--no-check", "--serial", "/dev/ttyUSB7", "--out", out)
    assert cameras.searches[0].interfaces == ()


@pytest.mark.parametrize(
    ("pairs", "option", "chosen"),
    [
        ((pair("11", "12"), pair("12", "11"), pair("11", "13")), ("--left", "12"), {"right_serial": "11"}),
        ((pair("11", "12"),), ("--right", "192.168.3.2"), {"right_serial": "12"}),
        ((pair("11", "12"),), ("--option", "stereo.exposure_us=1500.5"), {"exposure_us": 1500.5}),
    ],
    ids=["serial number", "address", "option"],
)
def test_a_serial_number_or_address_selects_a_pair_and_an_option_is_parsed_as_toml(
    cameras: Cameras,
    out: Path,
    pairs: tuple[Proposal, ...],
    option: tuple[str, str],
    chosen: dict[str, object],
) -> None:
    cameras.pairs = pairs
    new_theatre(out, *option)
    assert chosen.items() <= stereo_of(out).items()


def test_serial_numbers_that_two_theatres_share_are_told_with_their_addresses_and_owners(
    cameras: Cameras, out: Path
) -> None:
    other = {"left": "gev://192.168.3.3", "right": "gev://192.168.3.4"}
    first = pair("11", "12")
    cameras.pairs = (first, replace(first, endpoints=other, what="11 and 12, of process 7"))
    code, _, errors = new_theatre(out, "--left", "11", "--right", "12")
    assert code == EXIT_USAGE
    assert "11 and 12, of process 7 at gev://192.168.3.3, gev://192.168.3.4" in errors
    assert "serial number 11 is at 2 addresses: 192.168.3.1, 192.168.3.3" in errors
    assert "in place of serial numbers" in errors
    new_theatre(out, "--left", "192.168.3.3", "--right", "192.168.3.4")
    stereo = read_theatre_file(out).stereo
    assert stereo is not None
    assert stereo.endpoints == other


def test_the_user_at_a_terminal_chooses_among_several_pairs(
    cameras: Cameras, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cameras.pairs = (pair("11", "12"), pair("12", "11"))
    monkeypatch.setattr(command, "_choose", lambda _question, words: len(words) - 1)
    new_theatre(out)
    assert stereo_of(out)["left_serial"] == "12"


def test_records_are_copied_from_another_file(cameras: Cameras, out: Path, tmp_path: Path) -> None:
    (tmp_path / "mount").mkdir()
    (tmp_path / "mount/special.rom").write_bytes(b"rom")
    other = tmp_path / "mount/drawing.toml"
    other.write_text(
        'flange = "ours"\n[procedure]\narm_error_mm = 0.2\n'
        '[tracker.options]\ntools = [{name = "special", rom = "special.rom"}]\n'
    )
    new_theatre(out, "--records", other)
    file = read_theatre_file(out)
    assert file.flange == "ours"
    assert file.procedure.arm_error_mm == 0.2
    assert file.tracker is not None
    assert file.tracker.options["tools"][0]["rom"] == str(tmp_path / "mount/special.rom")


WRONG_RECORDS = {
    "an unknown key": ("[cell]\ncolour = 1\n", "cell.colour: unknown key"),
    "angles in place of a quaternion": (
        "[calibration.tool_tip.flange_from_tool]\n"
        "translation_mm = [0.0, 0.0, 300.0]\nquaternion_wxyz = [0.0, 90.0, 0.0, 0.0]\n",
        "not 1: give a rotation, not angles",
    ),
    "names in place of tools": (
        'flange = "ours"\n[tracker.options]\ntools = ["robot_frame.rom"]\n',
        "tracker.options.tools 1: expected a table (found 'robot_frame.rom')",
    ),
    "text in place of options": (
        'flange = "ours"\n[tracker]\noptions = "x"\n',
        "tracker.options: expected a table (found 'x')",
    ),
}


@pytest.mark.parametrize("name", WRONG_RECORDS)
def test_mistakes_in_the_records_are_reported_with_their_file_before_any_search(
    cameras: Cameras, out: Path, tmp_path: Path, name: str
) -> None:
    text, said = WRONG_RECORDS[name]
    (tmp_path / "drawing.toml").write_text(text)
    code, _, errors = new_theatre(out, "--records", tmp_path / "drawing.toml")
    assert code == EXIT_USAGE
    (line, *_) = one_error(errors)
    assert line.startswith("CFG-001: drawing.toml has ")
    assert said in line
    assert cameras.searches == []


def test_a_file_with_simulated_devices_gets_a_rehearsal_banner(cameras: Cameras, out: Path) -> None:
    cameras.pairs = ()
    new_theatre(out, serial="/dev/pts/77")
    assert "REHEARSAL" in read_theatre_file(out).banner


@pytest.mark.parametrize(
    ("options", "shown"),
    [
        (("--interface", "eth77"), "no network interface eth77"),
        (("--controller", "192.168.10.300"), "192.168.10.300 is not an IPv4 address"),
        (
            ("--stream", "tcp://127.0.0.1:1"),
            "--stream: tcp://127.0.0.1:1 cannot be used here; expected udp://",
        ),
        (("--stream", "59152"), "For example: --stream udp://192.168.10.20:59152."),
        (("--serial", "pts/2"), "For example: --serial /dev/ttyUSB0."),
        (("--left", "99"), "no camera 99 replied; expected one of 11 at 192.168.3.1"),
        (("--left", "12"), "--left: 12 is the camera named right (12)"),
        (("--left", "11", "--right", "192.168.3.1"), "camera 192.168.3.1 is given for both sides"),
        (("--option", "stereo.exposure=1"), "Did you mean --option stereo.exposure_us=1?"),
        (("--option", "stero.exposure_us=1"), "Did you mean --option stereo.exposure_us=1?"),
        (("--option", "stereo.trigger=softwar"), "Did you mean --option stereo.trigger=software?"),
        (("--option", "stereo.exposure_us=fast"), "exposure_us: expected a valid number"),
        (("--option", "exposure_us=1"), "TABLE.KEY=VALUE"),
        (("--name", "n" * 600), "--name has 600 characters; expected at most 60"),
        (("--clock", "shm://nothing"), "--clock: 'shm://nothing' needs an absolute path; expected host: or"),
        (("--records", "/nonexist.toml"), "cannot read /nonexist.toml"),
    ],
)
def test_a_mistake_is_reported_and_leaves_no_file(
    cameras: Cameras, out: Path, options: tuple[str, ...], shown: str
) -> None:
    code, _, errors = new_theatre(out, *options)
    assert code == EXIT_USAGE
    assert any(shown in line for line in one_error(errors)), errors
    assert not list(out.parent.iterdir())


def test_a_mistyped_network_card_is_asked_for_again(
    cameras: Cameras, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command.terminal, "on_terminal", lambda _stream: True)
    monkeypatch.setattr("sys.stdin", io.StringIO("lo0\nlo\n"))
    done = in_this_process(app, "new-theatre", "--no-check", "--serial", "/dev/ttyS7", "--out", out)
    assert "this computer has no network interface lo0; expected one of " in done.stderr
    assert [one.name for one in cameras.searches[0].interfaces] == ["lo"]


def test_several_devices_without_a_choice_are_refused(cameras: Cameras, out: Path) -> None:
    cameras.pairs = (pair("11", "12"), pair("12", "11"))
    code, _, errors = new_theatre(out)
    assert code == EXIT_USAGE
    assert "camera 11 at 192.168.3.1\n" in errors
    assert "camera 12 at 192.168.3.2\n" in errors
    assert "Add --left ADDRESS --right ADDRESS" in errors
    assert not out.exists()


def test_every_mistake_of_a_command_line_is_named_at_once(cameras: Cameras, out: Path) -> None:
    out.write_text("mine")
    wrong = ["--controller", "192.168.10.300", "--stream", "59152", "--clock", "sun:", "--interface", "eth77"]
    for option in ("stereo.exposure=1", "stereo.exposure_us=5s", "exposure_us=1"):
        wrong += ["--option", option]
    code, _, errors = new_theatre(out, *wrong, serial="pts/2")
    (line,) = one_error(errors)
    assert code == EXIT_USAGE
    named_mistakes = (
        *(str(out), "eth77", "--serial: 'pts/2'", "192.168.10.300", "--stream: '59152'", "--clock: "),
        "--option: stereo has no option 'exposure'",
        "--option 'stereo.exposure_us=5s': exposure_us: expected a valid number",
        "--option 'exposure_us=1'",
    )
    for number, named in enumerate(named_mistakes, start=1):
        _, numbered, rest = line.partition(f"({number}) ")
        assert numbered

        assert named in rest.partition("; (")[0]
    assert out.read_text() == "mine"
    assert cameras.searches == []


class Arms:
    """An arm at each address that is asked, and none elsewhere."""

    table = "robot"

    def find(self, search: Search, progress: Progress) -> Sequence[Proposal]:
        return [self._at(str(one)) for one in search.controllers]

    def example(self, search: Search) -> Proposal:
        return self._at("tcp://172.31.1.147:54602")

    def _at(self, address: str) -> Proposal:
        return Proposal("arm", "an arm", {ONLY: address}, (Option("pace", 0.1, False, "How fast."),))


def test_a_second_arm_is_the_one_at_the_address_given_for_it(
    cameras: Cameras, monkeypatch: pytest.MonkeyPatch, out: Path
) -> None:
    monkeypatch.setattr(registry, "load_finders", lambda: {"cameras": cameras, "arm": Arms()})
    alone = out.with_name("alone.toml")
    assert new_theatre(alone, "--controller", "10.0.0.1:1")[0] == 0
    assert list(read_theatre_file(alone).robot) == ["master"]
    arms = "--controller", "10.0.0.1:1", "--assistant", "10.0.0.2:2"
    code, _, said = new_theatre(out, *arms, "--option", "robot.assistant.pace=0.2")
    robots = read_theatre_file(out).robot
    assert code == 0, said
    assert {role: (one.endpoint, one.options) for role, one in robots.items()} == {
        "master": ("tcp://10.0.0.1:1", {}),
        "assistant": ("tcp://10.0.0.2:2", {"pace": 0.2}),
    }
