"""A whole simulated theatre in one line: the command `ronna-sim theatre` for the length of a block.

    with simulated_theatre("mini", seed=7) as theatre:
        ...

Nothing is imported from the simulators: the theatre is opened with the file that the command writes.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self

from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.host.interruption import interruption_deferred
from ronna_hw.theatre import Theatre

NAME = "ronna-sim theatre"
CONTROLLER_SAYS = "pendant at "  # prefix of a message on the simulated controller's pendant


class TheatreProcess:
    """`ronna-sim theatre`, starting up; call `await_ready`, and `end` when done."""

    def __init__(
        self, *arguments: str, on_controller_message: Callable[[str], None] = lambda _line: None
    ) -> None:
        """`on_controller_message` is called with each message on the simulated controller's pendant."""

        def on_message(line: str) -> None:
            if line.startswith(CONTROLLER_SAYS):
                on_controller_message(line)

        self.child = ChildProcess(
            NAME, command("sim.cli", "theatre", *arguments), timeout_s=None, on_message=on_message
        )

    def await_ready(self) -> None:
        """Return once every device is ready; raises PRC-001 with the command's own message."""
        self.child.await_ready()

    @property
    def file(self) -> Path:
        """The theatre file that was written."""
        return Path(self.child.ready["file"])

    @property
    def control(self) -> str:
        """Endpoint of the control port."""
        return str(self.child.ready["endpoints"]["control"])

    def end(self) -> None:
        """Bounded in time, never raises; an interruption in the meantime takes effect afterwards."""
        with interruption_deferred():
            self.child.stop()


class SimulatedTheatre(Theatre):
    """A theatre whose devices are simulated."""

    control: str = ""  # endpoint for `ronna-sim mount` and `ronna-sim fault`

    @classmethod
    def of(cls, process: TheatreProcess) -> Self:
        """The theatre of a ready process."""
        theatre = cls.from_file(process.file)
        theatre.control = process.control
        return theatre


@contextmanager
def simulated_theatre(
    scene: str = "mini", *, seed: int = 0, timeout_s: float = 10.0
) -> Iterator[SimulatedTheatre]:
    """Start a simulated theatre, connect and configure its devices, and end all of it with the block.

    `scene` is `default`, `mini`, `bench` or the path of a scene file. Raises PRC-001 with the command's own
    message when there is no such scene, and the errors of `open_theatre`.
    """
    with tempfile.TemporaryDirectory(prefix="ronna-theatre-") as folder:
        process = TheatreProcess("--scene", scene, "--seed", str(seed), "--out", folder)
        try:
            process.await_ready()
            with SimulatedTheatre.of(process) as theatre:
                theatre.connect(timeout_s)
                yield theatre
        finally:
            process.end()
