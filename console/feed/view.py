"""The state of a case at one moment: everything the page shows, without further queries."""

from __future__ import annotations

from dataclasses import dataclass, field

from procedures.engine.events import (
    Bodies,
    DeviceState,
    LinkHealth,
    MeasuringVolume,
    Pose,
    Questioned,
    Seat,
    Waiting,
)

RATE_OVER_S = 1.0  # theatre time


@dataclass(frozen=True)
class StepRow:
    """A step in the order of the case, and its outcome."""

    step: str
    title: str
    phase: str
    moves: bool
    state: str = ""  # begun, done, failed, interrupted, superseded; empty: not yet
    summary: str = ""
    record: str | None = None


@dataclass(frozen=True)
class Rate:
    """How often something was counted per second of theatre time, over the last second or more."""

    count: int
    since_s: float  # when it was that many
    hz: float | None = None

    def at(self, count: int, now_s: float) -> Rate:
        """The rate now; fewer than before means that counting began again."""
        if count < self.count:
            return Rate(count, now_s)
        span_s = now_s - self.since_s
        return self if span_s < RATE_OVER_S else Rate(count, now_s, (count - self.count) / span_s)


@dataclass(frozen=True)
class DeviceRow:
    """A device as it was last seen."""

    seen: DeviceState
    age_s: float | None = None  # of its latest reading, theatre time
    validity: str = ""  # of that reading
    rate: Rate | None = None  # of its readings


@dataclass(frozen=True)
class StoodPose:
    """Where an arm was, and when that was reported, in theatre time."""

    pose: Pose
    said_s: float


@dataclass(frozen=True)
class Notice:
    """A fault, a refusal or a finding: what happened, and what to do; `settled` once the step has passed."""

    kind: str
    theatre_time_s: float
    what: str
    advice: str = ""
    code: str = ""
    step: str = ""  # the step it happened in
    settled: bool = False


@dataclass(frozen=True)
class CaseView:
    """The case after event `number`; `fact` is the last one that is not a signal."""

    number: int = 0
    fact: int = 0
    theatre_time_s: float = 0.0
    host_time: str = ""
    run: str = ""
    theatre: str = ""
    banner: str | None = None  # None: not reported yet; empty: hardware
    strategy: str = ""
    state: str = "opening"
    reason: str = ""
    steps: tuple[StepRow, ...] = ()
    running: str = ""
    share: float = 0.0
    doing: str = ""
    waiting: Waiting | None = None
    question: Questioned | None = None
    asked_at: str = ""  # host time
    seat: Seat | None = None
    devices: dict[str, DeviceRow] = field(default_factory=dict)
    link: LinkHealth | None = None
    link_said_s: float = 0.0  # when that was reported, theatre time
    link_rate: Rate | None = None  # of its cycles
    bodies: Bodies | None = None
    volume: MeasuringVolume | None = None
    pose: StoodPose | None = None
    notices: tuple[Notice, ...] = ()
    journal: tuple[str, ...] = ()
    results: int = 0  # number of results added or superseded so far
    outcome: str = ""  # of a closed run

    @property
    def mode(self) -> str:
        """Operating mode of the controller, as last reported."""
        said = (fact for row in self.devices.values() for fact in row.seen.says)
        return next((fact.found for fact in said if fact.name == "operating mode"), "")

    @property
    def upcoming(self) -> str:
        """The next step, as far as the events show."""
        if self.waiting is not None:
            return self.waiting.upcoming or ""
        return next((row.step for row in self.steps if row.state != "done" and row.step != self.running), "")
