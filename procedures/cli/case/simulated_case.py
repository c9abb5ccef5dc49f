"""A simulated theatre with its patient, started as commands: what `--sim` means and nothing more."""

from __future__ import annotations

import subprocess
from pathlib import Path
from types import TracebackType
from typing import Self

from procedures.cli.case.scene_choice import SceneChoice
from procedures.cli.case.simulated_theatre import SimulatedTheatre
from procedures.engine.errors import CommandRefused
from ronna_hw.host.child_process import ChildNotReady, command

PHANTOM_TIMEOUT_S = 120.0  # host time; a full series takes a few seconds


class SimulatedCase:
    """Theatre and phantom in a run folder: `theatre/theatre.toml`, `case/ct/`, `case/plan.toml`."""

    def __init__(self, choice: SceneChoice, folder: Path, *, speed: str, faults: Path | None) -> None:
        self.series = folder / "case" / "ct"
        self.plan = folder / "case" / "plan.toml"
        script = () if faults is None else ("--faults", str(faults))
        self.theatre = SimulatedTheatre(
            *choice.arguments(), "--speed", speed, "--out", str(folder / "theatre"), *script
        )
        self._phantom = subprocess.Popen(
            command(
                "sim.cli", "phantom", "--with-parent", *choice.arguments(), "--out", str(folder / "case")
            ),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def await_patient(self) -> None:
        """Return when the CT series and the plan are written; raises PRO-013 with the command's words.

        PRC-001 when they are not in time.
        """
        try:
            _, messages = self._phantom.communicate(timeout=PHANTOM_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            raise ChildNotReady(
                "ronna-sim phantom did not end", expected="the phantom CT", limit=f"{PHANTOM_TIMEOUT_S:g} s"
            ) from None
        if self._phantom.returncode != 0:
            raise CommandRefused("ronna-sim phantom", messages, self._phantom.returncode)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._phantom.poll() is None:
            self._phantom.kill()
            self._phantom.wait()
        if self._phantom.stderr is not None:
            self._phantom.stderr.close()
        fallen = self.theatre.stop()
        if fallen is not None and error is not None:
            raise fallen from error  # what the procedure met is only the consequence
