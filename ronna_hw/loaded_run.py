"""A finished, interrupted or running case as NumPy record arrays: `load_run` and what it returns.

    from ronna_hw import load_run

    run = load_run("runs/20261126T165631-s7-5191")
    print(run.targets.name, run.targets.error_mm)

The reader of run folders belongs to the procedures. It is found by its entry point, as drivers are.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ronna_hw.arguments import WrongArgument, require_path
from ronna_hw.errors import ConfigurationError, ErrorCode
from ronna_hw.frames import Transform
from ronna_hw.near_names import find_near
from ronna_hw.notebook_html import format_value, table_html
from ronna_hw.registry import load_entry_point

if TYPE_CHECKING:
    import pandas as pd

GROUP = "ronna_hw.runs"
READER = "run_folder"  # name of the entry point
AXES = {2: "xy", 3: "xyz", 4: "wxyz"}  # names in a pandas column; more numbers are those of joints
QUATERNION = "wxyz"  # unit in the name of one, which names its axes already


NO_RUN_READER = ErrorCode(
    "RUN-001",
    ConfigurationError,
    "No installed package reads run folders.",
    "Run make setup in the clone, which installs the packages again with their entry points.",
)


NO_PANDAS = ErrorCode(
    "RUN-002",
    ConfigurationError,
    "A table was requested for pandas, which is not installed.",
    "Run make setup in the clone, or python -m pip install pandas; the arrays need nothing else.",
)


class RunWarning(UserWarning):
    """A loaded run is not as it was left, or readings are missing in a table that was just read."""


@dataclass(frozen=True)
class RunColumn:
    """Column of a table: its unit is in the name, and the frame of a position before it."""

    name: str
    kind: type | str  # float: NaN where unknown; str: empty; a NumPy type
    description: str
    size: tuple[int, ...] = ()  # of one entry: (3,) for a vector

    @property
    def pandas_names(self) -> list[str]:
        """Names of the plain columns for pandas, such as `target_ct_x_mm`."""
        if not self.size:
            return [self.name]
        stem, _, unit = self.name.rpartition("_")
        tail = "" if unit == QUATERNION else f"_{unit}"
        names = (AXES.get(n) or [f"A{axis}" for axis in range(1, n + 1)] for n in self.size)
        return [f"{stem}_{''.join(axes)}{tail}" for axes in itertools.product(*names)]


class RunRow(np.record):  # type: ignore[misc]  # final in the stubs of NumPy alone
    """Row of a table, with its columns as attributes."""

    def __repr__(self) -> str:
        shown = (f"{name}={_in_line(self[name])}" for name in self.dtype.names or ())
        return f"<row: {', '.join(shown)}>"

    def _repr_html_(self) -> str:
        """Return the row as a notebook shows it: one line for each column."""
        names = self.dtype.names or ()
        return table_html(("column", "value"), ((name, self[name]) for name in names), len(names))


class RunTable(np.recarray[Any, np.dtype[np.void]]):
    """Record array with described columns: `table.error_mm`, `table[table.name == "T1"]`, `table[0]`."""

    columns: tuple[RunColumn, ...] = ()

    @classmethod
    def of(cls, columns: tuple[RunColumn, ...], rows: Iterable[Sequence[object]]) -> RunTable:
        """Build a table from its rows, with one value per column."""
        listed = [tuple(row) for row in rows]
        types = [(one.name, _find_type(one, listed, number), one.size) for number, one in enumerate(columns)]
        table: RunTable = np.array(listed, dtype=types).view(cls)
        table.columns = columns
        return table

    def __getattr__(self, name: str) -> Any:
        """Raise AttributeError naming the columns there are, and the nearest."""
        raise AttributeError(self._describe_missing(name), name=name, obj=self)

    def __getitem__(self, key: Any) -> Any:
        """Return a column by name, a row by number, or rows. Raises ARG-001 for a name that is no column."""
        if isinstance(key, str) and key not in (self.dtype.names or ()):
            what = self._describe_missing(key)
            raise WrongArgument(what, action='Rows by name: table[table.name == "T1"].')
        found = super().__getitem__(key)
        return found.view((RunRow, found.dtype)) if type(found) is np.record else found

    def _describe_missing(self, name: str) -> str:
        names = self.dtype.names or ()
        meant = "".join(f"did you mean {one}? " for one in find_near(name, names))
        return f"no column {name}: {meant}There are {', '.join(names)}"

    def __array_finalize__(self, source: Any) -> None:
        super().__array_finalize__(source)
        self.columns = getattr(source, "columns", ())

    def _repr_html_(self) -> str:
        """Return the table as a notebook shows it."""
        names = self.dtype.names or ()
        rows = ([row[name] for name in names] for row in np.atleast_1d(self))
        return table_html(names, rows, self.size)

    def to_pandas(self) -> pd.DataFrame:
        """Return a pandas data frame, with one column per component of a vector. Raises RUN-002."""
        try:
            import pandas as pd
        except ImportError as error:
            raise NO_PANDAS("pandas is not installed") from error
        plain: dict[str, Any] = {}
        for column in self.columns:
            names = column.pandas_names
            values = np.asarray(self[column.name]).reshape(len(self), len(names))
            plain.update(zip(names, values.T, strict=True))
        return pd.DataFrame(plain)


def _find_type(column: RunColumn, rows: Sequence[Sequence[object]], number: int) -> object:
    if column.kind is not str:
        return column.kind
    return f"U{max((len(str(row[number])) for row in rows), default=1) or 1}"


class StereoPictures(NamedTuple):
    """Grey values of one stereo look as recorded; None for a side that did not arrive."""

    left: NDArray[np.uint8] | NDArray[np.uint16] | None
    right: NDArray[np.uint8] | NDArray[np.uint16] | None

    def __repr__(self) -> str:
        sides = (f"{side} {_describe_pixels(pixels)}" for side, pixels in self._asdict().items())
        return f"<StereoPictures: {', '.join(sides)}>"


def _in_line(value: Any) -> str:
    return f"({format_value(value)})" if isinstance(value, np.ndarray) else format_value(value) or str(value)


def _describe_pixels(pixels: NDArray[Any] | None) -> str:
    if pixels is None:
        return "did not arrive"
    height, width = pixels.shape
    return f"{width} x {height} px {pixels.dtype}"


class RunRegistration(Protocol):
    """Registration used for a target, in the CT. A notebook shows its picture with the residuals."""

    @property
    def record(self) -> str:
        """Its record in the run folder."""

    @property
    def robot_from_ct(self) -> Transform:
        """Pose of the CT in the robot frame, of the head as registered: the same for all its targets."""

    @property
    def sent_robot_from_ct(self) -> Transform:
        """Pose by which the arm is sent to this target: the same, with the correction learned for it.

        Its inverse maps what the arm's joints report there into the CT.
        """

    @property
    def fre_mm(self) -> float:
        """Fiducial registration error; not a measure of accuracy."""

    @property
    def spheres(self) -> RunTable:
        """Spheres in the CT: expected and found centre, and the residual."""

    @property
    def picture(self) -> bytes:
        """PNG of the spheres in three projections of the CT, with deviations drawn larger than they are."""


class LoadedRun(Protocol):
    """Run folder as arrays. Each table is read on first use; docs/reference/api-runs.md lists the columns.

    Positions are in mm, in the frame that their name says: `ct` (DICOM LPS), `robot`, `tracker`.
    """

    path: Path

    @property
    def name(self) -> str:
        """Name of the run."""

    @property
    def outcome(self) -> str:
        """Ending of the run, such as done, missed, in doubt, not sealed or failed; or that it is running."""

    @property
    def reason(self) -> str:
        """Reason for which the run is not done, with the code of its error; empty for a run that is."""

    @property
    def scene(self) -> str:
        """Scene of its simulated theatre, or the scene file; empty on devices, and if no request is there."""

    @property
    def seed(self) -> int | None:
        """Seed of its simulated theatre; None on devices."""

    @property
    def strategy(self) -> str:
        """Strategy that was asked for; `targets.strategy` is the one used. Empty if it is no case."""

    @property
    def faults(self) -> tuple[str, ...]:
        """Lines of its fault script; what was injected later is among the events of the theatre alone."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Files that are missing or have changed since the run ended, as `ronna-procedure verify` lists them.

        That no seal confirms them is noted too, and readings missing in a table once it is read. What is
        noted for a finished run is also a RunWarning.
        """

    @property
    def targets(self) -> RunTable:
        """Trajectories of the plan: planned and reached positions, predicted error, error against truth."""

    @property
    def spheres(self) -> RunTable:
        """Spheres found in the CT."""

    @property
    def localized(self) -> RunTable:
        """Spheres localized by the stereo head in the robot frame, by trajectory."""

    @property
    def registrations(self) -> RunTable:
        """Registrations of the CT to the robot."""

    @property
    def budget(self) -> RunTable:
        """Error budget of each target's prediction: one row per source of error."""

    @property
    def strays(self) -> RunTable:
        """Stray markers in each new frame of the tracker, with an identity over the frames."""

    @property
    def looks(self) -> RunTable:
        """Image pairs of the stereo head."""

    @property
    def pictures(self) -> Sequence[StereoPictures]:
        """Images of each row of `looks`, read when they are asked for."""

    @property
    def motions(self) -> RunTable:
        """Motions of the arms."""

    @property
    def events(self) -> RunTable:
        """Events of the run, as a console shows them. Raises PRO-018 if a line of their file is damaged."""

    @property
    def plan(self) -> Any:
        """Plan of the case as it was checked, a `procedures.planning.plan_model.Plan`; None before that."""

    def robot_from_ct(self, target: str) -> Transform:
        """Return the head's pose as registered for a target. Raises EXC-005 if it has none.

        By `registration(target).sent_robot_from_ct` the arm is sent there, if errors were learned of it.
        """

    def registration(self, target: str) -> RunRegistration:
        """Return the registration used for a target and its spheres in the CT. Raises EXC-005."""

    def stream(self, topic: str) -> RunTable:
        """Return a topic of the run's log, such as `/measured_js`, `/measured_cp` or `/tf`, as a table.

        Raises LIV-005 for a run without a log, ARG-001 for a topic that is not in it.
        """


class RunReader(Protocol):
    """Target of the entry point: opens the folder of one run."""

    def __call__(self, folder: Path) -> LoadedRun: ...


def load_run(folder: str | os.PathLike[str]) -> LoadedRun:
    """Open the folder of one run for reading: finished, interrupted, or still running.

    All its files are compared with the hashes of the run. Raises CLI-005 if it is not the folder of a run,
    PRO-033 if its journal, its request or a record was changed; other changes are in `notes`, and warn. A
    table that another version wrote differently raises REC-003 when it is read, and that of the events
    PRO-018 if a line of their file is damaged. Raises ARG-001 for an empty name and for what is no path.
    """
    path = require_path(folder, "the folder of the run")
    for point in entry_points(group=GROUP):
        if point.name == READER:
            reader: RunReader = load_entry_point(point)
            return reader(path)
    raise NO_RUN_READER(
        "no reader of run folders is installed", expected=f"an entry point {READER} in {GROUP}"
    )
