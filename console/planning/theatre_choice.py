"""Theatre files that a plan may be checked against. Pages know them by name; paths stay with the program."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from procedures.planning.errors import PLACE_UNFIT, HeadPlaceUnknown
from procedures.planning.proposed_place import read_place
from procedures.planning.theatre_arm import SixNumbers, TheatreArm, theatre_arm
from procedures.strategies.catalogue import find_strategy
from procedures.strategies.names import DEFAULT_STRATEGY
from ronna_hw.bounded_input import InputRefused, read_toml
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.errors import RonnaError

PLACE_FILE = "place.json"  # next to the plan, as in a case
MOST_FILES = 200  # of one folder: no laboratory has as many theatres


@dataclass(frozen=True)
class TheatreChoice:
    """Theatre files of a folder and the given one, and the pose of the head, if it is known."""

    folder: Path
    plan: Path
    given: Path | None = None
    strategy: str = DEFAULT_STRATEGY
    robot_from_ct: SixNumbers | None = None  # mm and deg; otherwise that of the cart's proposed place
    home_deg: SixNumbers | None = None

    def list_files(self) -> dict[str, Path]:
        """Return the theatre files by name, the given one first."""
        found = {} if self.given is None else {self.given.name: self.given}
        for path in sorted(self.folder.glob("*.toml"))[:MOST_FILES]:
            if path.name not in found and _is_theatre(path):
                found[path.name] = path
        return found

    def load_known(self, series_instance_uid: str) -> tuple[str, TheatreArm, str] | None:
        """Load the given file, or else the only listed one, as `load` does.

        Return None without a pose of the head, with several files to choose from, or if the only one is
        unfit.
        """
        names = list(self.list_files())
        if self.given is None and len(names) != 1:
            return None
        try:
            return self.load(names[0], series_instance_uid)
        except HeadPlaceUnknown:
            return None
        except RonnaError:
            if self.given is not None:
                raise
            return None  # nobody has asked for it; whoever chooses it at the page is told why

    def load(self, name: str, series_instance_uid: str) -> tuple[str, TheatreArm, str]:
        """Read the arm of a listed file. Return its name, the arm, and in words where the head is.

        Raises CFG-001 and its like for an unfit file, PLAN-022 for a place of another CT, PLAN-032 for none.
        """
        path = self.list_files().get(name)
        if path is None:
            raise UsageMistake(f"there is no theatre file {name} any more", action="Choose another file.")
        pose, words = self._find_pose(series_instance_uid)
        return name, theatre_arm(path, pose, self.home_deg, find_strategy(self.strategy)), words

    def _find_pose(self, series_instance_uid: str) -> tuple[SixNumbers, str]:
        if self.robot_from_ct is not None:
            return self.robot_from_ct, "head where it was given when the planner was started"
        found = read_place(self.plan.with_name(PLACE_FILE))
        if found is None:
            raise HeadPlaceUnknown("reach was not checked: it is not known where the head will be")
        if found.place.series_instance_uid != series_instance_uid:
            raise PLACE_UNFIT(f"{PLACE_FILE} next to the plan belongs to another CT")
        return found.place.robot_from_ct, "cart at the place proposed for it"


def _is_theatre(path: Path) -> bool:
    """Return whether a TOML file has a theatre's table; whether it is usable is told when it is loaded."""
    try:
        return "theatre" in read_toml(path, InputRefused)
    except (OSError, InputRefused):
        return False
