"""`ronna-procedure recover-log`: sealed copies of logs."""

from __future__ import annotations

from pathlib import Path

from procedures.live.errors import NO_LOG
from procedures.live.flight_log import log_files
from procedures.live.log_reading import recover_log
from procedures.runs.folders import require_run
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.options import require_new
from ronna_hw.command_line.terminal import print_json, tell
from ronna_hw.evidence.journal_reading import JOURNAL_FILE

EXPORT_FOLDER = "export"  # of a run: no part of its evidence


def recover_logs(source: Path, out: Path | None, *, as_json: bool) -> None:
    """Copy one log, or every log of a run. Raises CLI-001, CLI-005, LIV-003, LIV-004, LIV-005."""
    files = _find_logs(source)
    if out is not None and len(files) > 1:
        raise UsageMistake(
            f"{source.name} has {len(files)} logs, one for each program that had the run",
            action=f"Name one of them, such as {files[0]}, or omit --out.",
        )
    if out is not None:
        require_new(out)
    recovered = [recover_log(file, _choose_output(file) if out is None else out) for file in files]
    if as_json:
        print_json({"logs": [{**one._asdict(), "path": str(one.path)} for one in recovered]})
        return
    for one in recovered:
        state = "it was whole" if one.was_whole else "it had no end"
        tell(f"{one.path}: {one.messages} messages over {one.duration_s:.1f} s of theatre time; {state}")


def _find_logs(source: Path) -> list[Path]:
    if source.is_file():
        return [source]
    require_run(source)
    if not (files := log_files(source)):
        raise NO_LOG(f"{source} has no log")
    return files


def _choose_output(file: Path) -> Path:
    if not (file.parent / JOURNAL_FILE).exists():
        return file.with_name(f"{file.stem}-recovered{file.suffix}")
    folder = file.parent / EXPORT_FOLDER
    folder.mkdir(exist_ok=True)
    return folder / file.name
