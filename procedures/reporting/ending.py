"""How a run ended, according to its journal, its seal, and the sealed truth of a simulated theatre.

Everything that tells an ending asks here, so that all say the same.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from procedures.engine.run_folder import targets_in_doubt
from procedures.journal.journal import ENDS_OF_A_STEP, ONLY_LEAVING, Entry, Line
from procedures.operator.checkpoint import PAUSED
from procedures.operator.margin import MarginVerdict
from procedures.reporting.outcome import RunError, Truth
from procedures.reporting.run_events import last_held_name
from procedures.reporting.run_reading import RunReading
from procedures.reporting.tables import target_rows
from procedures.steps.clinical.at_target import ReachedTarget
from ronna_hw.devices.capabilities import EMERGENCY_STOP
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.evidence.manifest import KEPT_TRUTH, REQUEST_FILE, TRUTH_FIELD
from ronna_hw.host.port_users import find_folder_holder
from ronna_hw.text import format_count

ARM = "arm"  # role of the device that an emergency stop stops
RESUME = "ronna-procedure resume RUN goes on from there; ronna-procedure home RUN only goes home."
GO_ON = f"Put right what is named, then {RESUME}"
UNKNOWN_ERROR, UNSEALED = "error not determined", "not sealed"
RUNNING, CLOSING = "running", "closing"  # in a program that has the run open
SEALED_WITHIN_S, AGAIN_S = 30.0, 0.2  # host time; a report and a seal take a second or two
DONE = ("done", "in doubt")  # by the journal: every step was done
ERROR_LOST = f"The error at its targets is not known: {KEPT_TRUTH} is not there as it was sealed."
NOT_SEALED = (
    "No seal confirms the end of the run: the program was killed before, or the seal is lost or changed."
)
ADVICE = {  # by the word of an ending, for a case
    "missed": (
        "Do not work at a target that is beyond. Look in the report at what the prediction is made of and at "
        "what stayed as it was, then register anew in a new run."
    ),
    "in doubt": (
        "Do not rely on these targets until an image confirms them: ronna-ct postoperative compares one "
        "taken after the operation with the plan."
    ),
    UNKNOWN_ERROR: (
        "Do not rely on these targets: whether one was missed is not known. ronna-procedure verify RUN names "
        "what is lost."
    ),
    UNSEALED: "ronna-procedure verify RUN names what is missing; ronna-procedure resume RUN completes it.",
    RUNNING: "ronna-procedure watch RUN follows it from another terminal.",
    "killed": f"Unless a program on another computer still runs it: {RESUME}",
    "not begun": "Nothing has moved. Put right what is named, then start again.",
    **dict.fromkeys(("failed", "refused", "aborted"), GO_ON),
    **dict.fromkeys(("interrupted", "left"), RESUME),
}
STOPPED = ("killed", "failed", "refused", "aborted", "interrupted", "left")  # before every step was done
NEXT = {  # by the word of an ending: the one command to type next
    UNSEALED: "resume",
    UNKNOWN_ERROR: "verify",
    RUNNING: "watch",
    **dict.fromkeys(STOPPED, "resume"),
}
BY_PERSON = ("interrupted", "aborted", "left")
ENDS_A_STEP = (*ENDS_OF_A_STEP, Entry.REFUSED)


@dataclass(frozen=True)
class Ending:
    """Ending of a run.

    `word` is done, in doubt, missed, error not determined, not sealed, failed, refused, aborted, interrupted,
    left, killed or not begun; while another program holds the run, running for killed, and closing for a run
    whose steps are all done.
    """

    word: str
    sentence: str
    code: str = ""
    instrument_in: str | None = None  # the trajectory it was still in
    instrument_held_for: str | None = None  # the trajectory, if it was still in the assistant's holder
    held_name: str = "instrument"  # or a drill
    is_open: bool = False  # in another program, which goes on with it or has yet to seal it

    @property
    def is_done(self) -> bool:
        """Whether the run is done, without anything in doubt."""
        return self.word == "done"

    @property
    def account(self) -> str:
        """The sentence, with the code of the error unless it is in it."""
        return self.sentence if self.code in self.sentence else f"{self.sentence} ({self.code})"


def ending_of(reading: RunReading, error: RunError | None = None, *, is_writer: bool = False) -> Ending:
    """Determine how a run ended. `error` is the command's error, if known.

    A program that holds the run goes on with it, unless that is the caller, the `is_writer` of its report.

    Every step may be done without the run being done: it is missed if a known error is beyond the margin of
    its target; not sealed as long as nothing confirms its end; and its error is not determined if the truth
    of its simulated theatre is lost. What is in doubt stays so.
    """
    ending = replace(
        _by_journal(reading.run.journal, error),
        instrument_held_for=_trajectory_of(reading.run.journal, Entry.HELD, "held"),
    )
    if ending.instrument_held_for:
        ending = replace(ending, held_name=last_held_name(reading.run.journal))
    holder = None if is_writer else find_folder_holder(reading.folder)
    if ending.word == "killed" and holder is not None:
        return Ending(RUNNING, f"{holder} has it open.", is_open=True)
    if ending.word not in DONE:
        return ending
    if error is not None and not _has_true_error(reading):  # of what is computed after the steps
        return Ending("failed", f"Every step was done, but {error.what}", error.code)
    rows = target_rows(reading, reading.truth or Truth())
    beyond = sum(row.verdict is MarginVerdict.BEYOND for row in rows)
    if beyond:
        sentence = f"{format_count(beyond, 'target')} beyond the margin of the plan. {ending.sentence}"
        return replace(ending, word="missed", sentence=sentence)
    if not reading.is_sealed:
        open_words = f"{holder} has it open and seals it next."
        word, why = (UNSEALED, NOT_SEALED) if holder is None else (CLOSING, open_words)
    elif reading.truth is None and _has_true_error(reading):
        holder = None
        word, why = UNKNOWN_ERROR, ERROR_LOST if error is None else f"The error is not known: {error.what}"
    else:
        return ending
    sentence = f"{ending.sentence} {why}"
    code = "" if error is None else error.code
    word = word if ending.word == "done" else ending.word
    return replace(ending, word=word, sentence=sentence, code=code, is_open=holder is not None)


def read_ending(folder: Path) -> Ending:
    """Read from its folder how a run ended, in milliseconds."""
    return ending_of(RunReading.of(inspect_run(folder, every_file=False)))


def await_ending(folder: Path) -> Ending:
    """Return how a run ended once its program has left it, or after a time limit as it is then."""
    until_s = time.monotonic() + SEALED_WITHIN_S
    while (ending := read_ending(folder)).is_open and time.monotonic() < until_s:
        time.sleep(AGAIN_S)
    return ending


def _has_true_error(reading: RunReading) -> bool:
    """Return whether the verifier knows the error at a target: the run has its own simulated theatre."""
    return any(TRUTH_FIELD in line for line in reading.run.journal) and any(
        record.kind == ReachedTarget.kind for record in reading.run.valid_records
    )


def _by_journal(journal: Sequence[Line], error: RunError | None) -> Ending:
    opened = next((line for line in journal if line["entry"] == Entry.OPENED), None)
    lines = reversed(journal)
    ended = next((line for line in lines if line["entry"] in (Entry.CLOSED, Entry.RESTARTED)), None)
    closed = ended if ended is not None and ended["entry"] == Entry.CLOSED else None
    last = next((line for line in reversed(journal) if line["entry"] in ENDS_A_STEP), None)
    if opened is None:
        return Ending("not begun", *_append_error("The run ended before its theatre was open.", error))
    if closed is None:
        where = _describe_place(journal)
        sentence = f"The program ended{where} without closing the run, or is still running."
        return Ending("killed", sentence, instrument_in=_trajectory_of(journal, Entry.INSTRUMENT, "inside"))
    inside = closed.get("instrument_in")
    word, sentence, code = _describe_before_leaving(journal, closed) or _describe_closed_run(
        journal, closed, last, error
    )
    return Ending(word, sentence, code, inside if isinstance(inside, str) else None)


def _trajectory_of(journal: Sequence[Line], entry: Entry, field: str) -> str | None:
    """Return the trajectory of the last line about an instrument, unless `field` says it was taken out."""
    last = next((line for line in reversed(journal) if line["entry"] == entry), None)
    return str(last["trajectory"]) if last is not None and last[field] else None


def is_resumable(reading: RunReading) -> bool:
    """Return whether a command may go on with a run: with a case, and with a calibration by its request."""
    return not reading.run.opened.get("procedure") or (reading.folder / REQUEST_FILE).exists()


def advise(ending: Ending, *, resumable: bool, run: str = "RUN") -> str:
    """Say what to do after an ending, with commands on `run`; empty after one that needs nothing."""
    if resumable or ending.word in ("not begun", "done", RUNNING, CLOSING):
        by_hand = ending.instrument_in if ending.instrument_held_for is None else None  # an arm leads it out
        first = f"First remove the instrument from {by_hand} by hand. " if by_hand else ""
        return first + ADVICE.get(ending.word, "").replace("RUN", run)
    code = f"docs/reference/error-codes.md says what to do about {ending.code}. " if ending.code else ""
    return f"{code}Put right what is named, then start the command again."


def advise_on_changed(*, may_go_home: bool, run: str) -> tuple[str, str]:
    """Say what to do about a run that is not resumed because its files were changed, and the next command."""
    first = f"ronna-procedure home {run} still brings the arm home. " if may_go_home else ""
    return (
        f"The run is not resumed while files are not as it left them. {first}ronna-procedure verify {run} "
        "lists them: put them back from a copy and move added ones out. Without a copy, start a new run.",
        f"ronna-procedure {'home' if may_go_home else 'verify'} {run}",
    )


def name_next_command(ending: Ending, *, resumable: bool, is_arm_out: bool, run: str) -> str:
    """Return the command to type next on `run` after an ending; empty if none goes on with it.

    A case that the operator ended is not gone on with: its arm is brought home.
    """
    command = NEXT.get(ending.word, "")
    if ending.word == "aborted":
        command = "home" if is_arm_out else ""
    if not command or (ending.word in STOPPED and not resumable):
        return ""
    return f"ronna-procedure {command} {run}"


def _describe_place(journal: Sequence[Line]) -> str:
    """Say during or after which step a journal ends, as " during tool_check"; empty before the first step."""
    told = (Entry.INTENT, *ENDS_A_STEP)
    latest = next((line for line in reversed(journal) if line["entry"] in told), None)
    if latest is None:
        return ""
    if latest["entry"] == Entry.INTENT:
        return f" during {latest.get('step', 'a step')}"
    return f" after {_last_step(journal)}"


def _last_step(journal: Sequence[Line]) -> str:
    """Return the last step that ended and stands: a result that a later line supersedes does not."""
    gone: set[str] = set()
    for line in reversed(journal):
        if line["entry"] in ENDS_A_STEP and line.get("record") not in gone:
            return str(line.get("step", "a step"))
        if isinstance(names := line.get("supersedes"), list):
            gone.update(map(str, names))
    return ""


def _describe_closed_run(
    journal: Sequence[Line], closed: Line, last: Line | None, error: RunError | None
) -> tuple[str, str, str]:
    """Return word, sentence and code for a closed run. `last` is the line that ended its last step."""
    outcome = closed.get("outcome")
    if outcome == "done":
        if doubts := targets_in_doubt(journal):
            why = "; ".join(dict.fromkeys(one for each in doubts.values() for one in each))
            return "in doubt", f"Every step was done, but not every target is confirmed: {why}.", ""
        return "done", f"Every step was done{_describe_incidents(journal)}.", ""
    step = "" if last is None else str(last.get("step", ""))
    during = f" during {step}" if step else ""
    if outcome == "left" and last is not None and last["entry"] in (Entry.FAILED, Entry.REFUSED):
        _, sentence, code = _describe_closed_run(journal, {**closed, "outcome": "failed"}, last, error)
        return "left", f"{sentence.rstrip('.')}. {_describe_leaving(journal, 'then')}.", code
    if outcome == "left":
        standing = _last_step(journal)
        when = f"after {standing}" if standing else "before its first step"
        return "left", f"{_describe_leaving(journal, when)}.", ""
    if outcome == "interrupted":
        return "interrupted", f"It was interrupted{during}.", ""
    if last is not None and last["entry"] == Entry.INTERRUPTED:
        return "aborted", f"The operator ended it{during}.", ""
    if last is not None and last["entry"] == Entry.REFUSED:
        unmet = last.get("unmet")
        reasons = "; ".join(map(str, unmet)) if isinstance(unmet, list) else ""
        return "refused", f"{step} was refused: {reasons}.{_describe_acknowledgement(journal, last)}", ""
    if last is not None and last["entry"] == Entry.FAILED:
        over = _describe_acknowledgement(journal, last)
        return "failed", f"{step} failed. {last.get('what', '')}{over}", str(last.get("code", ""))
    if error is None and closed.get("what"):
        error = RunError(code=str(closed.get("code")), what=str(closed["what"]))
    return "failed", *_append_error(f"It failed after {step}." if step else "It failed.", error)


def _describe_before_leaving(journal: Sequence[Line], closed: Line) -> tuple[str, str, str] | None:
    """Describe the ending of a case that commands such as `home` took up later without a step.

    None if there were none, or if the case itself ended otherwise than by a person.
    """
    begins = [number for number, line in enumerate(journal) if line["entry"] == Entry.RESTARTED]
    cut = None
    while begins and ONLY_LEAVING in journal[begins[-1]]:
        cut = begins.pop()
    if not cut or journal[cut - 1]["entry"] != Entry.CLOSED:
        return None
    before = _by_journal(journal[:cut], None)
    if before.word not in BY_PERSON or (before.word == closed.get("outcome")):
        return None
    if closed.get("outcome") == "left":
        return before.word, f"{before.sentence} {_describe_leaving(journal, 'later')}.", before.code
    why = f": {closed['code']}, {str(closed['what']).rstrip('.')}" if closed.get("what") else ""
    return before.word, f"{before.sentence} A later attempt to go home did not succeed{why}.", before.code


def _describe_leaving(journal: Sequence[Line], when: str) -> str:
    """Say that the operator left a case, or what a command that runs no step did with it."""
    begins = [number for number, line in enumerate(journal) if line["entry"] == Entry.RESTARTED]
    if not begins or ONLY_LEAVING not in journal[begins[-1]]:
        return f"The operator left the case {when}" if when != "then" else "The operator then left the case"
    entries = {line["entry"] for line in journal[begins[-1] :]}
    done = "A fault was acknowledged" if Entry.ACKNOWLEDGED in entries else "Nothing was moved"
    return f"{'The arm was sent home' if Entry.HOME in entries else done} {when}, and no step was run"


def _describe_acknowledgement(journal: Sequence[Line], last: Line) -> str:
    """Describe who later acknowledged the fault in a line, or return '' if nobody has."""
    place = next(number for number, line in enumerate(journal) if line is last)
    error_text = " ".join(str(last.get(field, "")) for field in ("code", "what", "unmet"))
    names = [
        str(line.get("by", ""))
        for line in journal[place:]
        if line["entry"] == Entry.ACKNOWLEDGED and _is_named(line, error_text)
    ]
    return f" The fault was acknowledged by {names[-1]}." if names else ""


def _is_named(acknowledged: Line, error_text: str) -> bool:
    """Return whether an error text mentions the acknowledged fault or its device."""
    code = str(acknowledged.get("fault", "")).partition(":")[0]
    return f"the {acknowledged.get('device')} is in fault" in error_text or (
        code != "" and code in error_text
    )


def _describe_incidents(journal: Sequence[Line]) -> str:
    """List the incidents of a finished case in words, or return '' if there were none."""
    failed = [line for line in journal if line["entry"] == Entry.FAILED and not _is_stop(line)]
    steps = [str(line.get("step", "")).partition(":")[0] for line in failed]
    paused = [line for line in journal if line["entry"] == Entry.RESTED and line.get("state") == PAUSED]
    counters = [
        (_count_emergency_stops(journal), EMERGENCY_STOP, ""),
        (len(steps), "failed step", f" ({', '.join(dict.fromkeys(steps))})"),
        (len(paused), "pause", ""),
        (resumes(journal), "resume", ""),
    ]
    counts = [f"{format_count(number, what)}{more}" for number, what, more in counters if number]
    return f", after {', '.join(counts)}" if counts else ""


def resumes(journal: Sequence[Line]) -> int:
    """Count how often another program resumed the run."""
    count, leaving = 0, False
    for line in journal:
        if line["entry"] == Entry.RESTARTED:
            leaving = ONLY_LEAVING in line
        count += line["entry"] == Entry.ACCEPTED and not leaving
    return count


def _count_emergency_stops(journal: Sequence[Line]) -> int:
    """Count emergency stops. Each counts once, however many steps fail before it is acknowledged."""
    count, is_standing = 0, False
    for line in journal:
        is_of_arm = line["entry"] == Entry.ACKNOWLEDGED and line.get("device") == ARM
        if is_of_arm and (is_standing or _is_stop(line)):
            count, is_standing = count + 1, False
        elif line["entry"] in (Entry.FAILED, Entry.REFUSED) and _is_stop(line):
            is_standing = True
    return count + is_standing


def _is_stop(line: Line) -> bool:
    return any(EMERGENCY_STOP in str(line.get(field, "")) for field in ("what", "fault", "unmet"))


def _append_error(sentence: str, error: RunError | None) -> tuple[str, str]:
    return (sentence, "") if error is None else (f"{sentence} {error.what}", error.code)
