"""Theatre files: addresses, settings, records and the cell; all mistakes are explained where they are."""

import re
import tomllib
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

import pytest
import tomli_w

from ronna_hw.calibration import Dated
from ronna_hw.collision_config import AROUND_THE_PATIENT, BodyFrame, CollisionConfig
from ronna_hw.config import (
    BadTheatreFile,
    DeviceConfig,
    ProcedureSettings,
    WatchPatient,
    parse_theatre,
    read_theatre_file,
)
from ronna_hw.endpoints import BadEndpoint, parse_endpoint
from ronna_hw.registry import list_driver_names


def test_a_small_theatre_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "theatre.toml"
    path.write_text(
        'schema = 1\ntheatre = "lab"\n[tracker]\ndriver = "ndi_polaris"\nendpoint = "serial:///dev/ttyUSB0"\n'
        '[robot.master]\ndriver = "kuka_rsi"\n[robot.master.endpoints]\nrsi = "udp://192.168.1.5:59152"\n'
    )
    theatre = read_theatre_file(path)
    assert theatre.robot["master"].address("rsi").port == 59152
    assert theatre.clock.endpoint == "host:"


@pytest.mark.parametrize("watched", list(WatchPatient))
def test_procedure_settings_survive_a_round_trip_through_the_theatre_file(
    tmp_path: Path, watched: WatchPatient
) -> None:
    settings = ProcedureSettings(watch_patient=watched, stand_mm=(500.0, 0.0, 300.0))
    path = tmp_path / "theatre.toml"
    tables = {"schema": 1, "theatre": "lab", "procedure": settings.model_dump(mode="json", exclude_none=True)}
    path.write_text(tomli_w.dumps(tables))
    assert read_theatre_file(path).procedure == settings


@pytest.mark.parametrize(
    ("one", "another"),
    [
        ("tcp://192.168.1.2:54602", "tcp://192.168.1.2:54602"),
        ("tcp://127.0.0.1:54602", "tcp://localhost:54602"),
    ],
)
def test_both_roles_on_one_arm_are_refused(one: str, another: str) -> None:
    def arm(rsi: str, eki: str) -> dict[str, Any]:
        return {"driver": "kuka_rsi", "endpoints": {"rsi": rsi, "eki_project": eki}}

    master = arm("udp://192.168.1.5:59152", one)
    theatre = {"schema": 1, "theatre": "lab", "robot": {"master": master}}
    other = arm("udp://192.168.1.5:59153", "tcp://192.168.1.3:54602")
    theatre["robot"]["assistant"] = other
    assert list(parse_theatre(theatre, "theatre.toml").robot) == ["master", "assistant"]
    other["endpoints"]["eki_project"] = another
    with pytest.raises(BadTheatreFile, match=r"robot.assistant. and .robot.master. are the same arm"):
        parse_theatre(theatre, "theatre.toml")


ARM: dict[str, Any] = {"driver": "kuka_rsi", "endpoints": {"rsi": "udp://192.168.1.5:59152"}}


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ({"robot": ARM}, r"\[robot\] has driver, endpoints, .* write \[robot\.master\]"),
        (
            {"robot": {"master": ARM}, "assistant": ARM},
            r"\[assistant\] is an arm: write \[robot\.assistant\]",
        ),
    ],
)
def test_an_arm_outside_its_table_is_named_with_the_table_to_write(tables: dict[str, Any], said: str) -> None:
    with pytest.raises(BadTheatreFile, match=said):
        parse_theatre({"schema": 1, "theatre": "lab", **tables}, "theatre.toml")


def test_a_plan_given_as_a_theatre_file_is_recognised() -> None:
    with pytest.raises(BadTheatreFile, match=r"plan\.toml is a plan, not a theatre file"):
        parse_theatre({"schema": 1, "trajectories": [], "implanted": 3}, "plan.toml")


RECORD: dict[str, Any] = {
    "identifier": "tip",
    "made_by": "lab",
    "stated_error_mm": 0.05,
    "tool_number": 2,
    "created": datetime(2026, 11, 1, tzinfo=UTC),
    "expires": datetime(2026, 12, 1, tzinfo=UTC),
}
POSE: dict[str, Any] = {"translation_mm": [0.0, 0.0, 300.0], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]}


def _tip(pose: dict[str, Any] = POSE, **changes: object) -> dict[str, Any]:
    return {"calibration": {"tool_tip": {**RECORD, "flange_from_tool": {**POSE, **pose}, **changes}}}


NOT_A_TABLE = {"driver": "kuka_rsi", "endpoint": {"rsi": "udp://127.0.0.1:1"}}


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (_tip({"translation_mm": [0.0, 0.0, 0.3]}), "length 0.3: give millimetres, not metres"),
        (_tip({"quaternion_wxyz": [0.0, 90.0, 0.0, 0.0]}), "not 1: give a rotation, not angles"),
        (_tip(expires=datetime.fromisoformat("2026-12-01")), "expected day, time and time zone, as 2026"),
        (_tip(expires=date(2026, 12, 21)), "time zone, as 2026-12-21T12:00:00Z (found 2026-12-21)"),
        (_tip(created="26.11.2026"), "time zone, as 2026-12-21T12:00:00Z, without quotes in TOML"),
        ({"procedure": {"stand_mm": [0.56, 0.1, 0.3]}}, "stand_mm: has length 0.643: give millimetres"),
        (
            {"robot": {"master": NOT_A_TABLE}},
            "robot.master.endpoint: expected one address, got a table: did you mean 'endpoints'?",
        ),
    ],
)
def test_a_value_in_the_wrong_unit_form_or_place_is_explained(content: dict[str, Any], said: str) -> None:
    with pytest.raises(BadTheatreFile, match=re.escape(said)):
        parse_theatre({"theatre": "lab", **content})


def test_a_dated_record_survives_a_round_trip_through_json() -> None:
    made = datetime(2026, 11, 21, 12, tzinfo=UTC)
    dated = Dated(identifier="one", created=made, expires=made.replace(month=12), made_by="a test")
    assert Dated.model_validate_json(dated.model_dump_json()) == dated


def test_the_three_drivers_are_installed() -> None:
    assert {"ndi_polaris", "kuka_rsi", "basler_stereo"} <= set(list_driver_names())


def test_relative_paths_of_a_device_are_resolved_from_its_theatre_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = tmp_path / "lab"
    lab.mkdir()
    (lab / "theatre.toml").write_text(
        'schema = 1\ntheatre = "lab"\n[tracker]\ndriver = "ndi_polaris"\nendpoint = "tcp://127.0.0.1:8765"\n'
    )
    monkeypatch.chdir(tmp_path)
    tracker = read_theatre_file(Path("lab/theatre.toml")).tracker
    assert tracker is not None
    assert tracker.folder == lab
    assert tracker.model_copy(update={"endpoint": "tcp://127.0.0.1:1"}).folder == lab
    assert DeviceConfig(driver="ndi_polaris", endpoint="host:").folder is None


@pytest.mark.parametrize(
    "text",
    [
        "udp://127.0.0.1:59152",
        "tcp://[::1]:8765",
        "serial:///dev/ttyUSB0",
        "gev://192.168.3.10",
        "shm:///proc/1/fd/5",
        "host:",
    ],
)
def test_an_endpoint_survives_a_round_trip_through_text(text: str) -> None:
    assert str(parse_endpoint(text)) == text


@pytest.mark.parametrize(
    "text",
    ["", "8765", "tcp://127.0.0.1", "tcp://127.0.0.1:99999", "http://a:1", "serial://dev/x", "udp://:5"],
)
def test_invalid_endpoint_text_is_refused_and_quoted(text: str) -> None:
    with pytest.raises(BadEndpoint) as refused:
        parse_endpoint(text)
    assert repr(text) in str(refused.value)


def test_an_endpoint_of_the_wrong_kind_is_refused_with_the_supported_kinds() -> None:
    with pytest.raises(BadEndpoint, match="serial: or tcp:"):
        parse_endpoint("udp://127.0.0.1:1").require("serial", "tcp")


HOW_TO = Path(__file__).resolve().parents[3] / "docs" / "how-to" / "devices" / "describe-the-cell.md"
BODY = {"name": "stand", "start_mm": [0.0, 0.0, 0.0], "end_mm": [0.0, 0.0, 9.0], "radius_mm": 5.0}


def _cell(**keys: Any) -> CollisionConfig:
    return parse_theatre({"theatre": "lab", "cell": keys}).cell


def test_the_defaults_apply_without_a_cell() -> None:
    cell = parse_theatre({"theatre": "lab"}).cell
    assert cell == CollisionConfig()
    assert cell.bodies == AROUND_THE_PATIENT
    assert cell.live_margin_mm < cell.margin_mm
    assert not any(body.enters_head for body in (*cell.guide, *cell.stereo_head))  # hands bring in what does


def test_the_example_in_the_how_to_is_a_valid_cell() -> None:
    example = re.search(r"```toml\n(.*?)```", HOW_TO.read_text(encoding="utf-8"), re.DOTALL)
    assert example is not None
    cell = parse_theatre({"theatre": "lab", **tomllib.loads(example[1])}).cell
    assert cell.bodies[0].frame is BodyFrame.ROBOT
    assert cell.guide[0].name == "tube of the guide"


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"margin_mm": 3.0}, "live_margin_mm must be less than margin_mm"),
        ({"zone": {"near_mm": 500.0}}, "far_mm must exceed near_mm"),
        ({"bodies": [{**BODY, "radius_mm": 0.0}]}, "cell.bodies 1.radius_mm"),
        ({"bodies": [{**BODY, "radius_mm": 0.03}]}, "radius_mm: give millimetres, not metres (found 0.03)"),
        ({"bodies": [{**BODY, "frame": "table"}]}, "'head' or 'robot'"),
        ({"bodies": [{**BODY, "colour": "red"}]}, "cell.bodies 1.colour"),
        ({"guide": [{**BODY, "end_mm": [0.0, 0.0]}]}, "cell.guide 1.end_mm"),
    ],
)
def test_a_mistake_is_reported_with_its_location(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(BadTheatreFile, match=re.escape(said)):
        _cell(**keys)
