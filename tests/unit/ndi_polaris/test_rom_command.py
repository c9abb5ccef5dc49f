"""`ronna-rom`: make, show, compare and check, as printed for people and for scripts."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.ndi_polaris import PolarisTracker
from drivers.ndi_polaris.rom_command import app
from drivers.ndi_polaris.shipped_tools import FOLDER, build_shipped_definitions
from drivers.ndi_polaris.tool_definition import decode_definition, encode_definition, read_definition
from drivers.ndi_polaris.tool_description import describe_tool
from ronna_hw.clock import HostClock
from ronna_hw.command_line.terminal import exit_code_of
from ronna_hw.config import read_theatre_file

Rom = Callable[..., tuple[int, str, str]]
POINTER = """
part_number = "POINTER-1"
main_type = "pointer"
markers_mm = [[0, 0, 0], [0, 110.5, 0], [52, 140, 0], [-35, 33, 0]]
"""


@pytest.fixture
def rom(capsys: pytest.CaptureFixture[str]) -> Rom:
    """Run the command; return exit code, standard output and standard error."""

    def run(*arguments: object) -> tuple[int, str, str]:
        code = exit_code_of(app, [str(argument) for argument in arguments])
        said = capsys.readouterr()
        return code, said.out, said.err

    return run


def made(rom, folder: Path, description: str, name: str = "tool") -> tuple[int, str, Path]:
    (folder / f"{name}.toml").write_text(description)
    code, _, messages = rom("make", folder / f"{name}.toml", "--out", folder / f"{name}.rom")
    return code, messages, folder / f"{name}.rom"


def test_make_builds_a_tool_from_its_marker_coordinates(rom: Rom, tmp_path: Path) -> None:
    code, messages, file = made(rom, tmp_path, POINTER)
    assert code == 0
    assert "POINTER-1, 4 markers, 752 bytes" in messages
    assert "warning" not in messages
    tool = read_definition(file)
    assert tool.markers_mm[1] == (0.0, 110.5, 0.0)
    assert (tool.main_type, tool.subtype) == (2, 1)
    assert tool.normals == ((0.0, 0.0, 1.0),) * 4
    assert file.read_bytes()[20:24] != bytes(4)


def test_every_field_of_a_description_reaches_the_definition(rom: Rom, tmp_path: Path) -> None:
    _, _, file = made(
        rom,
        tmp_path,
        POINTER
        + """
manufacturer = "LAB"
subtype = 2
revision = 7
made_on = 2026-02-03
sequence = 12
normals = [[0, 0, 2], [0, 0, 2], [3, 0, 0], [3, 0, 0]]
faces = [1, 1, 2, 2]
maximum_angle_deg = 60
minimum_markers = 4
maximum_error_mm = 0.75
minimum_spread_mm = [1, 2, 3]
unique_geometry = false
marker_type = "disc"
""",
    )
    tool = read_definition(file)
    assert (tool.manufacturer, tool.subtype, tool.revision, tool.sequence) == ("LAB", 2, 7, 12)
    assert tool.made_on.isoformat() == "2026-02-03"
    assert tool.normals[2] == (1.0, 0.0, 0.0)
    assert tool.face_normals == ((0.0, 0.0, -1.0), (-1.0, 0.0, 0.0))
    assert (tool.maximum_angle_deg, tool.minimum_markers, tool.maximum_error_mm) == (60, 4, 0.75)
    assert (tool.minimum_spread_mm, tool.unique_geometry, tool.marker_type) == ((1.0, 2.0, 3.0), False, 49)


@pytest.mark.parametrize("name", sorted(build_shipped_definitions()))
def test_a_shown_description_makes_the_same_bytes_again(rom: Rom, tmp_path: Path, name: str) -> None:
    code, description, _ = rom("show", name, "--toml")
    assert code == 0
    _, _, file = made(rom, tmp_path, description)
    assert file.read_bytes() == (FOLDER / name).read_bytes()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("", "part_number"),
        ("part_number = 5\nmarkers_mm = [[0,0,0],[1,0,0],[0,2,0]]", "part_number"),
        ('part_number = "A"\nmarkers_mm = [[0,0,0],[1,0,0]]', "markers_mm"),
        (POINTER + "sequence = 0", "sequence"),
        (POINTER + "made_on = 1900-01-01", "made_on"),
        (POINTER + "colour = 1", "colour"),
        (POINTER + "normals = [[0,0,0]]", "length 0"),
        (POINTER + "normals = [[0,0,1],[0,0,-1]]", "1 or 4"),
        (POINTER + "normals = [[0,0,1],[0,0,1],[0,0,-1],[0,0,-1]]", "cancel"),
        (POINTER + "faces = [1,1,3,3]", "gap"),
        (POINTER + "face_normals = [[0,0,1],[0,1,0]]", "face_normals"),
        (POINTER + "minimum_markers = 5", "5 of 4"),
        (POINTER + 'marker_type = "cube"', "marker_type"),
        (POINTER.replace("pointer", "hammer"), "main_type"),
        (POINTER.replace("110.5", "nan"), "markers_mm"),
        (POINTER.replace("POINTER-1", "größer"), "ASCII"),
        ("part_number", "not TOML"),
    ],
)
def test_an_invalid_description_gives_one_message_and_writes_nothing(
    rom: Rom, tmp_path: Path, line: str, words: str
) -> None:
    code, messages, file = made(rom, tmp_path, line)
    assert code == 1
    assert messages.startswith("NDI-011")
    assert words in messages
    assert len(messages.splitlines()) == 1
    assert not file.exists()


def test_make_warns_of_similar_marker_distances(rom, tmp_path: Path) -> None:
    square = 'part_number = "SQUARE"\nmarkers_mm = [[0,0,0],[50,0,0],[50,50,0],[0,50,0]]'
    code, messages, file = made(rom, tmp_path, square)
    assert code == 0
    assert file.exists()
    assert "warning: SQUARE: marker distances 50.0 and 50.0 mm" in messages


def test_json_output_reports_a_tool_in_numbers(rom: Rom, tmp_path: Path) -> None:
    (tmp_path / "p.toml").write_text(POINTER)
    _, text, _ = rom("make", tmp_path / "p.toml", "--out", tmp_path / "p.rom", "--json")
    report = json.loads(text)
    assert report["bytes"] == 752
    assert report["tool"]["markers_mm"][1] == [0.0, 110.5, 0.0]
    _, text, _ = rom("show", tmp_path / "p.rom", "--json")
    shown = json.loads(text)
    assert shown["sha256"] == report["sha256"]
    assert len(shown["segments_mm"]) == 6


def test_compare_exits_with_1_when_something_differs(rom: Rom, tmp_path: Path) -> None:
    _, _, first = made(rom, tmp_path, POINTER, "first")
    _, _, second = made(rom, tmp_path, POINTER.replace("-35, 33, 0", "-35, 33, 2.5"), "second")
    assert rom("compare", first, first)[0] == 0
    code, table, messages = rom("compare", first, second)
    assert code == 1
    assert "markers_mm[4]\t-35 33 0\t-35 33 2.5\t2.500" in table
    assert messages.startswith("1 difference;")
    report = json.loads(rom("compare", first, second, "--json")[1])
    assert report["differences"][0]["distance_mm"] == pytest.approx(2.5)
    assert not report["same"]


def test_check_refuses_tools_that_share_a_triangle_of_markers(rom: Rom, tmp_path: Path) -> None:
    assert rom("check", "robot_frame.rom", "x_frame.rom")[0] == 0
    twin = tmp_path / "twin.rom"
    twin.write_bytes((FOLDER / "robot_frame.rom").read_bytes())
    code, _, messages = rom("check", "robot_frame.rom", twin)
    assert code == 1
    assert "robot_frame and twin share a triangle of markers" in messages
    report = json.loads(rom("check", "robot_frame.rom", "x_frame.rom", "--tolerance-mm", "6", "--json")[1])
    assert report["not_told_apart"] == []
    assert {(pair["first_tool"], pair["second_tool"]) for pair in report["alike"]} >= {
        ("robot_frame", "x_frame")
    }


def test_a_shipped_definition_is_found_by_its_name_when_no_such_file_exists(
    rom: Rom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert rom("show", "x_frame")[1] == rom("show", "x_frame.rom")[1].replace("x_frame.rom", "x_frame")
    (tmp_path / "x_frame.rom").write_bytes((FOLDER / "robot_frame.rom").read_bytes())
    assert "RONNA-M" in rom("show", "x_frame.rom")[1]
    assert rom("show", "no/x_frame.rom")[0] == 1


@pytest.mark.parametrize("command", ["show", "check"])
def test_a_foreign_file_is_refused_by_name(rom: Rom, tmp_path: Path, command: str) -> None:
    (tmp_path / "cat.png").write_bytes(b"PNG" + bytes(749))
    code, _, messages = rom(command, tmp_path / "cat.png")
    assert code == 1
    assert messages.startswith("NDI-011: cat.png is not a tool definition")


def test_a_description_rounds_numbers_to_single_precision() -> None:
    tool = decode_definition(encode_definition(build_shipped_definitions()["x_frame.rom"]))
    assert describe_tool(tool)["markers_mm"][1] == [31.5, 50.0, 0.0]


def test_a_theatre_file_names_its_tool_definitions_relative_to_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab, elsewhere = tmp_path / "lab", tmp_path / "elsewhere"
    (lab / "tools").mkdir(parents=True)
    elsewhere.mkdir()
    (lab / "tools" / "mine.rom").write_bytes((FOLDER / "x_frame.rom").read_bytes())
    (lab / "theatre.toml").write_text(
        'schema = 1\ntheatre = "lab"\n[tracker]\ndriver = "ndi_polaris"\nendpoint = "tcp://127.0.0.1:1"\n'
        '[tracker.options]\ntools = [{ name = "mine", rom = "tools/mine.rom" }, '
        '{ name = "M", rom = "robot_frame.rom" }]\n'
    )
    monkeypatch.chdir(elsewhere)
    config = read_theatre_file(lab / "theatre.toml").tracker
    assert config is not None
    tracker = PolarisTracker("tracker", config, HostClock())
    assert set(tracker.definition_blocks) == {"mine", "M"}
    assert tracker.definition_blocks["mine"] == (FOLDER / "x_frame.rom").read_bytes()
