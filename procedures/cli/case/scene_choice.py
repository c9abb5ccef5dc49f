"""What a simulated theatre and its phantom are drawn from."""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from ronna_hw.bounded_input import InputRefused, parse_json, read_json_bytes, read_toml
from ronna_hw.command_line.errors import UsageMistake

NAMED = ("default", "mini")  # of the scenes that ronna-sim knows, those with a patient
LARGEST_SEED = 2**63 - 1  # what a journal's JSON keeps exactly everywhere

FREE = "free"  # screws of their own


@dataclass(frozen=True)
class SceneChoice:
    """What the theatre and the phantom are drawn from; both get the same."""

    scene: str = "default"
    seed: int = 0
    markers: int | None = None
    targets: int | None = None
    fiducials: str = FREE  # what the spheres stand on
    calibrated: bool = False  # the arm of the theatre, with a record of it; the patient is the same
    first_day: bool = False  # frame and guide of the theatre are as drawn, without valid records
    records: tuple[Path, ...] = ()  # folders of calibrations, instead of the theatre's own records

    def check(self) -> None:
        """Raise CLI-001 for a scene that is neither named nor a file; what is in a file, its reader says."""
        if self.scene not in NAMED and not Path(self.scene).is_file():
            alike = get_close_matches(self.scene, NAMED, n=1)
            raise UsageMistake(
                f"there is no scene {self.scene!r}",
                expected=f"{' or '.join(NAMED)}, which have a patient, or the path of a scene file",
                action=f"Did you mean {alike[0]}?" if alike else "ronna-sim scene prints one to start from.",
            )

    def arguments(self) -> list[str]:
        """As options of `ronna-sim theatre` and `ronna-sim phantom`."""
        options = ["--scene", self.scene, "--seed", str(self.seed)]
        for name, value in (("--markers", self.markers), ("--targets", self.targets)):
            if value is not None:
                options += [name, str(value)]
        return options if self.fiducials == FREE else [*options, "--fiducials", self.fiducials]

    def theatre_arguments(self) -> list[str]:
        """Those and what only the theatre is to know."""
        options = self.arguments()
        if self.calibrated:
            options.append("--calibrated")
        if self.first_day:
            options.append("--first-day")
        for folder in self.records:
            options += ["--calibration", str(folder)]
        return options

    @property
    def own_seed(self) -> int:
        """Seed of what is drawn: a scene file holds its own. Whether the file is good, its reader says."""
        path = Path(self.scene)
        if not path.suffix:
            return self.seed
        try:
            is_json = path.suffix == ".json"
            content = parse_json(read_json_bytes(path)) if is_json else read_toml(path, InputRefused)
            return int(content.get("seed", 0))
        except (OSError, ValueError, AttributeError, TypeError, OverflowError):
            return self.seed
