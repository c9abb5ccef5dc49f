"""`ronna-tool` as a user runs it: records are defined, listed and checked; mistakes are reported."""

from __future__ import annotations

import json
import re
import shlex
import tomllib
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from coded_errors import raises
from recording_cell import ENDPOINTS
from scipy.spatial.transform import Rotation
from user_commands import in_this_process, one_error

from procedures.cli.doctor.calibrations import setting_diagnostics, tool_diagnostics
from procedures.cli.procedure import app as ronna_procedure
from procedures.cli.tool.command import app
from procedures.planning.errors import FOREIGN_TOOL
from procedures.planning.tool_records import ToolRecords
from procedures.runs.calibration_files import update_theatre
from procedures.runs.theatre_history import UpdateAuthor, history_path
from ronna_hw.config import parse_theatre, read_theatre_file
from sim.theatre.theatre_file import theatre_content
from sim.world.scene.named_scenes import draw_scene

PLAIN = (
    *("--number", "3", "--mass-kg", "1.1", "--centre-of-gravity-mm", "100", "0", "40", "--by", "A. Nurse"),
)
GAUGE = ("--gauge-deg", "-40", "-75", "99", "0", "66", "180")
DEFINE = (*PLAIN, "--reach-mm", "80", "--bore-mm", "90", "--play-mm", "0.05", *GAUGE)
GUIDE, DEGREES = "--reach-mm 85 --bore-mm 85 --play-mm 0.04", " ".join(GAUGE)

ONE_READ = "0.01 -0.02 0.03 0.04 -0.05"
TILT = Rotation.from_euler("x", 5.0, degrees=True)


@pytest.fixture
def theatre(tmp_path: Path) -> Path:
    path = tmp_path / "theatre.toml"
    path.write_text(tomli_w.dumps(theatre_content(draw_scene("mini", seed=3), ENDPOINTS, "host:", {}, 1.0)))
    return path


@pytest.fixture
def dials(tmp_path: Path) -> Path:
    """As someone wrote them down: twelve approaches, all alike."""
    return written(tmp_path / "dials.txt", *[ONE_READ] * 12)


def written(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines))
    return path


def test_a_defined_tool_takes_flange_and_tip_from_the_file_and_the_readings_of_its_gauge_and_is_listed(
    theatre: Path, dials: Path
) -> None:
    options = ("--config", theatre, "--purpose", "drill_guide", *DEFINE, "--gauge-mm", dials)
    old = read_theatre_file(theatre)
    done = in_this_process(app, "define", "drill-guide", *options)
    assert done.returncode == 0, done.stderr
    record = read_theatre_file(theatre).tools["drill-guide"]

    assert (record.flange, record.tip) == (old.flange, old.tools["guide"].tip)
    assert record.gauge is not None
    assert (record.gauge.reading_mm, record.gauge.approaches) == ((0.01, -0.02, 0.03), 12)
    listed = json.loads(in_this_process(app, "list", "--config", theatre, "--json").stdout)
    assert [one["name"] for one in listed["tools"]] == ["stereo_head", "guide", "drill-guide"]
    assert all(one["valid"] for one in listed["tools"])
    assert in_this_process(app, "check", "--config", theatre).returncode == 0


@pytest.mark.hazard(47)
def test_defining_a_known_tool_again_names_what_its_former_record_had_besides(theatre: Path) -> None:
    options = ("--config", theatre, "--purpose", "needle_guide")
    again = [option if option != "3" else "2" for option in DEFINE]
    done = in_this_process(app, "define", "guide", *options, *again)
    text = " ".join(done.stderr.split())
    assert (done.returncode, "the former record of guide had [tools.guide.frame]" in text) == (0, True), text
    assert "copy what this tool still has" in text


def test_tools_defined_in_the_same_second_are_two_records(theatre: Path) -> None:
    options = ("--config", theatre, "--purpose", "gripper", *PLAIN)
    in_this_process(app, "define", "cutter", *options)
    former = read_theatre_file(theatre).tools["cutter"].identifier
    done = in_this_process(app, "define", "cutter", *options)
    assert read_theatre_file(theatre).tools["cutter"].identifier != former
    assert f"instead of {former}" in " ".join(done.stdout.split())


def test_a_name_with_control_characters_signs_nothing(theatre: Path) -> None:
    options = ("--config", theatre, "--purpose", "gripper", *PLAIN)
    for name in ("Bad\x1b[31mName", "Bad\nName", "Bad\u202eName"):
        refused = in_this_process(app, "define", "cutter", *options, "--by", name)
        assert (refused.returncode, "DEV-006" in refused.stderr) == (3, True), name
    assert not history_path(theatre).exists()


def test_names_of_records_are_printed_without_control_characters(theatre: Path) -> None:
    theatre.write_text(theatre.read_text().replace('"tool-guide', '"\\u009b2Jtool-guide'))
    fit = in_this_process(app, "check", "--config", theatre)
    assert (fit.returncode, "\\x9b2Jtool-guide" in fit.stdout) == (0, True), fit.stderr


@pytest.mark.hazard(47)
def test_check_refuses_a_record_of_another_flange(theatre: Path) -> None:
    options = ("--config", theatre, "--purpose", "gripper", *PLAIN, "--flange", "old")
    assert in_this_process(app, "define", "gripper", *options).returncode == 0
    done = in_this_process(app, "check", "--config", theatre)
    assert done.returncode == 3
    assert "TOOL-003" in " ".join(one_error(done.stderr))


@pytest.mark.hazard(47)
@pytest.mark.parametrize(
    ("table", "name", "expected"),
    [
        (
            *("tools", "guide"),
            ["tool record tool-guide-mini-3 expired on 20", "ronna-tool renew; no motion until then"],
        ),
        (
            *("calibration", "tool_tip"),
            [
                "calibration tool-tip-mini-3 expired on 20",
                "Run ronna-procedure calibrate tool-tip --config {} ",
            ],
        ),
    ],
)
def test_check_refuses_an_expired_record_of_tool_or_tip_and_says_what_to_do(
    theatre: Path, table: str, name: str, expected: list[str]
) -> None:
    _let_expire(theatre, table, name)
    done = in_this_process(app, "check", "--config", theatre)
    assert done.returncode == 3
    assert "fit" not in done.stdout
    said = " ".join(one_error(done.stderr))
    assert said.startswith("CAL-001: ")
    assert all(text.format(theatre) in said for text in expected)


@pytest.mark.hazard(47)
def test_a_case_with_an_expired_tool_record_is_refused_before_the_ct_is_read(theatre: Path) -> None:
    _let_expire(theatre, "tools", "guide")
    case, runs = theatre.parent, theatre.with_name("runs")
    (case / "ct").mkdir()
    (case / "plan.toml").touch()
    done = in_this_process(ronna_procedure, "run", "--config", theatre, "--case", case, "--out", runs)
    assert done.returncode == 3
    said = " ".join(one_error(done.stderr))
    assert "CAL-001: tool record tool-guide-mini-3 expired" in said
    assert "ct_import" not in said


def _let_expire(theatre: Path, table: str, name: str) -> None:
    content = tomllib.loads(theatre.read_text())
    content[table][name].update(
        created=datetime(2020, 1, 1, tzinfo=UTC), expires=datetime(2021, 1, 1, tzinfo=UTC)
    )
    theatre.write_text(tomli_w.dumps(content))


def _with_another_tip(theatre: Path) -> dict[str, Any]:
    """What `calibrate tool-tip --update` leaves: the new record, in the same file."""
    old = read_theatre_file(theatre).calibration
    assert old is not None
    update_theatre(
        theatre,
        {"tool_tip": {**old.tool_tip.model_dump(), "identifier": "tip-of-today"}},
        old.tool_tip.created,
        UpdateAuthor("calibration tool-tip"),
    )
    guide: dict[str, Any] = tomllib.loads(theatre.read_text())["tools"]["guide"]
    return guide


@pytest.mark.hazard(47)
def test_calibrating_the_tip_leaves_the_tool_record_outdated_and_names_the_renew_command(
    theatre: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = tomllib.loads(theatre.read_text())["tools"]["guide"]
    guide = _with_another_tip(theatre)
    assert guide == before
    assert f"ronna-tool renew guide --config {theatre} " in capsys.readouterr().err
    refused = in_this_process(app, "check", "--config", theatre)
    assert refused.returncode == 3
    assert "TOOL-003" in refused.stderr
    assert "ronna-tool renew" in refused.stderr


def test_a_renewed_record_has_the_new_tip_and_the_mean_gauge_readings(theatre: Path, dials: Path) -> None:
    _with_another_tip(theatre)
    low, high = "0 -0.03 0.02 0.03 -0.06", "0.02 -0.01 0.04 0.05 -0.04"
    written(dials, *[low, "", high] * 6)
    options = ("--config", theatre, "--by", "A. Nurse", "--gauge-mm", dials)
    done = in_this_process(app, "renew", "guide", *options)
    assert done.returncode == 0, done.stderr
    record = read_theatre_file(theatre).tools["guide"]
    assert (record.tip, record.made_by) == ("tip-of-today", "A. Nurse")
    assert record.gauge is not None
    assert (record.gauge.reading_mm, record.gauge.upper_reading_mm) == ((0.01, -0.02, 0.03), (0.04, -0.05))
    assert record.gauge.approaches == 12
    assert record.gauge.spread_mm == pytest.approx(0.01 * (12 / 11) ** 0.5, abs=1e-6)
    assert in_this_process(app, "check", "--config", theatre).returncode == 0


@pytest.mark.hazard(47)
def test_renewing_says_how_far_the_mandrel_is_from_the_former_record(theatre: Path, tmp_path: Path) -> None:
    was = read_theatre_file(theatre).tools["guide"].gauge
    assert was is not None
    x, y, z = was.reading_mm
    bent = written(tmp_path / "bent.txt", *[f"{x + 3} {y - 4} {z} 0 0"] * 12)
    options = ("--config", theatre, "--by", "A. Nurse")
    done = in_this_process(app, "renew", "guide", *options, "--gauge-mm", bent)
    text = " ".join(done.stderr.split())
    assert (done.returncode, "the tip is 0.000 mm" in text) == (0, True), text
    assert "warning: the mandrel reads 5.000 mm from where the former record of guide has it" in text
    same = written(tmp_path / "same.txt", *[f"{x + 3} {y - 4} {z} 0 0"] * 12)
    again = " ".join(in_this_process(app, "renew", "guide", *options, "--gauge-mm", same).stderr.split())
    assert "the mandrel reads 0.000 mm" in again
    assert "warning" not in again
    folder = in_this_process(app, "renew", "guide", *options, "--gauge-mm", tmp_path)
    assert folder.returncode == 2
    assert "one line for each approach" in folder.stderr


@pytest.mark.parametrize("word", ["1_0", "\N{FULLWIDTH DIGIT ONE}"])
def test_a_gauge_reading_that_nobody_writes_so_is_refused(theatre: Path, tmp_path: Path, word: str) -> None:
    odd = written(tmp_path / "odd.txt", *[f"{word} 0 0 0 0"] * 12)
    options = ("--config", theatre, "--by", "A. Nurse")
    done = in_this_process(app, "renew", "guide", *options, "--gauge-mm", odd)
    assert (done.returncode, "odd.txt:1" in done.stderr, "five numbers" in done.stderr) == (2, True, True)


def shifted(pose: dict[str, list[float]]) -> None:
    pose["translation_mm"][2] += 30.0


def turned(pose: dict[str, list[float]]) -> None:
    tilted = Rotation.from_quat(pose["quaternion_wxyz"], scalar_first=True) * TILT
    pose["quaternion_wxyz"] = tilted.as_quat(scalar_first=True).tolist()


@pytest.mark.hazard(3)
@pytest.mark.parametrize(
    ("edit", "off"), [(shifted, "30.000 mm{} 0.000 deg"), (turned, "0.000 mm{} 5.000 deg")]
)
def test_a_tip_edited_after_the_record_was_signed_is_refused_and_renewing_says_how_far_it_is(
    theatre: Path, dials: Path, edit: Callable[[dict[str, list[float]]], None], off: str
) -> None:
    content = tomllib.loads(theatre.read_text())
    edit(content["calibration"]["tool_tip"]["flange_from_tool"])
    theatre.write_text(tomli_w.dumps(content))
    refused = in_this_process(app, "check", "--config", theatre)
    assert refused.returncode == 3
    assert "TOOL-003" in refused.stderr
    assert f"limit 0.001 mm, 0.001 deg, got {off.format(',')}" in refused.stderr
    options = ("--config", theatre, "--by", "A. Nurse", "--gauge-mm", dials)
    done = in_this_process(app, "renew", "guide", *options)
    assert f"the tip is {off.format(' and')} from where the former record of guide has it" in done.stderr


@pytest.mark.parametrize(
    ("edit", "advice"),
    [
        (
            lambda guide: guide.update(centre_of_gravity_mm=[456.0, 0.0, 0.0]),
            r"The tip of .*its centre of gravity 456 mm: check \[calibration.tool_tip\]",
        ),
        (
            lambda guide: guide.pop("tip_in_head"),
            r"\[tools.guide\] has no tip_in_head, so a tip edited since .*ronna-tool renew",
        ),
        pytest.param(
            lambda guide: guide["gauge"].update(approaches=1),
            r"\[tools.guide.gauge\] is the mean of 1 approaches, not of 12: good .*ronna-tool renew",
            marks=pytest.mark.hazard(47),
        ),
    ],
)
def test_the_doctor_warns_of_a_doubtful_record_of_a_guide(
    theatre: Path, edit: Callable[[dict[str, Any]], object], advice: str
) -> None:
    content = tomllib.loads(theatre.read_text())
    (before,) = tool_diagnostics(read_theatre_file(theatre), theatre, datetime.now(UTC))
    edit(content["tools"]["guide"])
    (after,) = tool_diagnostics(parse_theatre(content), theatre, datetime.now(UTC))
    assert (before.advice, after.well) == ("", True)
    assert re.match(advice, after.advice)


def test_the_doctor_warns_of_an_error_that_no_uncalibrated_arm_has(theatre: Path) -> None:
    content = tomllib.loads(theatre.read_text())
    (before,) = setting_diagnostics(read_theatre_file(theatre))
    content["procedure"]["arm_error_mm"] = 0.03
    (after,) = setting_diagnostics(parse_theatre(content))
    assert before.advice == ""
    assert after.advice.startswith("The best arms without [calibration.arm] are off by 0.1 mm per axis")


@pytest.mark.parametrize(
    ("command", "text"),
    [
        ("renew guide --by '' --gauge-mm DIALS", "expected letters, got nothing"),
        ("renew gide --by Nurse --gauge-mm DIALS", "no tool 'gide' with a gauge; expected guide"),
        ("renew stereo_head --by Nurse --gauge-mm DIALS", "TOOL-002"),
        (f"define guide --purpose needle_guide {DEGREES}", "needs `bore`"),
        (f"define Guide --purpose needle_guide {GUIDE} {DEGREES}", "Did you mean guide?"),
        ("define drill --purpose gripper --number 2", "drill has number 2, already used by guide"),
        ("define d --purpose gripper --gauge-deg -400 -75 99 0 66 180", "A1 is -400 degrees; expected -170"),
        (
            f"define d --purpose needle_guide {GUIDE} --gauge-deg -400 -75 99 0 66 nan",
            "has 1 mistake: tools.d.gauge.joints_deg 6: expected a finite number (found nan); besides, "
            "--gauge-deg: A1 is -400 degrees; expected -170",
        ),
        (
            f"define guide --purpose drill --number 2 {DEGREES}",
            "is not that of a guide; expected needle_guide or drill_guide, got drill",
        ),
        ("define d --purpose gripper --centre-of-gravity-mm 0.11 0 0.03", "has length 0.114: give milli"),
        (
            f"define d --purpose needle_guide {GUIDE} --gauge-deg -0.698 -1.309 1.728 0 1.152 3.1416",
            "joints_deg: are -0.698 -1.309 1.728 0 1.152 3.1416, all within 2 pi: give degrees, not radians",
        ),
        (
            f"define d --purpose needle_guide {DEGREES} --reach-mm 85 --play-mm 0.04 --bore-mm 8.5",
            "bore.length_mm: is 8.5, expected at least 15 mm: give millimetres, not centimetres",
        ),
        (
            f"define d --purpose needle_guide {DEGREES} --reach-mm 8.5 --play-mm 0.04 --bore-mm 85",
            "bore.reach_mm is 8.5: expected at least gauge.base_mm = 60",
        ),
    ],
)
def test_an_impossible_value_is_refused_with_its_name_value_and_range(
    theatre: Path, dials: Path, command: str, text: str
) -> None:
    name, *arguments = shlex.split(command.replace("DIALS", str(dials)))
    given = (*PLAIN, *arguments) if name == "define" else arguments
    said = in_this_process(app, name, *given, "--config", theatre)
    assert said.returncode != 0
    assert text in " ".join(one_error(said.stderr))
    assert not history_path(theatre).exists()


@pytest.mark.parametrize(
    ("command", "code"),
    [("define d --purpose needle_guide", 2), ("define d --purpose drill --by 7", 3), ("check", 2)],
)
def test_the_exit_codes_are_those_of_the_help(theatre: Path, command: str, code: int) -> None:
    name, *arguments = shlex.split(command)
    if name == "check":
        theatre.write_text(theatre.read_text().replace('purpose = "needle_guide"', 'purpose = "drill"'))
    done = in_this_process(app, name, *(PLAIN if name == "define" else ()), *arguments, "--config", theatre)
    assert done.returncode == code, done.stderr
    text = " ".join(in_this_process(app, name, "--help").stdout.split())
    assert f" {code} " in text.partition("Exit codes:")[2].partition("Options:")[0]


@pytest.mark.hazard(47)
@pytest.mark.parametrize(
    ("lines", "text"),
    [
        ([ONE_READ] * 11, "dials.txt has 11 approaches; expected at least 12, in 3 mountings"),
        ([*[ONE_READ] * 11, "0.01 -0.02 400 0.04 -0.05"], "dials.txt:12: Z is 400; expected -10.01 to 10.01"),
        ([*[ONE_READ] * 11, "0.01 -0.02 nan 0.04 -0.05"], "dials.txt:12: Z is nan; expected -10.01 to 10.01"),
        ([*[ONE_READ] * 11, "0.01 -0.02 0.3 0.04 -0.05"], "Z is 0.3; expected within 0.1 mm of the others"),
        (
            [ONE_READ.replace(".", ","), *[ONE_READ] * 11],
            "X Y Z UPPER_X UPPER_Y. Write them with decimal points",
        ),
        (["0.01 -0.02", *[ONE_READ] * 11], "dials.txt:1: '0.01 -0.02'; expected five numbers, X Y Z UPPER"),
    ],
    ids=["too few", "beyond the dial", "no number", "misread", "decimal commas", "incomplete"],
)
def test_gauge_readings_that_make_no_record_are_refused(
    theatre: Path, dials: Path, lines: list[str], text: str
) -> None:
    options = ("--config", theatre, "--by", "A. Nurse", "--gauge-mm", written(dials, *lines))
    done = in_this_process(app, "renew", "guide", *options)
    assert done.returncode == 2
    assert text in " ".join(one_error(done.stderr))
    assert not history_path(theatre).exists()


def test_calibration_accepts_a_tool_record_of_the_former_tip(theatre: Path) -> None:
    _with_another_tip(theatre)
    file = read_theatre_file(theatre)
    assert file.calibration is not None
    now = datetime.now(UTC)
    ToolRecords.of(file, calibrating=True).check(file.calibration, now)
    with raises(FOREIGN_TOOL):
        ToolRecords.of(file).check(file.calibration, now)
