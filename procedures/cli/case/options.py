"""Command-line options for cases, theatres and the console."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from procedures.cli.planning_inputs import STRATEGY_HELP
from procedures.engine.methods import CaseMethods, HeadStart, Matcher
from procedures.imaging.localizers import Localizer
from procedures.registration.thesis_settings import E_MM, E_RANGE_MM, REFUSED_SHARE, REFUSED_SHARE_RANGE
from procedures.runs.request import LARGEST_SEED, CaseProcedure, RunRequest, SceneChoice
from procedures.strategies.names import DEFAULT_STRATEGY, STRATEGY_NAMES
from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.messages import tell
from ronna_hw.command_line.viewers_address import BindOption, CertificateOption, KeyOption, viewers_address
from ronna_hw.roles import roles_of

if TYPE_CHECKING:
    from procedures.runs.answers import Answers
    from procedures.runs.archive import Archive
    from procedures.runs.console_link import ConsoleRequest
    from procedures.runs.openigtlink import LinkAddress

DRAWN = ("seed", "markers", "targets", "fiducials", "arm")  # which a scene file holds
SIMULATED = (
    *DRAWN,
    "tracker",
    "assistant_arm",
    "drill",
    "scene",
    "first_day",
    "calibration",
    "speed",
    "faults",
)

ConfigOption = Annotated[Path | None, Option(metavar="FILE", help="Theatre file with the endpoints to use.")]

StartOption = Annotated[
    HeadStart,
    Option(
        help="On the skin: nose and ears touched with a pointer, or a few looks first, where the head was "
        "measured roughly."
    ),
]


class FiducialChoice(StrEnum):
    """Type of markers on the patient, or the surface of the head instead."""

    FREE = "free"
    XFRAME = "xframe"
    SURFACE = "surface"
    MIXED = "mixed"


class TrackerChoice(StrEnum):
    """How the tracker of the simulated theatre is reached."""

    POLARIS = "polaris"
    PLUS = "plus"


class SpeedChoice(StrEnum):
    """Pace of the simulated theatre."""

    MAX = "max"
    REAL = "1"


@dataclass(frozen=True)
class TheatreOptions:
    """Options for choosing a theatre, simulated or configured, and a scripted operator."""

    sim: Annotated[bool, Option("--sim", help="Start a simulated theatre for this run.")] = False
    config: ConfigOption = None
    scene: Annotated[str, Option(help="default, mini, or a scene file; with --sim.")] = "default"
    seed: Annotated[int, Option(min=0, max=LARGEST_SEED, help="Seed of everything drawn at random.")] = 0
    arm: Annotated[ArmChoice, Option(case_sensitive=False, help="Arm of the simulated theatre.")] = (
        ArmChoice.KR6
    )
    calibrated: Annotated[
        bool,
        Option(
            "--calibrated", help="With a calibrated arm: --sim brings its record, --config must name one."
        ),
    ] = False
    first_day: Annotated[
        bool, Option("--first-day", help="With --sim: frame and guide are as drawn, without valid records.")
    ] = False
    calibration: Annotated[
        list[Path] | None,
        Option(
            metavar="FOLDER",
            help="With --sim: records from a calibration, instead of the theatre's own; repeatable.",
        ),
    ] = None
    ask: Annotated[
        bool,
        Option(
            "--ask",
            help="In a simulated theatre: ask every question of a real case at this terminal, where manual "
            "work is done by a word, such as mount 2. Without it --sim is answered by a script.",
        ),
    ] = False
    answers: Annotated[
        Path | None, Option(help="TOML file that answers the questions: a scripted operator.")
    ] = None

    @property
    def choice(self) -> SceneChoice:
        """Scene choices for generating a simulated theatre."""
        return SceneChoice(
            self.scene,
            self.seed,
            arm=self.arm.value,
            calibrated=self.calibrated,
            first_day=self.first_day,
            records=tuple(self.calibration or ()),
        )

    def read_answer_file(self) -> Answers | None:
        """Read the answer file, if any. Raises PRO-026, CFG-001."""
        if self.answers is None:
            return None
        from procedures.runs.answers import read_answers

        return read_answers(self.answers, self.config)

    def theatre(self) -> RunRequest:
        """Return the run request for a calibration, which has no clinical procedure.

        Raises CLI-001 for conflicting options, CFG-001, CAL-005.
        """
        from procedures.runs.request_checks import check_theatre

        self.check()
        request = RunRequest(
            config=self.config, choice=self.choice, answers=self.read_answer_file(), ask=self.ask
        )
        check_theatre(request)
        return request

    def check(self) -> None:
        """Raise CLI-001 unless the options select exactly one theatre and all apply to it."""
        if self.sim and self.config is not None:
            raise UsageMistake(
                "--sim and --config cannot be combined",
                expected="one of them",
                got=f"--sim and --config {self.config}",
                action=f"Omit --sim to use the devices of {self.config}, or --config to simulate a theatre.",
            )
        if not self.sim and self.config is None:
            raise UsageMistake(
                "choose one: --sim, or --config FILE",
                action="--sim simulates a theatre, --config uses the devices of a theatre file.",
            )
        if self.config is not None and (given := self._list_changed_options(("drill",))):
            raise UsageMistake(
                f"{given} and --config cannot be combined",
                action=f"Omit it, and write assistant_drills = true under [procedure] of {self.config}.",
            )
        if self.config is not None and (given := self._list_changed_options(SIMULATED)):
            raise UsageMistake(
                f"{given} and --config cannot be combined",
                action="Omit it: the theatre file names the devices of the theatre.",
            )
        if Path(self.scene).suffix and (given := self._list_changed_options(DRAWN)):
            raise UsageMistake(
                f"{given} and a scene file cannot be combined",
                action=f"Omit it: {self.scene} says which seed and which markers it has.",
            )
        if self.sim:
            self.choice.check()

    def _list_changed_options(self, names: Sequence[str]) -> str:
        """List the options among `names` that differ from their defaults, as typed on the command line."""
        changed = (
            option.name
            for option in fields(self)
            if option.name in names and getattr(self, option.name) != option.default
        )
        return ", ".join(f"--{name.replace('_', '-')}" for name in changed)


@dataclass(frozen=True)
class CaseOptions(TheatreOptions):
    """Case options shared by the `run` and `step` commands."""

    case: Annotated[Path | None, Option(help="Folder with ct/ and plan.toml, with --config.")] = None
    plan: Annotated[
        Path | None, Option(help="With --sim: follow this plan on the simulated patient, not its own.")
    ] = None
    markers: Annotated[
        int | None,
        Option(
            min=1, max=8, help="Spheres on the head, instead of the scene's; 1 to 3 with mixed fiducials."
        ),
    ] = None
    targets: Annotated[
        int | None, Option(min=1, max=10, help="Number of trajectories (default: the scene's).")
    ] = None
    fiducials: Annotated[
        FiducialChoice,
        Option(
            help="Fixation of the spheres: screws, or the x-shaped frame. With surface there are none, and "
            "the skin is scanned; with mixed the skin and 1 to 3 spheres on screws."
        ),
    ] = FiducialChoice.FREE
    strategy: Annotated[str, Option(metavar="|".join(STRATEGY_NAMES), help=STRATEGY_HELP)] = DEFAULT_STRATEGY
    start: StartOption = HeadStart.LANDMARKS
    localizer: Annotated[
        Localizer, Option(help="Finds the spheres in the CT; a thesis localizer is not for clinical use.")
    ] = Localizer.OURS
    matcher: Annotated[
        Matcher, Option(help="Pairs the spheres of CT and room; the thesis matcher is not for clinical use.")
    ] = Matcher.OURS
    matcher_e_mm: Annotated[
        float | None,
        Option(
            "--matcher-e-mm",
            min=E_RANGE_MM[0],
            max=E_RANGE_MM[1],
            metavar="MM",
            help=f"With --matcher thesis: largest difference of equal distances [{E_MM:g}].",
        ),
    ] = None
    matcher_refused_share: Annotated[
        float | None,
        Option(
            "--matcher-refused-share",
            min=REFUSED_SHARE_RANGE[0],
            max=REFUSED_SHARE_RANGE[1],
            metavar="SHARE",
            help=f"With --matcher thesis: correct pairings that its validation refuses [{REFUSED_SHARE:g}].",
        ),
    ] = None
    enhance_contrast: Annotated[
        bool,
        Option(
            "--enhance-contrast",
            help="Equalize the stereo head's pictures first, as the thesis does; not for clinical use.",
        ),
    ] = False
    measure_targets: Annotated[
        bool,
        Option("--measure-targets", help="On a phantom: measure a ball at each target, before the guide."),
    ] = False
    intraoperative: Annotated[
        bool,
        Option(
            "--intraoperative",
            help="Scan the clamped head, and take the spheres' places from that scan: --sim makes it, with "
            "--config its series is put into intraoperative/ct of the case when the step asks for it.",
        ),
    ] = False
    tracker: Annotated[
        TrackerChoice,
        Option(
            help="With --sim: polaris for the unit itself; plus for its tools as PlusServer sends them, with "
            "--fiducials xframe or surface."
        ),
    ] = TrackerChoice.POLARIS
    speed: Annotated[SpeedChoice, Option(help="max: as fast as the devices go; 1: real time.")] = (
        SpeedChoice.MAX
    )
    dual: Annotated[
        bool,
        Option(
            "--dual",
            help="With two calibrated arms: an assistant inserts the instrument through the master's guide. "
            "--config must name [robot.assistant] and the records of both.",
        ),
    ] = False
    assistant_arm: Annotated[
        ArmChoice, Option(case_sensitive=False, help="With --sim --dual: the model of the assistant.")
    ] = ArmChoice.KR6
    drill: Annotated[
        bool,
        Option(
            "--drill",
            help="With --sim --dual: the assistant drills the skull before it inserts. With --config, "
            "assistant_drills of the theatre file says so.",
        ),
    ] = False
    faults: Annotated[Path | None, Option(help="Fault script for the simulated theatre.")] = None
    keep_raw: Annotated[
        bool,
        Option(
            "--keep-raw", help="Pictures, tracker frames and arm states as files in RUN/raw, at most 2 GB."
        ),
    ] = False
    out: Annotated[Path, Option(help="Folder for runs; each run makes one subfolder.")] = Path("runs")

    @property
    def choice(self) -> SceneChoice:
        """Scene choices for generating the simulated theatre and phantom."""
        return replace(
            super().choice,
            markers=self.markers,
            targets=self.targets,
            fiducials=self.fiducials.value,
            tracker=self.tracker.value,
            assistant_arm=self.assistant_arm.value,
            drill=self.drill,
        )

    def request(self) -> RunRequest:
        """Return the requested run. Raises CLI-001 for conflicting options, PRO-026 for a bad answer file."""
        if self.config is not None and not self.sim and self.case is None:
            raise UsageMistake("--config needs --case", action="Give the folder with ct/ and plan.toml.")
        self.check()
        if self.config is None and self.case is not None:
            raise UsageMistake("--case requires --config", action="A simulated case brings its own patient.")
        if not self.dual and (given := self._list_changed_options(("assistant_arm", "drill"))):
            raise UsageMistake(
                f"{given} requires --dual",
                expected="a case with two arms",
                got=self.assistant_arm if "--assistant-arm" in given else None,
                action=f"Add --dual, or omit {given}.",
            )
        if self.config is not None and self.plan is not None:
            raise UsageMistake("--plan requires --sim", action="With --config the plan is in --case DIR.")
        procedure = CaseProcedure(
            strategy=self.strategy,
            methods=self._methods(),
            measure_targets=self.measure_targets,
            intraoperative=self.intraoperative,
            case=self.case,
            plan=self.plan,
            keep_raw=self.keep_raw,
            roles=roles_of(dual=self.dual),
        )
        return RunRequest(
            procedure=procedure,
            config=self.config,
            choice=self.choice,
            speed=self.speed.value,
            faults=self.faults,
            ask=self.ask,
            answers=self.read_answer_file(),
        )

    def _methods(self) -> CaseMethods:
        """Return the methods of the case. Raises CLI-001 for settings of a matcher that is not chosen."""
        given = self._list_changed_options(("matcher_e_mm", "matcher_refused_share"))
        if given and self.matcher is not Matcher.THESIS:
            raise UsageMistake(
                f"{given} belongs to the thesis' matcher",
                expected="--matcher thesis",
                got=f"--matcher {self.matcher}",
                action="Add --matcher thesis, or omit it.",
            )
        return CaseMethods(
            localizer=self.localizer,
            matcher=self.matcher,
            e_mm=E_MM if self.matcher_e_mm is None else self.matcher_e_mm,
            refused_share=REFUSED_SHARE if self.matcher_refused_share is None else self.matcher_refused_share,
            enhance_contrast=self.enhance_contrast,
            start=self.start,
        )


@dataclass(frozen=True)
class LinkOptions:
    """Options for links to other programs that only watch the case."""

    openigtlink: Annotated[
        str | None,
        Option(
            metavar="HOST:PORT",
            help="Let 3D Slicer and others watch the case, as ronna-link does; for example 127.0.0.1:18944.",
        ),
    ] = None

    archive: Annotated[
        str | None,
        Option(
            metavar="PEER",
            help="With --sim: the CT passes through this archive, AETITLE@HOST:PORT; results go there.",
        ),
    ] = None
    archive_port: Annotated[
        int, Option(min=1, max=65535, help="Own port at which that archive reaches the AE title RONNA.")
    ] = 11112

    def through_archive(self, case: CaseOptions) -> Archive | None:
        """Return the archive of a rehearsal, which answers. Raises CLI-001, DCM-001 to DCM-007."""
        if self.archive is None:
            return None
        if not case.sim:
            raise UsageMistake(
                "--archive is for a rehearsal",
                expected="--sim",
                action="On real devices fetch the CT and send the results with ronna-dicom.",
            )
        from procedures.runs.archive import Archive

        archive = Archive.parse(self.archive, self.archive_port)
        archive.check()
        return archive

    def served_at(self) -> LinkAddress | None:
        """Return the address of the OpenIGTLink server. Raises LIV-011 if it cannot be used."""
        if self.openigtlink is None:
            return None
        from procedures.runs.openigtlink import LinkAddress

        address = LinkAddress.parse(self.openigtlink)
        address.check()
        return address


@dataclass(frozen=True)
class ConsoleOptions:
    """Options for the browser console, including access from other computers."""

    console: Annotated[
        bool, Option("--console", help="Serve a page on this computer that shows and operates the case.")
    ] = False
    console_port: Annotated[
        int, Option(min=0, max=65535, help="Port of the page of --console; 0: any free one.")
    ] = 0
    bind: BindOption = None
    certificate: CertificateOption = None
    key: KeyOption = None

    def request(self) -> ConsoleRequest | None:
        """Return the requested console. Raises PRO-040 if not installed, CLI-001 for invalid options."""
        if not self.console:
            if given := self._list_page_options():
                raise UsageMistake(
                    f"{given} belongs to the page that --console serves",
                    expected="--console",
                    action=f"Add --console, or omit {given}.",
                )
            return None
        from procedures.runs.console_link import ConsoleRequest, check_console, check_port

        check_console()
        check_port(self.console_port)
        viewers = viewers_address(self.bind, self.certificate, self.key)
        for warning in () if viewers is None else viewers.check():
            tell(f"warning: {warning}")
        return ConsoleRequest(self.console_port, viewers)

    def _list_page_options(self) -> str:
        page = {
            "--console-port": self.console_port,
            "--bind": self.bind,
            "--certificate": self.certificate,
            "--key": self.key,
        }
        return ", ".join(option for option, value in page.items() if value)
