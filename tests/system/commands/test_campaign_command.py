"""`ronna-campaign` as a user runs it: files and figures, resuming after an end, refusals in one line."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest
from user_commands import Commands, in_this_process

from studies.campaign.study import Sums, Unit
from studies.cli import app
from studies.registration import RegistrationStudy

STARTED_S = 60.0  # hang guard: the first units of a pool that has to import SciPy on a busy computer
UNITS_BEFORE_THE_KILL = 10


def units_in(folder: Path) -> int:
    """Finished units in the record of a campaign; its first line says which one it is."""
    path = folder / "units.jsonl"
    return max(0, path.read_bytes().count(b"\n") - 1) if path.exists() else 0


def test_a_campaign_writes_tables_and_a_plot_and_recognizes_that_it_is_done(tmp_path: Path) -> None:
    arguments = ("registration", "--runs", "2", "--seed", "3", "--workers", "1", "--out", tmp_path)
    first = in_this_process(app, *arguments, "--json")
    assert first.returncode == 0, first.stderr
    said = json.loads(first.stdout)
    assert Path(said["report"]) == tmp_path / "report.md"
    formulas = said["tables"][0]
    assert [row[0] for row in formulas["rows"]] == [3, 4, 5, 6, 8]
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {
        "report.md",
        "results.json",
        "units.jsonl",
        "target-error.png",
        "fre-and-tre.png",
        "formulas-of-the-rigid-fit.csv",
        "what-weighting-by-covariances-gains.csv",
    }
    again = in_this_process(app, *arguments)
    assert "resuming: 7 of 7 units" in again.stderr
    assert again.stdout.startswith("fiducials\truns\t")


@pytest.mark.slow
def test_the_pairing_of_the_thesis_can_be_chosen_with_its_e_alongside_ours(tmp_path: Path) -> None:
    arguments = ["correspondence", "--runs", "1", "--workers", "1", "--out", tmp_path, "--json"]
    arguments += ["--method", "count", "--method", "thesis-validated", "--e", "2", "--e", "1.5"]
    said = in_this_process(app, *arguments)
    assert said.returncode == 0, said.stderr
    rows = {(row[0], row[1]) for row in json.loads(said.stdout)["tables"][0]["rows"]}
    assert rows == {
        ("clique + planned count", None),
        ("thesis, validated", 1.5),
        ("thesis, validated", 2.0),
    }


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--sweep", "--e", "2"), "--e cannot be combined with --sweep"),
        (("--wrong", "--method", "count"), "--method, --e and --refuse cannot be combined with --xframe"),
    ],
)
def test_a_study_with_methods_or_values_of_its_own_takes_no_others(
    tmp_path: Path, options: tuple[str, ...], said: str
) -> None:
    refused = in_this_process(app, "correspondence", *options, "--out", tmp_path)
    assert refused.returncode == 2
    assert refused.stderr.startswith(f"CLI-001: {said}")


def test_another_study_in_the_folder_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "units.jsonl").write_text('{"study": "correspondence", "fingerprint": "0"}\n')
    refused = in_this_process(app, "registration", "--runs", "2", "--out", tmp_path)
    assert refused.returncode == 2
    assert refused.stdout == ""
    assert refused.stderr.startswith("STU-001: ")
    assert len(refused.stderr.splitlines()) <= 2


def test_an_interrupted_campaign_reports_the_units_it_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, begun = RegistrationStudy.run, []

    def interrupted_in_the_third(study: RegistrationStudy, unit: Unit) -> Sums:
        begun.append(unit)
        if len(begun) == 3:
            raise KeyboardInterrupt
        return run(study, unit)

    monkeypatch.setattr(RegistrationStudy, "run", interrupted_in_the_third)
    ended = in_this_process(app, "registration", "--runs", "2", "--workers", "1", "--out", tmp_path)
    assert ended.returncode == 130
    assert ended.stderr == f"2 units kept in {tmp_path}; the same command continues\ninterrupted\n"


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_low_cost_theatre_positions_its_tool_on_feedback(tmp_path: Path) -> None:
    arguments = ("low-cost", "--arms", "2", "--targets", "12", "--scans", "1", "--coarse", "--workers", "1")
    done = in_this_process(app, *arguments, "--out", tmp_path, "--json")
    assert done.returncode == 0, done.stderr
    relations, positioning, *_ = json.loads(done.stdout)["tables"]
    assert [row[3] for row in relations["rows"]] == ["yes", None, "yes", "yes", "yes", "yes"]
    assert {row[0] for row in positioning["rows"]} == {"0", "1", "all"}
    pictures = {path.name for path in tmp_path.glob("*.png")}
    assert pictures == {"errors.png", "dependence-on-the-arm.png", "rounds.png"}


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_low_cost_theatre_positions_its_tool_with_the_arm_behind_its_driver(tmp_path: Path) -> None:
    arguments = ("low-cost", "--over-the-wire", "--arms", "1", "--targets", "4", "--scans", "1", "--coarse")
    done = in_this_process(app, *arguments, "--workers", "1", "--out", tmp_path, "--json")
    assert done.returncode == 0, done.stderr
    relations, *_ = json.loads(done.stdout)["tables"]
    assert [row[3] for row in relations["rows"]] == ["yes", None, "yes", None, None, "yes"]


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_killed_campaign_resumes_to_the_same_numbers(commands: Commands, tmp_path: Path) -> None:
    def arguments(folder: str, workers: int) -> tuple[str, ...]:
        place = str(tmp_path / folder)
        return ("correspondence", "--runs", "12", "--workers", str(workers), "--out", place, "--json")

    killed = commands.start("ronna-campaign", *arguments("killed", 2))
    deadline = time.monotonic() + STARTED_S
    while units_in(tmp_path / "killed") < UNITS_BEFORE_THE_KILL and time.monotonic() < deadline:
        time.sleep(0.02)
    killed.kill()
    killed.communicate()
    assert commands.await_no_survivors() == []  # its workers end too
    done = units_in(tmp_path / "killed")
    assert UNITS_BEFORE_THE_KILL <= done < 180
    resumed = commands.run("ronna-campaign", *arguments("killed", 2), timeout_s=300.0)
    assert "resuming:" in resumed.stderr
    whole = commands.run("ronna-campaign", *arguments("whole", 1), timeout_s=300.0)
    assert json.loads(resumed.stdout)["tables"] == json.loads(whole.stdout)["tables"]
    assert units_in(tmp_path / "killed") == units_in(tmp_path / "whole") == 180
