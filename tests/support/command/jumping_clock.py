"""A wall clock that jumps in every Python process of a command, when the test says so.

Children find it on PYTHONPATH: what runs before anything of ours is imported shifts `datetime.now` and
`time.time`. The monotonic clock is left alone, as by whoever sets a computer's clock.
"""

from __future__ import annotations

from pathlib import Path

from user_commands import Commands

SHIFT_FILE = "SHIFT_S"  # in the environment: where the present shift in seconds is
PROGRAM = f'''
import datetime, os, time

true_datetime, true_time = datetime.datetime, time.time


def shift_s():
    with open(os.environ["{SHIFT_FILE}"]) as file:
        return float(file.read() or 0.0)


class datetime_(true_datetime):
    @classmethod
    def now(cls, tz=None):
        return true_datetime.now(tz) + datetime.timedelta(seconds=shift_s())


datetime_.__name__ = datetime_.__qualname__ = "datetime"
datetime.datetime = datetime_
time.time = lambda: true_time() + shift_s()
time.time_ns = lambda: int(time.time() * 1e9)
'''


class JumpingClock:
    """Of everything that `commands` starts from now on."""

    def __init__(self, commands: Commands, folder: Path) -> None:
        folder.mkdir()
        self._file = folder / "shift"
        self.jump_to(0.0)
        (folder / "sitecustomize.py").write_text(PROGRAM)
        commands.environment |= {"PYTHONPATH": str(folder), SHIFT_FILE: str(self._file)}

    def jump_to(self, shift_s: float) -> None:
        """From now on the clock is ahead of the true one by so much."""
        new = self._file.with_suffix(".new")
        new.write_text(str(shift_s))
        new.replace(self._file)
