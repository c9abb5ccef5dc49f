"""Workcell, people, inputs and settings shared by all steps of a run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, cast

from procedures.engine.methods import CaseMethods
from procedures.imaging.dicom.slice_headers import CT_FOLDER
from procedures.operator.question import Operator, Room
from procedures.strategies.strategy import Strategy
from ronna_hw.clock import Clock
from ronna_hw.config import ProcedureSettings
from ronna_hw.roles import ONE_ARM

if TYPE_CHECKING:
    from procedures.workcell import Workcell
    from ronna_hw.collision_config import CollisionConfig

T = TypeVar("T")


class CaseMemory:
    """Cache of one object per type. A step re-reads its input if the cache is empty."""

    def __init__(self) -> None:
        self._kept: dict[type[object], object] = {}

    def keep(self, value: object) -> None:
        """Keep an object, replacing any other of its type."""
        self._kept[type(value)] = value

    def find(self, kind: type[T]) -> T | None:
        """Return the cached object of a type, or None."""
        return cast("T | None", self._kept.get(kind))

    def drop(self, kind: type[object]) -> None:
        self._kept.pop(kind, None)

    def clear(self) -> None:
        """Drop everything, as after a restart."""
        self._kept.clear()


@dataclass(frozen=True)
class ClinicalInput:
    """CT, plan, strategy and methods of a clinical case."""

    series: Path  # folder of the CT series
    plan: Path
    strategy: Strategy
    measure_targets: bool = False  # on a phantom
    plan_sha256: str | None = None  # of the plan as it was held when the case was opened
    methods: CaseMethods = field(default_factory=CaseMethods)
    roles: tuple[str, ...] = ONE_ARM  # of the arms, the master first
    intraoperative: bool = False  # the clamped head is scanned

    @property
    def scan_folder(self) -> Path:
        """Folder beside the plan for the scan of the clamped head, its series in ct/."""
        return self.plan.with_name("intraoperative")

    @property
    def scan_series(self) -> Path:
        """Folder of the series of that scan."""
        return self.scan_folder / CT_FOLDER

    @property
    def place(self) -> Path:
        """Path next to the plan where a proposed cart position is expected."""
        return self.plan.with_name("place.json")


def now_to_second() -> datetime:
    """Return the current UTC time, truncated to the second."""
    return datetime.now(UTC).replace(microsecond=0)


@dataclass(frozen=True)
class CaseSetting:
    """Workcell, people and settings of one run."""

    workcell: Workcell
    clock: Clock
    operator: Operator
    room: Room
    settings: ProcedureSettings
    surroundings: CollisionConfig  # the theatre file's bodies around the arm
    clinical: ClinicalInput | None = None
    memory: CaseMemory = field(default_factory=CaseMemory)
    arm_not_home: str | None = None  # where another run left the arm, and how to bring it home
    today: Callable[[], datetime] = lambda: datetime.now(UTC)  # for the expiry of calibrations
    starts: frozenset[str] = frozenset()  # calibrations that may have expired: another one starts from them
    began: datetime = field(default_factory=now_to_second)  # date of a calibration's observations
