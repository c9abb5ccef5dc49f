"""Human-readable view of a case, built from its events: step outcomes and current state."""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

from procedures.engine.events import (
    Advisory,
    Answered,
    CaseState,
    DeviceAge,
    DeviceState,
    Event,
    EventStream,
    Fault,
    JournalLine,
    Progress,
    Questioned,
    Refusal,
    Seat,
    SignalsLost,
    StepState,
    Waiting,
)
from procedures.engine.events.stream import LAST_LINES
from procedures.engine.states import HELD
from procedures.runs.observers import SEAT_AWAITED
from ronna_hw.text import printable

if TYPE_CHECKING:
    from rich.console import RenderableType

LAST_ERRORS = 2
ACKNOWLEDGED = "acknowledged"  # an entry of the journal
MARKS = {"done": ("✓", "green"), "superseded": ("~", "yellow")}
FAILED = ("✗", "red")
ENDING_S = 2.0  # host time to show the last events
Show = Callable[[Sequence[Event]], None]


@dataclass(frozen=True)
class Entry:
    """One line in the history of a case."""

    mark: str
    style: str
    text: str


def join_voided(events: Iterable[Event]) -> Iterator[Event]:
    """Join results that no longer hold for one and the same reason into one event."""
    for reason, group in groupby(events, _voided_by):
        same = list(group)
        if reason:
            records = ", ".join(str(one.what.record) for one in same if isinstance(one.what, StepState))
            what = same[0].what.model_copy(update={"record": records})
            same = [same[0].model_copy(update={"what": what})]
        yield from same


def _voided_by(event: Event) -> str:
    what = event.what
    return what.summary if isinstance(what, StepState) and what.state == "superseded" else ""


def entry_of(event: Event, *, errors: bool = True) -> Entry | None:
    """Return the history line for a step outcome or finding, or None for other events.

    Without `errors`, which are shown beside it, a failed step is shown with its code only.
    """
    match event.what:
        case StepState(state="begun"):
            return None
        case StepState(step=step, state="superseded", record=record, summary=reason):
            how = f"{_hold(record)}: {reason}" if reason else f"is superseded by a new {step}"
            return Entry(*MARKS["superseded"], f"{record} {how}")
        case StepState(state="failed", summary=summary) as step if not errors:
            return Entry(*FAILED, f"{_name_step(step)}: {_code_of(summary)}")
        case StepState(state=state, summary=summary) as step:
            return Entry(*MARKS.get(state, FAILED), f"{_name_step(step)}: {summary}")
        case Advisory(text=text):
            return Entry("!", "yellow", text)
        case _:
            return None


def _hold(records: str | None) -> str:
    return "no longer hold" if ", " in str(records) else "no longer holds"


def _name_step(step: StepState) -> str:
    """Name a step in words, with its code beside."""
    return f"{step.title} ({step.step})" if step.title else step.step


def plain_line_of(event: Event) -> str | None:
    """Return a plain line for a finished step, voided result or finding, or None for other events."""
    match event.what:
        case StepState(step=step, title=title, state="done", summary=summary):
            return f"done {step} ({title}): {summary}"  # scripts await its code
        case StepState(state="superseded", record=record, summary=reason) if reason:
            return f"note: {record} {_hold(record)}: {reason}"
        case Advisory(text=text):
            return f"note: {text}"
        case _:
            return None


def describe_state(case: CaseState) -> str:
    """Describe the state of a case with its reason, except for a held case, whose failed step explains it."""
    return f"{case.state} ({case.reason})" if case.reason and case.state != HELD else case.state


def describe_loss(lost: SignalsLost) -> str:
    """Describe how many signals a follower has missed."""
    return f"{lost.count} poses and other signals are not in the file of events; no fact is missing"


class CaseView:
    """Current view of a case: state, step, progress, devices, journal and errors."""

    def __init__(self) -> None:
        self.state = "starting"
        self._step = ""  # the one that began last
        self._seated = ""  # who is in the operator's seat of the console
        self._upcoming: str | None = None  # while the case waits for an order
        self._lost = ""
        self.share = 0.0
        self.activity = ""
        self._devices: dict[str, DeviceState] = {}
        self._ages_s: dict[str, float] = {}
        self._journal: deque[str] = deque(maxlen=LAST_LINES)
        self._errors: deque[tuple[str, str]] = deque(maxlen=LAST_ERRORS)  # step and error text

    def take_in(self, event: Event) -> None:
        """Update the view from an event."""
        match event.what:
            case CaseState() as case:
                self.state = describe_state(case)
            case StepState(step=step, state="begun"):
                self._step = self.activity = step
                self._upcoming = None
                self.share = 0.0
                self._settle(step)
            case Progress(step=step, share=share, text=text):
                self.activity, self.share = f"{step}: {text}", share
            case Waiting(upcoming=upcoming):
                self._upcoming = upcoming
                self._show_waiting()
            case Seat(holder=holder):
                self._seated = holder
                self._show_waiting()
            case DeviceState(device=device) as state:
                self._devices[device] = state
            case DeviceAge(device=device, age_s=age_s):
                self._ages_s[device] = age_s
            case JournalLine(line=line):
                self._journal.append(_summarize_line(line))
                if line.get("entry") == ACKNOWLEDGED:
                    self._settle_fault(str(line.get("device")), str(line.get("fault")))
            case Fault(code=code, what=what):
                text = what if what.startswith(code) else f"{code}: {what}"
                self._errors.append((self._step, text))
            case Refusal(step=step, unmet=unmet):
                self._errors.append((step, f"{step} refused: {'; '.join(unmet)}"))
            case Questioned(subject=subject):
                self.state = f"{self.state.partition(' (')[0]} (asks: {subject})"
            case SignalsLost() as lost:
                self._lost = describe_loss(lost)
            case Answered():
                self.state = self.state.partition(" (asks: ")[0]
            case _:
                pass

    def _show_waiting(self) -> None:
        if self._upcoming is not None:
            whom = f"waiting for an order of {self._seated}" if self._seated else SEAT_AWAITED
            self.activity, self.share = f"{whom}; next is {self._upcoming}", 0.0

    @property
    def devices(self) -> str:
        """State and age of each device."""
        return "   ".join(map(self._describe_device, self._devices.values()))

    def lines(self) -> list[tuple[str, str]]:
        """Return the style and text of each line shown below the progress bar."""
        shown = [("", self.state)]
        if self._devices:
            shown.append(("", self.devices))
        shown += [("dim", text) for text in (*self._journal, self._lost) if text]
        shown += [("red", text) for _step, text in self._errors]
        return shown

    def _settle(self, step: str) -> None:
        """Drop the errors of earlier attempts at a step that begins again."""
        kept_errors = [one for one in self._errors if one[0] != step]
        self._errors.clear()
        self._errors.extend(kept_errors)

    def _settle_fault(self, device: str, fault: str) -> None:
        """Drop a cleared fault and the refusals it caused."""
        fault_words = (f"the {device} is in fault", f"{_code_of(fault)}: ")
        kept_errors = [one for one in self._errors if not any(words in one[1] for words in fault_words)]
        self._errors.clear()
        self._errors.extend(kept_errors)

    def __rich__(self) -> RenderableType:
        from rich.console import Group
        from rich.text import Text

        rows = [
            Text(f"  {printable(text)}", style, no_wrap=True, overflow="ellipsis")
            for style, text in self.lines()
        ]
        return Group(*rows)

    def _describe_device(self, device_state: DeviceState) -> str:
        age_s = self._ages_s.get(device_state.device)
        age = "" if age_s is None else f" {age_s:.1f} s"
        return f"{device_state.device} {device_state.state}{age}" + (
            f" [{_code_of(device_state.fault)}]" if device_state.fault else ""
        )


def _code_of(error: str) -> str:
    """Return the error code at the start of an error text."""
    return error.partition(": ")[0]


def _summarize_line(line: Mapping[str, object]) -> str:
    about = next((line[name] for name in ("step", "what", "topic", "device", "text") if name in line), "")
    return f"{line.get('sequence')} {line.get('entry')} {about}"


class EventFollower:
    """Follows an event stream in its own thread. Calls to `show` never overlap."""

    def __init__(self, events: EventStream, show: Show) -> None:
        self._reader = events.subscribe()
        self._show = show
        self._showing = threading.RLock()
        self._thread = threading.Thread(target=self._follow, name="event follower", daemon=True)

    def start(self) -> None:
        """Start following the stream."""
        self._thread.start()

    @contextlib.contextmanager
    def quiet(self) -> Iterator[None]:
        """Show pending events, then suppress output while the block runs."""
        with self._showing:
            self.catch_up()
            yield

    def catch_up(self) -> bool:
        """Show all events so far; return whether the stream has ended."""
        with self._showing:
            batch = self._reader.read(0.0)
            self._show(batch.events)
            return batch.ended

    def join(self) -> None:
        """Wait until the rest of the stream has been shown."""
        self._thread.join(ENDING_S)

    def _follow(self) -> None:
        ended = False
        while not ended:
            self._reader.wait()
            ended = self.catch_up()
