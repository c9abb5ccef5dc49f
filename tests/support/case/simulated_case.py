"""A whole simulated case in a folder of its own: how a command runs it, and what it left."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path

import tomli_w
from user_commands import Commands

from procedures.journal.journal import JOURNAL_FILE, Line, read_journal
from sim.world.scene.model import Scene

LIMIT_S = 500.0  # host time of a whole case, on a busy computer


def write_scene(scene: Scene, path: Path) -> str:
    """Write a scene as a user would, and return its path for a command."""
    path.write_text(tomli_w.dumps(scene.model_dump(mode="json", by_alias=True, exclude_none=True)))
    return str(path)


@dataclass(frozen=True)
class SimulatedCase:
    """Commands that run a case in a folder; scene, faults and answers are files beside its runs."""

    commands: Commands
    folder: Path

    def run(
        self, *words: str, scene: Scene | None = None, faults: str = "", answers: str = ""
    ) -> subprocess.CompletedProcess[str]:
        """Run `ronna-procedure run --sim WORDS --json` to its end."""
        files = self.options(scene=scene, faults=faults, answers=answers)
        line = ("run", "--sim", *words, *files, "--json")
        return self.commands.run("ronna-procedure", *line, timeout_s=LIMIT_S)

    def step(
        self, *orders: str, words: tuple[str, ...], faults: str = "", answers: str = ""
    ) -> subprocess.CompletedProcess[str]:
        """Run `ronna-procedure step --sim WORDS` with these orders on its standard input."""
        files = self.options(faults=faults, answers=answers)
        return subprocess.run(
            self.commands.line("ronna-procedure", "step", "--sim", *words, *files),
            env=self.commands.environment,
            input="".join(f"{order}\n" for order in orders),
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )

    def start_stepping(self, *orders: str, words: tuple[str, ...]) -> subprocess.Popen[str]:
        """Start `ronna-procedure step --sim WORDS` and give it its first orders."""
        line = ("ronna-procedure", "step", "--sim", *words, *self.options())
        process = self.commands.start(*line, stdin=subprocess.PIPE)
        assert process.stdin is not None
        process.stdin.writelines(f"{order}\n" for order in orders)
        process.stdin.flush()
        return process

    def options(self, *, scene: Scene | None = None, faults: str = "", answers: str = "") -> list[str]:
        """Write what is not empty to files, and return the options that name them and the runs."""
        words = ["--scene", write_scene(scene, self.folder / "scene.toml")] if scene else []
        for option, text, name in (
            ("--faults", faults, "faults.txt"),
            ("--answers", answers, "answers.toml"),
        ):
            if text:
                (self.folder / name).write_text(f"{text}\n")
                words += [option, str(self.folder / name)]
        return [*words, "--out", str(self.folder / "runs")]

    @property
    def run_folder(self) -> Path:
        """The folder of the only run."""
        (folder,) = (self.folder / "runs").iterdir()
        return folder

    @property
    def journal(self) -> list[Line]:
        return list(read_journal(self.run_folder / JOURNAL_FILE))
