"""One event with its number and time, as readers receive it and the run's file stores it."""

from __future__ import annotations

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field

from procedures.engine.events.happenings import VERSION, Happening


class Event(BaseModel):
    """One happening with its number and its time."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    version: int = VERSION
    number: int = Field(description="Counts all events of a run from 1.")
    host_time: AwareDatetime
    theatre_time_s: float
    what: Happening

    @property
    def subject(self) -> str:
        """Kind and subject: of signals with the same one only the latest matters."""
        return f"{self.what.kind} {self.what.about}"
