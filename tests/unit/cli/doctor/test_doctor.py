"""The doctor shows what the drivers' probes find; its exit code depends on the devices, not the computer."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import nullcontext
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from procedures.cli.doctor import report as doctor
from procedures.cli.doctor.calibrations import calibration_diagnostics
from procedures.cli.doctor.report import RECORDS_OF_OTHERS, Report, Verdict, examine, show, verdicts
from procedures.cli.doctor.theatre_checks import assistant_diagnostics
from procedures.runs.request_checks import require_two_arms
from ronna_hw.calibration import DatedRecord
from ronna_hw.config import Calibrations, DeviceConfig, TheatreFile, parse_theatre
from ronna_hw.devices.errors import NotInTheatre
from ronna_hw.devices.probing import Diagnostic, Inspection, Progress
from ronna_hw.endpoints import BadEndpoint, Endpoint
from ronna_hw.errors import EXIT_NOT_FOUND, EXIT_REFUSED, ConnectError

WELL = Diagnostic("line tcp://127.0.0.1:1", True, "answered", section="lines", document={"baud": 9600})
UNWELL = Diagnostic("device tracker", False, "silent", "Switch it on.")


class LineProbe:
    """A probe of two kinds of endpoints."""

    endpoint_schemes = frozenset({"tcp", "serial"})

    def __call__(
        self, name: str, config: DeviceConfig, progress: Progress, inspect: Inspection
    ) -> Sequence[Diagnostic]:
        progress(0.5)
        return (WELL, Diagnostic(f"device {name}", True, config.driver))

    def probe_endpoints(self, endpoints: Sequence[Endpoint], progress: Progress) -> Sequence[Diagnostic]:
        return [Diagnostic(f"line {endpoint}", True, "answered") for endpoint in endpoints]


class PortProbe(LineProbe):
    """A probe of a device with fixed ports."""

    endpoint_schemes = frozenset({"tcp"})
    endpoint_ports = frozenset({29999})

    def probe_endpoints(self, endpoints: Sequence[Endpoint], progress: Progress) -> Sequence[Diagnostic]:
        return [Diagnostic(f"dashboard {endpoint}", True, "answered") for endpoint in endpoints]


def failing(name: str, config: DeviceConfig, progress: Progress, inspect: Inspection) -> Sequence[Diagnostic]:
    raise ConnectError("no such bus", action="Plug it in.")


def faulty(name: str, config: DeviceConfig, progress: Progress, inspect: Inspection) -> Sequence[Diagnostic]:
    raise ValueError("not a bus number")


@pytest.fixture(autouse=True)
def _probes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "endpoint_probes", lambda: {"lines": LineProbe()})
    probes = {"broken": failing, "faulty": faulty}
    monkeypatch.setattr(doctor, "load_probe", lambda driver: probes.get(driver, LineProbe()))


@pytest.fixture
def theatre(tmp_path: Path) -> Path:
    path = tmp_path / "theatre.toml"
    path.write_text(
        'schema = 1\ntheatre = "lab"\n'
        '[tracker]\ndriver = "broken"\nendpoint = "tcp://127.0.0.1:1"\n'
        '[device.force]\ndriver = "lines"\nendpoint = "tcp://127.0.0.1:2"\n'
    )
    return path


def test_every_device_of_a_theatre_file_is_probed_even_after_a_failed_probe(theatre: Path) -> None:
    shares: list[float] = []
    report = examine(theatre, (), shares.append)
    assert [diagnostic.subject for diagnostic in report.devices] == [
        "device tracker", "line tcp://127.0.0.1:1", "device device.force"
    ]  # fmt: skip
    assert not report.devices[0].well
    assert report.devices[0].advice == "Plug it in."
    assert shares == [0.5, 0.75, 1.0]


def test_a_probe_with_a_fault_of_its_own_is_a_problem_of_its_device_only(theatre: Path) -> None:
    theatre.write_text(theatre.read_text().replace('"broken"', '"faulty"'))
    first, *others = examine(theatre).devices
    assert (first.subject, first.well) == ("device tracker", False)
    assert "ValueError: not a bus number" in first.seen
    assert [each.subject for each in others] == ["line tcp://127.0.0.1:1", "device device.force"]


def test_an_endpoint_with_the_fixed_port_of_a_device_is_checked_by_its_probe_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(doctor, "endpoint_probes", lambda: {"lines": LineProbe(), "arm": PortProbe()})
    report = examine(None, ("tcp://127.0.0.1:29999", "tcp://127.0.0.1:1"))
    assert [one.subject for one in report.devices] == [
        "dashboard tcp://127.0.0.1:29999", "line tcp://127.0.0.1:1"
    ]  # fmt: skip


def test_a_clock_that_ended_with_its_theatre_is_a_problem_in_the_json_output_too(tmp_path: Path) -> None:
    gone = f'theatre = "lab"\nbanner = "SIMULATED"\n[clock]\nendpoint = "shm://{tmp_path}/clock"\n'
    (tmp_path / "theatre.toml").write_text(gone)
    report = examine(tmp_path / "theatre.toml")
    assert "CLK-001" in next(one for one in report.case if not one.well).seen
    with pytest.raises(SystemExit) as ended:
        show(report, as_json=True)
    assert ended.value.code == EXIT_NOT_FOUND


def test_a_theatre_without_devices_is_a_problem_and_the_advice_names_the_sections_to_declare(
    tmp_path: Path,
) -> None:
    (tmp_path / "theatre.toml").write_text('theatre = "lab"\n')
    report = examine(tmp_path / "theatre.toml")
    (diagnostic,) = (one for one in report.case if one.subject == "devices of a case")
    assert not diagnostic.well
    assert "[robot.master]" in diagnostic.advice
    (verdict,) = report.verdicts
    assert (verdict.of, verdict.ready) == ("case", False)
    assert "devices of a case: without tracker, robot.master, stereo" in verdict.because


def test_the_disk_check_names_the_folder_that_it_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "theatre.toml").write_text('theatre = "lab"\n')
    (elsewhere := tmp_path / "elsewhere").mkdir()
    for out, judged in ((Path("runs"), tmp_path), (elsewhere / "runs", elsewhere)):
        found = examine(Path("theatre.toml"), out=out).case
        (disk,) = (one for one in found if one.subject == "disk")
        assert disk.seen.startswith(f"{judged}: ")


@pytest.mark.parametrize(
    ("days", "well", "said", "advised"),
    [
        (9, True, "head-1, valid until", False),
        (1, True, "head-1, valid until", True),
        (-1, False, "CAL-001 calibration head-1 expired", True),
    ],
)
def test_each_calibration_record_shows_how_long_it_is_valid(
    days: int, well: bool, said: str, advised: bool
) -> None:
    now = datetime.now(UTC)
    record = DatedRecord(
        identifier="head-1",
        created=now - timedelta(days=9),
        expires=now + timedelta(days=days),
        made_by="bench",
        stated_error_mm=0.1,
    )
    records = SimpleNamespace(records=dict.fromkeys(("stereo_head", "tool_tip", "tracker_frame"), record))
    theatre = cast("Any", SimpleNamespace(calibration=records, tools={"guide": record}))
    again = "--config 'my lab/theatre.toml' --update"
    found = list(calibration_diagnostics(theatre, Path("my lab/theatre.toml"), now))
    assert [one.subject.split()[-1] for one in found] == ["stereo_head", "tracker_frame", "tool_tip"]
    assert ["ronna-tool renew" in one.advice for one in found] == [False, False, advised]
    for diagnostic in found:
        assert diagnostic.well is well
        assert (again in diagnostic.command) is advised
        assert said in diagnostic.seen


def test_an_expired_record_that_no_command_makes_comes_with_words_in_place_of_a_command() -> None:
    now = datetime.now(UTC)
    record = DatedRecord(
        identifier="of the assistant",
        created=now - timedelta(days=9),
        expires=now - timedelta(days=1),
        made_by="bench",
        stated_error_mm=0.1,
    )
    records = SimpleNamespace(records=dict.fromkeys(("assistant_arm", "assistant_holder"), record))
    theatre = cast("Any", SimpleNamespace(calibration=records, tools={}))
    for one in calibration_diagnostics(theatre, Path("theatre.toml"), now):
        assert (one.well, one.command) == (False, "")
        assert f"[{one.subject.replace(' ', '.')}]" in one.advice


def with_arms(*roles: str) -> TheatreFile:
    arms = {role: {"driver": "lines", "endpoint": f"tcp://127.0.0.1:{n}"} for n, role in enumerate(roles, 1)}
    return parse_theatre({"theatre": "lab", "robot": arms})


def test_an_assistant_lacks_what_a_run_with_two_arms_would_refuse() -> None:
    (found,) = assistant_diagnostics(with_arms("master", "assistant"))
    assert not found.well
    assert "DEV-007" in found.seen
    assert "calibration.assistant_holder" in found.seen


def test_an_arm_in_a_role_that_no_procedure_has_is_named_with_the_role_that_was_meant() -> None:
    theatre = with_arms("master", "asistant")
    (found,) = assistant_diagnostics(theatre)
    assert found.well
    assert "did you mean 'assistant'?" in found.advice
    with pytest.raises(NotInTheatre, match=r"Write \[robot\.assistant\] in place of \[robot\.asistant\]"):
        require_two_arms(theatre)


@pytest.mark.hazard(66)
@pytest.mark.parametrize(
    ("roles", "error_N", "said"),
    [(("master",), 1.0, "no [robot.assistant]"), (("master", "assistant"), 1.5, "above 1 N")],
)
def test_an_assistant_that_is_to_drill_and_cannot_is_told(
    roles: tuple[str, ...], error_N: float, said: str
) -> None:
    theatre = with_arms(*roles)
    settings = theatre.procedure.model_copy(update={"assistant_drills": True})
    arms = {
        role: arm.model_copy(update={"options": {"force_error_N": error_N}})
        for role, arm in theatre.robot.items()
    }
    *_, found = assistant_diagnostics(theatre.model_copy(update={"procedure": settings, "robot": arms}))
    assert not found.well
    assert said in found.seen


def test_the_records_of_an_assistant_whose_table_is_misspelt_are_a_problem() -> None:
    theatre = with_arms("master", "asistant")
    records = SimpleNamespace(records={"assistant_arm": object()})
    found, _ = assistant_diagnostics(theatre.model_copy(update={"calibration": records}))
    assert not found.well
    assert "[robot.asistant] is unknown (did you mean 'assistant'?)" in found.seen


def test_an_assistant_that_is_not_ready_leaves_only_a_case_with_one_arm() -> None:
    lost = Diagnostic("device robot.assistant", False, "silent")
    *_, alone, both = verdicts((), {"robot.master": (WELL,), "robot.assistant": (lost,)})
    assert (alone.of, alone.ready) == ("case", True)
    assert (both.of, both.ready, both.because) == (
        "case with two arms", False, ("device robot.assistant: silent",)
    )  # fmt: skip


def test_records_of_the_assistant_are_a_problem_of_a_case_with_two_arms_only() -> None:
    assert {f"calibration {name}" for name in Calibrations.model_fields if "assistant" in name} == {
        *RECORDS_OF_OTHERS
    }
    expired = Diagnostic(RECORDS_OF_OTHERS[0], False, "expired")
    *_, alone, both = verdicts((), {"robot.master": (WELL,), "robot.assistant": (WELL,)}, (expired,))
    assert alone.ready
    assert not both.ready


def test_missing_calibrations_are_a_problem_only_where_a_case_could_run(theatre: Path) -> None:
    (alone,) = examine(theatre).calibrations
    assert alone.well
    arm = '[robot.master]\ndriver = "lines"\nendpoint = "tcp://127.0.0.1:3"\n'
    theatre.write_text(theatre.read_text() + arm + arm.replace("robot.master", "stereo"))
    (whole,) = examine(theatre).calibrations
    assert "[calibration]" in whole.advice


def test_bare_endpoints_are_examined_by_the_probe_of_their_scheme() -> None:
    report = examine(None, ["tcp://127.0.0.1:1", "serial:///dev/ttyUSB0"])
    assert [each.subject for each in report.devices] == [
        "line tcp://127.0.0.1:1", "line serial:///dev/ttyUSB0"
    ]  # fmt: skip


def test_an_endpoint_that_no_probe_supports_is_refused() -> None:
    with pytest.raises(BadEndpoint, match="serial: or tcp:"):
        examine(None, ["udp://127.0.0.1:59152"])


def test_an_endpoint_that_two_probes_support_needs_a_theatre_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "endpoint_probes", lambda: {"lines": LineProbe(), "scales": LineProbe()})
    with pytest.raises(BadEndpoint, match="lines and scales"):
        examine(None, ["tcp://127.0.0.1:1"])


def test_a_computer_without_devices_is_healthy(capsys: pytest.CaptureFixture[str]) -> None:
    report = examine(None)
    assert report.devices == ()
    assert {"Python", "packages", "real-time priority"} <= {each.subject for each in report.computer}
    show(report, as_json=False)
    folded = capsys.readouterr().out
    assert "No problem found." in folded
    assert "none foreign" not in folded
    show(report, as_json=False, everything=True)
    assert "packages\tok\tnone foreign" in capsys.readouterr().out


def test_the_json_has_findings_and_the_documents_of_each_section(capsys: pytest.CaptureFixture[str]) -> None:
    show(Report((), (WELL,)), as_json=True)
    assert json.loads(capsys.readouterr().out) == {
        "findings": [
            {
                "subject": "line tcp://127.0.0.1:1",
                "well": True,
                "seen": "answered",
                "advice": "",
                "command": "",
            }
        ],
        "lines": [{"baud": 9600}],
        "cameras": [],
        "verdicts": [],
    }


@pytest.mark.parametrize(
    ("report", "code", "printed"),
    [
        (Report((), (WELL, UNWELL)), EXIT_NOT_FOUND, "1. device tracker: silent\n   Switch it on.\n"),
        (
            Report((), (WELL, UNWELL), verdicts=(Verdict("case", False, ("device tracker: silent",)),)),
            EXIT_NOT_FOUND,
            "case\tNOT READY\tdevice tracker\n",  # the finding stands above
        ),
        (
            Report((Diagnostic("packages", False, "foreign: sim"),), (WELL,)),
            0,
            "No problem found.\n\nWorth knowing:\n-  packages: foreign: sim",
        ),
        (
            Report((), (WELL,), verdicts=(Verdict("case", False, ("devices of a case: without stereo",)),)),
            EXIT_REFUSED,
            "case\tNOT READY",
        ),
        (
            Report((), (), (Diagnostic("calibration tool_tip", False, "expired"),)),
            EXIT_NOT_FOUND,
            "1 problem:\n1. calibration tool_tip: expired",
        ),
    ],
    ids=["device", "case by a device", "computer", "case", "calibration"],
)
def test_a_problem_of_device_case_or_calibration_but_not_of_the_computer_gives_an_exit_code(
    capsys: pytest.CaptureFixture[str], report: Report, code: int, printed: str
) -> None:
    for as_json in (True, False):
        with pytest.raises(SystemExit) if code else nullcontext() as ended:
            show(report, as_json=as_json)
        assert (ended.value.code if ended else 0) == code
    assert printed in capsys.readouterr().out


def test_problems_come_first_with_a_command_and_what_is_fine_is_folded_unless_asked_for(
    capsys: pytest.CaptureFixture[str],
) -> None:
    doubled = Diagnostic("cameras on lo", True, "two", "There is another cell on this network.")
    expired = Diagnostic("calibration tool_tip", False, "expired", "Calibrate again.", command="calibrate it")
    fine = Diagnostic("disk", True, "enough")
    report = Report((), (WELL, doubled), (expired,), (fine,), (Verdict("case", False, ("expired",)),))
    for everything in (False, True):
        with pytest.raises(SystemExit):
            show(report, as_json=False, everything=everything)
        said = capsys.readouterr().out
        assert said.startswith(
            "1 problem:\n1. calibration tool_tip: expired\n   Calibrate again.\n   calibrate it\n"
            "\nWorth knowing:\n-  cameras on lo: two\n"
        )
        assert ("disk\tok\tenough" in said) is everything
        assert ("2 checks without a finding" in said) is not everything
        assert ("cameras on lo\tnote" in said) is everything  # not "ok" beside another cell
        assert said.endswith("case\tNOT READY\t\n")


def test_a_line_that_was_asked_for_is_shown_even_if_it_is_well(capsys: pytest.CaptureFixture[str]) -> None:
    show(examine(None, ["tcp://127.0.0.1:1"]), as_json=False)
    assert "\nok line tcp://127.0.0.1:1: answered\n" in capsys.readouterr().out


def test_a_problem_that_no_command_solves_names_the_one_that_checks_it_again(theatre: Path) -> None:
    found = {one.subject: one.command for one in examine(theatre).diagnostics if not one.well}
    assert found["device tracker"] == f"ronna-procedure doctor --config {theatre}"
