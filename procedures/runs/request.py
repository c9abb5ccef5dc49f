"""Run requests: theatre and procedure. Free of pydantic, since every command imports this at start-up."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.engine.methods import CaseMethods
from procedures.strategies.names import DEFAULT_STRATEGY
from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.bounded_input import InputRefused, parse_json, read_json_bytes, read_toml
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.near_names import find_near
from ronna_hw.roles import ONE_ARM
from ronna_hw.x_frame import SPHERE_CENTRES_MM

if TYPE_CHECKING:
    from pydantic import JsonValue

    from procedures.engine.order import Steps
    from procedures.runs.answers import Answers
    from procedures.steps.calibration.recipe import Recipe
    from ronna_hw.config import Calibrations


PATIENT_SCENES = ("default", "mini")  # of the scenes that ronna-sim knows, those with a patient
LARGEST_SEED = 65535  # more cases than any study runs, and short enough to be read aloud

FREE = "free"  # screws of their own
XFRAME, SURFACE = "xframe", "surface"
SEEN_BY_TOOLS = (XFRAME, SURFACE)  # no single sphere is to be seen by the tracker
POLARIS = "polaris"  # the tracker itself, not a server in front of it
DEFAULT_ARM = ArmChoice.KR6.value


@dataclass(frozen=True)
class FittingMarkers:
    """Numbers of markers that fit a kind of fiducials, and what is said of others."""

    words: str
    counts: range
    expected: str
    action: str


FRAME_SPHERES = len(SPHERE_CENTRES_MM)
MARKERS = {
    FREE: FittingMarkers(
        "spheres alone", range(3, 9), "3 to 8", "With 1 or 2 have the skin scanned too: --fiducials mixed."
    ),
    XFRAME: FittingMarkers(
        "the x-shaped frame",
        range(FRAME_SPHERES, FRAME_SPHERES + 1),
        f"its {FRAME_SPHERES} spheres",
        "Omit --markers with the x-shaped frame.",
    ),
    SURFACE: FittingMarkers(
        "the surface as fiducial",
        range(0),
        "a head without spheres",
        "Omit --markers with --fiducials surface, or scan the skin beside spheres: --fiducials mixed.",
    ),
    "mixed": FittingMarkers(
        "the surface as fiducial beside them", range(1, 4), "1 to 3", "With more use --fiducials free."
    ),
}


@dataclass(frozen=True)
class SceneChoice:
    """Options of the simulated theatre and its phantom."""

    scene: str = "default"
    seed: int = 0
    markers: int | None = None
    targets: int | None = None
    fiducials: str = FREE  # what the spheres stand on
    tracker: str = POLARIS  # how the tracker is reached
    arm: str = DEFAULT_ARM
    assistant_arm: str = DEFAULT_ARM  # in dual mode
    drill: bool = False  # by the assistant
    calibrated: bool = False  # the arm of the theatre, with a record of it; the patient is the same
    first_day: bool = False  # frame and guide of the theatre are as drawn, without valid records
    records: tuple[Path, ...] = ()  # folders of calibrations, instead of the theatre's own records

    def check(self) -> None:
        """Raise CLI-001 unless the scene is a known name or an existing file (contents unchecked)."""
        if self.scene not in PATIENT_SCENES and not Path(self.scene).is_file():
            close_matches = find_near(self.scene, PATIENT_SCENES)
            raise UsageMistake(
                f"there is no scene {self.scene!r}",
                expected=f"{' or '.join(PATIENT_SCENES)}, which have a patient, or the path of a scene file",
                action=f"Did you mean {close_matches[0]}?"
                if close_matches
                else "ronna-sim scene prints one to start from.",
            )
        if self.tracker != POLARIS and self.fiducials not in SEEN_BY_TOOLS and not self.has_own_fiducials:
            raise UsageMistake(
                f"--tracker {self.tracker} sends tools alone, and --fiducials {self.fiducials} has single "
                "spheres",
                expected=" or ".join(f"--fiducials {one}" for one in SEEN_BY_TOOLS),
                action=f"Add --fiducials {' or '.join(SEEN_BY_TOOLS)}, or omit --tracker.",
            )
        fitting = MARKERS[self.fiducials]
        if self.markers is not None and self.markers not in fitting.counts:
            raise UsageMistake(
                f"--markers cannot be {self.markers} with {fitting.words}",
                expected=fitting.expected,
                action=fitting.action,
            )

    def arguments(self) -> list[str]:
        """Return the options common to `ronna-sim theatre` and `ronna-sim phantom`."""
        options = ["--scene", self.scene, "--seed", str(self.seed)]
        for name, value in (
            ("--markers", self.markers),
            ("--targets", self.targets),
            ("--fiducials", None if self.fiducials == FREE else self.fiducials),
            ("--arm", None if self.arm == DEFAULT_ARM else self.arm),
        ):
            if value is not None:
                options += [name, str(value)]
        return options

    def theatre_arguments(self) -> list[str]:
        """Return all options for `ronna-sim theatre`."""
        options = self.arguments()
        if self.tracker != POLARIS:
            options += ["--tracker", self.tracker]
        if self.calibrated:
            options.append("--calibrated")
        if self.first_day:
            options.append("--first-day")
        for folder in self.records:
            options += ["--calibration", str(folder)]
        return options

    @property
    def has_own_fiducials(self) -> bool:
        """Whether the scene is a file, which states the fiducials and is read only later."""
        return bool(Path(self.scene).suffix)

    @property
    def scene_seed(self) -> int:
        """Random seed of the scene; a scene file contains its own."""
        path = Path(self.scene)
        if not path.suffix:
            return self.seed
        try:
            is_json = path.suffix == ".json"
            content = parse_json(read_json_bytes(path)) if is_json else read_toml(path, InputRefused)
            return int(content.get("seed", 0))
        except (OSError, ValueError, AttributeError, TypeError, OverflowError):
            return self.seed


@dataclass(frozen=True, kw_only=True)
class CaseProcedure:
    """A clinical case, on a patient or a phantom."""

    strategy: str = DEFAULT_STRATEGY
    methods: CaseMethods = field(default_factory=CaseMethods)
    measure_targets: bool = False  # on a phantom with a ball at each target; a simulated one brings them
    intraoperative: bool = False  # the clamped head is scanned; the simulated one by its theatre's staff
    case: Path | None = None  # folder with ct/ and plan.toml, on configured endpoints
    plan: Path | None = None  # for the simulated patient, in place of its own
    keep_raw: bool = False  # pictures and tracker frames as files
    roles: tuple[str, ...] = ONE_ARM  # of the arms, the master first


@dataclass(frozen=True, kw_only=True)
class CalibrationProcedure:
    """A calibration whose records are valid for `days`."""

    recipe: Mapping[str, JsonValue]  # as `Recipe` writes it
    days: int
    update: bool = False  # the theatre file, with the new records


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """A check or a single measurement. Without a request file it cannot be resumed.

    `in_use` selects the records to work with, given those of the theatre; a replay needs the `recipe`.
    """

    steps: Steps
    title: str
    in_use: Callable[[Calibrations], Calibrations] = lambda of_theatre: of_theatre
    recipe: Recipe | None = None


@dataclass(frozen=True, kw_only=True)
class RunRequest:
    """A procedure and its theatre: the one configured by the theatre file `config`, or a simulated one."""

    procedure: CaseProcedure | CalibrationProcedure | Measurement | None = None  # None: not yet chosen
    config: Path | None = None
    choice: SceneChoice = field(default_factory=SceneChoice)
    speed: str = "max"
    faults: Path | None = None
    answers: Answers | None = None  # of a scripted operator
    ask: bool = False  # a person does the manual work of a simulated theatre by a word, and is asked all
    by_step: bool = False  # commands on standard input run its steps

    @property
    def has_person(self) -> bool:
        """Whether a person, not a script, answers what no file does."""
        return self.ask or self.config is not None

    @property
    def roles(self) -> tuple[str, ...]:
        """Roles of the arms that it uses."""
        return self.procedure.roles if isinstance(self.procedure, CaseProcedure) else ONE_ARM

    @property
    def seed(self) -> int | None:
        """Seed of a simulated theatre, or None for a configured one."""
        return self.choice.scene_seed if self.config is None else None

    @property
    def case(self) -> CaseProcedure:
        """Procedure of a case. Asserts that the request is for a case."""
        assert isinstance(self.procedure, CaseProcedure), "this is not a case"
        return self.procedure

    @property
    def calibration(self) -> CalibrationProcedure:
        """Procedure of a calibration. Asserts that the request is for a calibration."""
        assert isinstance(self.procedure, CalibrationProcedure), "this is not a calibration"
        return self.procedure
