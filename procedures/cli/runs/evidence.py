"""`ronna-procedure verify`, `replay` and `bytes`: changed files, recomputed results, link traffic."""

from __future__ import annotations

import heapq
import json
import math
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

from pydantic import ValidationError

from procedures.engine.errors import REPLAY_DIFFERS, NotRecorded
from procedures.engine.order import order_of
from procedures.engine.replay.recorded_answers import CalibrationOpening, RecordedAnswers, read_answers
from procedures.engine.replay.replay import ReplayInput, ReplayVerdict, replay
from procedures.engine.setting import ClinicalInput
from procedures.exchange.raw_readings import WRITES_ALL, missing_in_raw
from procedures.journal.results import parse_record
from procedures.planning.plan_file import read_plan
from procedures.steps.calibration.recipe import Recipe
from procedures.steps.catalogue import clinical_steps
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.strategies.catalogue import find_strategy
from ronna_hw.command_line.errors import PATH_PROBLEM, UsageMistake
from ronna_hw.command_line.terminal import print_json, print_table, progress_bar, say, tell
from ronna_hw.config import Calibrations, read_theatre_file
from ronna_hw.devices.capabilities import Direction
from ronna_hw.errors import EXIT_REFUSED, EXIT_UNCONFIRMED
from ronna_hw.evidence.inspection import Inspection, inspect_run
from ronna_hw.evidence.manifest import iterate_files, list_unchecked
from ronna_hw.evidence.unsealed import describe_unsealed_files
from ronna_hw.mistakes import describe_mistakes
from ronna_hw.near_names import did_you_mean
from ronna_hw.recording.flight_recorder import BYTES_FOLDER, LinkLine, list_links, read_link
from ronna_hw.recording.reading_tape import READINGS_FILE
from ronna_hw.text import format_count, printable

CONFIRMED = (ReplayVerdict.EQUAL, ReplayVerdict.ROUNDED, ReplayVerdict.NO_RESULT)
ROW_BYTES = 16
RESTORE = (
    "put changed and missing files back from a copy of the run, and move added ones out; if only report.html "
    "is named, ronna-procedure report RUN --out DIR makes it anew. Without a copy a stopped run is not "
    "resumed: ronna-procedure home RUN still brings its arm home, unless journal, request or records changed"
)
RESUME = "ronna-procedure show RUN says where it is, and how it goes on; no other file has changed"
MARKS = {Direction.SENT: "O", Direction.RECEIVED: "I"}  # outbound and inbound, as text2pcap has them


def verify(folder: Path, *, as_json: bool) -> None:
    """Print changed, missing and added files, and those that nothing vouches for."""
    found = inspect_run(folder)
    problems, missing = found.problems, missing_in_raw(folder, found.chain.lines)
    not_vouched_for = list(describe_unsealed_files(found.chain.lines))
    unchecked = list_unchecked(folder)
    file_count = sum(1 for _ in iterate_files(folder))
    if as_json:
        whole = {"run": folder.resolve().name, "whole": not problems, "files": file_count}
        doubts = {"problems": [asdict(one) for one in problems], "not_vouched_for": not_vouched_for}
        unknown = {"not_checked": unchecked, "out_of_reach": found.out_of_reach, "raw_missing": missing}
        print_json({**whole, **doubts, **unknown})
    else:
        for problem in problems:
            say(str(problem))
        if not problems:
            intact, since = "intact", ""
            if not_vouched_for:
                intact, since = "intact as far as can be said", ", or as they lay when it was taken up again"
            say(f"{folder.resolve().name}: {intact}, {file_count} files are as the run left them{since}")
        for sentence in not_vouched_for:
            say(sentence)
        if absent := found.out_of_reach:
            inputs = format_count(len(absent), "input")
            say(f"not compared: {inputs} outside the run, whose folder is not there: {printable(absent[0])}")
        if unchecked:
            say(f"not part of the run, and not checked: {', '.join(unchecked)}")
        if missing:
            say(f"{missing}; {WRITES_ALL}")
    if problems:
        if not as_json:
            tell(f"what to do: {RESUME if all(one.unfinished for one in problems) else RESTORE}")
        raise SystemExit(EXIT_REFUSED)
    if not_vouched_for:
        raise SystemExit(EXIT_UNCONFIRMED)


def replay_run(run_folder: Path, *, as_json: bool) -> None:
    """Replay a run and print a verdict for each record, and for each step that failed.

    Raises PRO-024, and PRO-025 for records that are not confirmed.
    """
    # For edited readings a replay tells more: which results they change.
    run = inspect_run(run_folder, every_file=False).require_unchanged()
    answers = read_answers(run_folder)
    replay_input = _default_to_recorded_set_up(run, _replay_input(run_folder, answers))
    with progress_bar(f"recomputing {len(run.records)} results") as show:
        results = replay(run, replay_input, answers, lambda done, of: show(done / of))
    counts = Counter(result.verdict for result in results)
    methods = answers.opening.methods.describe()
    if as_json:
        totals = {str(verdict).replace(" ", "_"): counts[verdict] for verdict in ReplayVerdict}
        records = [asdict(result) for result in results]
        print_json({"run": run_folder.name, "methods": methods, **totals, "records": records})
    else:
        rows = [(one.record or one.step, one.verdict, "; ".join(one.why)) for one in results]
        if methods:
            say(methods)
        print_table("Recomputed results", ("record", "verdict", "why"), rows)
    unconfirmed = [one.record for one in results if one.verdict not in CONFIRMED]
    if unconfirmed:
        raise REPLAY_DIFFERS(
            f"{len(unconfirmed)} of {len(run.records)} records are not confirmed: {', '.join(unconfirmed)}"
        )


def _replay_input(run_folder: Path, answers: RecordedAnswers) -> ReplayInput:
    opening = answers.opening

    def resolve_path(path: str | None) -> Path:
        if path is None:
            raise NotRecorded(f"the first line of {READINGS_FILE} does not say what the run was begun with")
        return run_folder / path  # an absolute path stays what it is

    if opening.series is None:
        return _calibration_input(opening.calibration, resolve_path(opening.theatre_file))
    plan = resolve_path(opening.plan)
    planned, strategy = read_plan(plan), find_strategy(opening.strategy or "")
    order = order_of(
        clinical_steps(
            measure_targets=opening.measure_targets,
            intraoperative=opening.intraoperative,
            roles=opening.roles,
            fiducials=planned.fiducials,
            start=opening.methods.start,
        ),
        [trajectory.id for trajectory in planned.trajectories],
        localizes_per_trajectory=strategy.localizes_per_trajectory,
    )
    clinical = ClinicalInput(
        resolve_path(opening.series),
        plan,
        strategy,
        opening.measure_targets,
        methods=opening.methods,
        roles=opening.roles,
        intraoperative=opening.intraoperative,
    )
    return ReplayInput(order, clinical, read_theatre_file(resolve_path(opening.theatre_file)))


def _default_to_recorded_set_up(run: Inspection, replay_input: ReplayInput) -> ReplayInput:
    recorded = next((record for record in run.records if record.kind == CheckedSetUp.kind), None)
    if recorded is None:
        return replay_input
    found = parse_record(recorded, CheckedSetUp)
    tables = {"calibration": found.calibrations, "tools": found.tools, "flange": found.flange}
    tables |= {"cell": found.cell, "procedure": found.settings}
    return replace(replay_input, theatre=replay_input.theatre.model_copy(update=tables))


def _calibration_input(calibration: CalibrationOpening | None, theatre_file: Path) -> ReplayInput:
    if calibration is None:
        raise NotRecorded(
            "the run is a check or a single measurement of a calibration, which cannot be replayed"
        )
    recipe = Recipe.read(calibration.recipe)
    try:
        records = Calibrations.model_validate_json(json.dumps(calibration.records))
    except ValidationError as error:
        raise NotRecorded(f"the calibration records: {'; '.join(describe_mistakes(error))}") from error
    theatre = read_theatre_file(theatre_file)
    return ReplayInput(order_of(recipe.steps, ()), None, theatre, records, recipe.starts)


def print_bytes(
    run_folder: Path, link: str | None, from_s: float | None, to_s: float | None, *, as_json: bool
) -> None:
    """List files changed since the run, then print link traffic within a time window.

    Raises CLI-005 without bytes, CLI-001 for a wrong link or window.
    """
    folder = run_folder / BYTES_FOLDER
    links = list_links(folder)
    if not links:
        raise PATH_PROBLEM(f"{folder} has no recorded link bytes", expected="the folder of a run")
    wanted = [name for name in links if link is None or name == link or name.startswith(f"{link}.")]
    if not wanted:
        raise UsageMistake(
            f"--link: the run has no link {link}",
            expected=f"one of {', '.join(links)}",
            action=did_you_mean(link or "", links) or "Name one of them, or omit --link for all.",
        )
    begin_s, end_s = from_s if from_s is not None else -math.inf, to_s if to_s is not None else math.inf
    if begin_s > end_s:
        raise UsageMistake(
            "the window ends before it begins",
            expected="--to after --from",
            got=f"--from {begin_s:g} --to {end_s:g}",
            action="Exchange the two times, s of theatre time.",
        )
    for change in inspect_run(run_folder).changes:
        tell(f"NOT AS THE RUN LEFT IT: {change}")
    merged = heapq.merge(*(read_link(folder, name) for name in wanted), key=lambda line: line.host_time)
    first_s, last_s, printed = math.inf, -math.inf, False
    for line in merged:
        first_s, last_s = min(first_s, line.theatre_time_s), max(last_s, line.theatre_time_s)
        if begin_s <= line.theatre_time_s <= end_s:
            printed = True
            sys.stdout.write(_as_json(line) if as_json else _as_dump(line))
    if not printed:
        extent = f"{first_s:.1f} to {last_s:.1f} s" if first_s <= last_s else "nothing"
        tell(f"no bytes in this window; {', '.join(wanted)} recorded {extent}")


def _as_json(line: LinkLine) -> str:
    content: dict[str, object] = {
        "link": line.link,
        "host_time": line.host_time.isoformat(timespec="microseconds"),
        "theatre_time_s": line.theatre_time_s,
    }
    if line.direction is None:
        content["note"] = line.note
    else:
        text = "".join(_printable(line.data))
        content |= {"direction": line.direction, "hex": line.data.hex(), "text": text}
    return json.dumps(content) + "\n"


def _as_dump(line: LinkLine) -> str:
    """Format traffic as text2pcap input: comments start with #, directions are I and O.

    The text after the bytes is for people.
    """
    head = f"# {printable(line.link)}, theatre {line.theatre_time_s:.6f} s"
    if line.direction is None:
        return f"{head}: {printable(', '.join(f'{name} {value}' for name, value in line.note.items()))}\n"
    rows = "".join(_rows(line.data))
    moment = f"{line.host_time:%Y-%m-%dT%H:%M:%S.%fZ}"
    size = f"{line.direction}, {len(line.data)} bytes"
    return f"{head}, {size}\n{MARKS[line.direction]} {moment}\n{rows}\n"


def _rows(data: bytes) -> Iterator[str]:
    for at in range(0, len(data), ROW_BYTES):
        row = data[at : at + ROW_BYTES]
        yield f"{at:06x} {row.hex(' '):<{3 * ROW_BYTES}}  {''.join(_printable(row))}\n"


def _printable(data: bytes) -> Iterator[str]:
    return (chr(byte) if 0x20 <= byte < 0x7F else "." for byte in data)
