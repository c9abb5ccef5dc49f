"""A theatre file with one number that nothing real has is refused when it is read, and the table is named."""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import UTC, datetime
from functools import reduce
from pathlib import Path
from typing import Any

import pytest
import tomli_w

from ronna_hw.config import BadTheatreFile, parse_theatre, read_theatre_file
from sim.theatre.theatre_file import theatre_content
from sim.world.process import load_scene
from sim.world.scene.assistant import add_assistant
from sim.world.scene.model import ArmResidual, CalibrationError

SIMULATED = {
    "polaris": "serial:///dev/pts/9",
    "kuka": {"rsi": "udp://127.0.0.1:59152", "eki_project": "tcp://127.0.0.1:54602"},
    "basler": {"left": "gev://127.77.0.1", "right": "gev://127.77.0.2"},
}
REAL = {
    "polaris": "serial:///dev/ttyUSB0",
    "kuka": {"rsi": "udp://192.168.10.20:59152", "eki_project": "tcp://192.168.10.2:54602"},
    "basler": {"left": "gev://192.168.3.2", "right": "gev://192.168.4.2"},
}
DATED = (
    "calibration.stereo_head",
    "calibration.tool_tip",
    "calibration.tracker_frame",
    "calibration.arm",
    "tools.stereo_head",
    "tools.guide",
)
STATED = tuple(f"{table}.stated_error_mm" for table in DATED if table.startswith("calibration"))
ASSUMED = tuple(f"procedure.{key}" for key in ("arm_error_mm", "tool_error_mm", "seating_error_mm"))
ENDLESS = datetime(9999, 1, 1, tzinfo=UTC)


@pytest.fixture
def content() -> dict[str, Any]:
    """A theatre of real devices, whose records are in order."""
    return _content(REAL)


def _content(endpoints: dict[str, Any], *, dual: bool = False) -> dict[str, Any]:
    scene = load_scene("mini", seed=3, calibrated=True)
    scene = add_assistant(scene) if dual else scene
    content = theatre_content(scene, endpoints, "host:", {}, 1.0)
    parse_theatre(content)
    return content


@pytest.fixture
def dual() -> dict[str, Any]:
    """A theatre of two arms, whose records are in order."""
    endpoints = {**REAL, "assistant": {role: one.replace(".2:", ".3:") for role, one in REAL["kuka"].items()}}
    endpoints["assistant"]["rsi"] = "udp://192.168.10.20:59153"
    return _content(endpoints, dual=True)


def _change(content: dict[str, Any], key: str, change: Callable[[Any], Any]) -> None:
    *tables, last = key.split(".")
    table = reduce(lambda inner, name: inner[name], tables, content)
    table[last] = change(table.get(last))


@pytest.mark.parametrize("key", [*STATED, *ASSUMED])
def test_an_error_in_metres_is_refused(content: dict[str, Any], key: str) -> None:
    _change(content, key, lambda error_mm: error_mm / 1000.0)
    with pytest.raises(BadTheatreFile, match=rf"{key}: give millimetres, not metres \(found \d"):
        parse_theatre(content)


@pytest.mark.parametrize("key", [*STATED, "procedure.tool_error_mm"])
@pytest.mark.parametrize("error_um", [20.0, 5.0])
def test_an_error_in_micrometres_is_refused(content: dict[str, Any], key: str, error_um: float) -> None:
    _change(content, key, lambda _: error_um)
    said = rf"{key}: expected less than [15] mm: give millimetres, not micrometres \(found {error_um:g}"
    with pytest.raises(BadTheatreFile, match=said):
        parse_theatre(content)


@pytest.mark.parametrize(
    "key",
    [
        "calibration.assistant_holder.flange_from_clamp.translation_mm",
        "calibration.assistant_holder.flange_from_frame.translation_mm",
        "calibration.assistant_holder.flange_from_ball_mm",
        "calibration.assistant_arm.tool_tip_mm",
        "calibration.tool_tip.flange_from_tool.translation_mm",
    ],
)
def test_a_place_on_an_arm_in_metres_is_refused(dual: dict[str, Any], key: str) -> None:
    _change(dual, key, lambda place: [length / 1000.0 for length in place or (0.0, 0.0, 160.0)])
    with pytest.raises(BadTheatreFile, match=rf"{key.rpartition('.')[2]}.*: give millimetres, not metres"):
        parse_theatre(dual)


@pytest.mark.hazard(61)
@pytest.mark.parametrize(
    "key",
    ["flange_from_clamp.translation_mm", "flange_from_ball_mm", "flange_from_frame.translation_mm"],
)
def test_a_place_on_the_holder_in_centimetres_is_refused(dual: dict[str, Any], key: str) -> None:
    _change(dual, f"calibration.assistant_holder.{key}", lambda mm: [length / 10.0 for length in mm])
    with pytest.raises(BadTheatreFile, match=r"CFG-001.*at least 35 mm from the flange.*not centimetres"):
        parse_theatre(dual)


@pytest.mark.hazard(61)
@pytest.mark.parametrize("key", ["flange_from_clamp", "flange_from_frame"])
def test_a_holder_whose_frame_faces_along_the_instrument_is_refused(dual: dict[str, Any], key: str) -> None:
    def reverse(wxyz: Any) -> list[float]:
        w, x, y, z = wxyz
        return [-x, w, z, -y]  # turned by half a turn about its own x axis

    _change(dual, f"calibration.assistant_holder.{key}.quaternion_wxyz", reverse)
    with pytest.raises(BadTheatreFile, match=r"CFG-001.*assistant_holder.*expected at least 60.*reverse"):
        parse_theatre(dual)


@pytest.mark.parametrize("error_mm", [0.0, 1e300])
@pytest.mark.parametrize("key", [*STATED, *ASSUMED[:2]])
def test_an_error_of_nothing_or_of_any_size_is_refused(
    content: dict[str, Any], key: str, error_mm: float
) -> None:
    _change(content, key, lambda _: error_mm)
    with pytest.raises(BadTheatreFile, match=rf"{key}: expected (greater|less) than "):
        parse_theatre(content)


def test_a_scene_without_errors_has_records_that_state_what_a_laboratory_can(tmp_path: Path) -> None:
    scene = load_scene("mini", seed=3, calibrated=True)
    exact = {name: 0.0 for name, field in CalibrationError.model_fields.items() if field.annotation is float}
    arm = ArmResidual(link_mm=0.0, angle_rad=0.0, tool_mm=0.0)
    update = {
        "calibration_error": CalibrationError(**exact, arm=arm),
        "head": scene.head.model_copy(update={"seating_error_mm": 0.0}),
    }
    path = tmp_path / "theatre.toml"
    path.write_text(
        tomli_w.dumps(theatre_content(scene.model_copy(update=update), SIMULATED, "host:", {}, 1.0))
    )
    theatre = read_theatre_file(path)
    assert theatre.calibration is not None
    assert min(record.stated_error_mm for record in theatre.calibration.records.values()) > 0.0
    assert theatre.procedure.seating_error_mm == 0.0


HUGE = 1e300


@pytest.mark.parametrize(
    ("key", "change", "said"),
    [
        ("procedure.coarse_fine_limit_mm", lambda _: HUGE, "less than or equal to 5.75"),
        ("procedure.coarse_fine_limit_mm", lambda _: 0.003, "give millimetres, not metres"),
        ("procedure.approach_mm", lambda _: HUGE, "less than or equal to 500"),
        ("procedure.seating_error_mm", lambda _: HUGE, "less than or equal to 2"),
        ("procedure.stand_mm", lambda _: [HUGE, 0.0, 0.0], "has length 1e+300: expected at most 10000 mm"),
        ("procedure.recline_deg", lambda _: [60.0, 0.0], "the least angle comes first, got 60 and 0"),
        ("procedure.recline_deg", lambda _: [0.0, 180.0], "less than or equal to 90"),
        ("procedure.head_turn_deg", lambda _: 180.0, "less than or equal to 60"),
        ("procedure.servo_area_px", lambda _: [0, 1024], "greater than or equal to 16"),
        ("calibration.arm.scatter_mm", lambda mm: mm / 1000.0, "give millimetres, not metres"),
        ("calibration.arm.scatter_mm", lambda _: HUGE, "less than or equal to 1"),
        ("calibration.arm.sag_rad", lambda sag: [HUGE, *sag[1:]], "less than or equal to 0.1"),
        ("calibration.stereo_head.left.serial", lambda _: "", "is empty"),
        ("calibration.tracker_frame.tool", lambda _: "", "is empty"),
        ("calibration.tool_tip.tool_number", lambda _: 1, "is the number of the stereo head"),
        ("tools.guide.gauge.joints_deg", lambda deg: [HUGE, *deg[1:]], "less than or equal to 720"),
        ("tools.guide.gauge.reading_mm", lambda _: [0.0, HUGE, 0.0], "less than or equal to 100"),
        ("tools.guide.centre_of_gravity_mm", lambda _: [0.0, 0.0, HUGE], "expected at most 1000 mm"),
    ],
)  # fmt: skip
def test_a_number_beyond_what_is_built_or_measured_is_refused(
    content: dict[str, Any], key: str, change: Callable[[Any], Any], said: str
) -> None:
    _change(content, key, change)
    with pytest.raises(BadTheatreFile, match=rf"1 mistake: {key}[ 0-9]*: .*{re.escape(said)}"):
        parse_theatre(content)


def _remaining(change: Callable[[list[list[float]]], object] = lambda rows: rows) -> list[str]:
    """Lines for an arm of six joints, each error alone and half of what is allowed, after a change."""
    count = 13 * 6 + 3
    rows = [[0.0] * number + [0.05 if 18 <= number < count - 3 else 10.0] for number in range(count)]
    change(rows)
    return [" ".join(map(str, row)) for row in rows]


def test_the_covariance_of_an_arm_is_read(content: dict[str, Any]) -> None:
    content["calibration"]["arm"]["remaining"] = _remaining()
    calibration = parse_theatre(content).calibration
    assert calibration is not None
    assert calibration.arm is not None
    assert calibration.arm.remaining is not None
    assert calibration.arm.remaining[-1] == (*[0.0] * 80, 10.0)


def _set(row: int, *last: float) -> Callable[[list[list[float]]], object]:
    return lambda rows: rows[row].__setitem__(slice(-len(last), None), last)


@pytest.mark.parametrize(
    ("remaining", "said"),
    [
        ([], "remaining: expected 81 rows, of 1 to 81 numbers"),
        (_remaining(list.pop), "remaining: expected 81 rows, of 1 to 81 numbers"),
        (_remaining(lambda rows: rows[3].append(0.0)), "remaining: expected 81 rows, of 1 to 81 numbers"),
        (_remaining(lambda rows: rows[0].clear()), "remaining: expected 81 rows, of 1 to 81 numbers"),
        (_remaining(_set(0, 0.0)), "remaining: row 1 is 0 mm, expected at least 0.001 mm"),
        (_remaining(_set(80, 1e-4)), "remaining: row 81 is 0.0001 mm, expected at least 0.001 mm"),
        (_remaining(_set(17, 15.0, 15.0)), "remaining: row 18 is 21, expected at most 20"),
        (_remaining(_set(18, 0.2)), "remaining: row 19 is 0.2, expected at most 0.1"),
        (_remaining(_set(77, HUGE, HUGE)), "remaining: row 78 is 1.4e+300, expected at most 0.1"),
        (_remaining(_set(5, float("nan"))), "finite number"),
        ([*_remaining()[:-1], "one two"], "could not convert"),
    ],
)
def test_a_covariance_that_no_calibration_leaves_is_refused(
    content: dict[str, Any], remaining: list[str], said: str
) -> None:
    content["calibration"]["arm"]["remaining"] = remaining
    with pytest.raises(BadTheatreFile, match=rf"CFG-001.*1 mistake: calibration\.arm.*{re.escape(said)}"):
        parse_theatre(content)


def test_a_tool_with_the_number_of_the_stereo_head_is_refused(content: dict[str, Any]) -> None:
    del content["tools"]["stereo_head"]
    _change(content, "tools.guide.number", lambda _: 1)
    with pytest.raises(BadTheatreFile, match=r"tools\.guide: a needle_guide has number 1, that of the"):
        parse_theatre(content)


@pytest.mark.parametrize("key", ["corridor_mm", "zone.near_speed_mm_s"])
def test_a_limit_near_the_head_cannot_be_switched_off_by_a_large_number(
    content: dict[str, Any], key: str
) -> None:
    content["cell"] = reduce(lambda inner, name: {name: inner}, reversed(key.split(".")), 1000.0)
    with pytest.raises(BadTheatreFile, match=rf"cell\.{key}: expected less than or equal to "):
        parse_theatre(content)


@pytest.mark.parametrize("far_mm", [2_200.0, HUGE])
@pytest.mark.parametrize("table", ["stereo_head", "tool_tip"])
def test_a_tool_longer_than_the_arm_is_refused(content: dict[str, Any], table: str, far_mm: float) -> None:
    _change(content, f"calibration.{table}.flange_from_tool.translation_mm", lambda _: [far_mm, 0.0, 0.0])
    said = rf"calibration\.{table}\.flange_from_tool.*has length .*at most"
    with pytest.raises(BadTheatreFile, match=said):
        parse_theatre(content)


@pytest.mark.parametrize(
    ("camera", "said"),
    [
        ({"sensor_px": [1088, 2048]}, "not in the middle half of sensor_px [1088, 2048]: give columns first"),
        ({"sensor_px": [-2048, 1088]}, "greater than or equal to 16"),
        ({"sensor_px": [2048, 0]}, "greater than or equal to 16"),
        ({"focal_px": [1136.4, 1136.4]}, "is a view of 84 degrees, expected at most 75"),
        ({"focal_px": [HUGE, 11364.0]}, "less than or equal to 1000000"),
    ],
)  # fmt: skip
def test_a_lens_or_sensor_that_is_none_is_refused(
    content: dict[str, Any], camera: dict[str, Any], said: str
) -> None:
    for side in ("left", "right"):
        content["calibration"]["stereo_head"][side] |= camera
    with pytest.raises(BadTheatreFile, match=rf"stereo_head\.right.*: .*{re.escape(said)}"):
        parse_theatre(content)


@pytest.mark.parametrize("key", ["identifier", "made_by"])
@pytest.mark.parametrize("table", DATED)
def test_a_record_without_a_name_or_an_author_is_refused(
    content: dict[str, Any], table: str, key: str
) -> None:
    _change(content, f"{table}.{key}", lambda _: " ")
    with pytest.raises(BadTheatreFile, match=rf"{table}\.{key}: is empty \(found ' '\)"):
        parse_theatre(content)


@pytest.mark.parametrize("table", ["stereo_head", "tool_tip"])
def test_a_tool_inside_the_hand_that_holds_it_is_refused(content: dict[str, Any], table: str) -> None:
    key = f"calibration.{table}.flange_from_tool.translation_mm"
    _change(content, key, lambda place_mm: [at_mm / 10.0 for at_mm in place_mm])
    said = rf"\[calibration\.{table}\] flange_from_tool.*: the tool is 2\d mm .*millimetres, not centimetres"
    with pytest.raises(BadTheatreFile, match=said):
        parse_theatre(content)


def test_a_guide_that_passes_through_the_hand_is_refused_although_its_tip_is_outside(
    content: dict[str, Any],
) -> None:
    _change(content, "calibration.tool_tip.flange_from_tool.translation_mm", lambda _: [0.0, 0.0, 60.0])
    with pytest.raises(BadTheatreFile, match=r"\[calibration\.tool_tip\].*: the tool is 0 mm"):
        parse_theatre(content)
    del content["tools"]["guide"]
    parse_theatre(content)


@pytest.mark.parametrize("table", DATED)
def test_a_record_of_a_real_theatre_expires_within_a_year(content: dict[str, Any], table: str) -> None:
    _change(content, f"{table}.expires", lambda _: ENDLESS)
    with pytest.raises(BadTheatreFile, match=rf"\[{table}\]: expected to expire at most 366 days after"):
        parse_theatre(content)


def test_a_record_of_a_simulated_theatre_need_not_expire() -> None:
    content = _content(SIMULATED)
    for table in DATED:
        _change(content, f"{table}.expires", lambda _: ENDLESS)
    parse_theatre(content)


@pytest.mark.parametrize("table", DATED)
def test_a_record_that_expires_before_it_was_created_is_refused(content: dict[str, Any], table: str) -> None:
    _change(content, f"{table}.expires", lambda _: datetime(2026, 1, 1, tzinfo=UTC))
    _change(content, f"{table}.created", lambda _: datetime(2026, 1, 2, tzinfo=UTC))
    said = rf"{table}: expires 2026-01-01 00:00 UTC, before it was created, 2026-01-02"
    with pytest.raises(BadTheatreFile, match=said):
        parse_theatre(content)
