"""Unsealed files of a killed and resumed run, unverified since the kill.

The next seal also covers the log of the killed program, and would hide that it could have been changed in
between. So the journal lists the files that lay there without a seal.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import PurePosixPath

from ronna_hw.evidence.inspection import Inspection
from ronna_hw.evidence.journal_reading import Line
from ronna_hw.evidence.lost_journal_end import describe_former_losses, describe_restart
from ronna_hw.evidence.manifest import (
    LOG_FILES,
    TRUTH_FILES,
    WORLD_FILE,
    is_sealed,
    is_written_later,
    iterate_files,
)
from ronna_hw.records import PARTIAL
from ronna_hw.text import format_count, printable

UNSEALED = "unsealed"  # in a `restarted` line: name -> bytes, None for a missing file
REPORT = "report"  # made anew at every end


def unsealed(found: Inspection) -> dict[str, int | None]:
    """Return files, with lengths, confirmed by neither journal nor seal, except those already reported.

    Missing files that every closed run leaves have None as length.
    """
    if not found.chain.lines:
        return {}
    manifest = found.manifest
    known = {*found.not_as_left, *manifest.unvouched_files}
    if is_sealed(found.folder):
        doubtful = {issue.file for issue in found.problems if is_written_later(issue.file)}
    else:
        doubtful = {name for name, _ in iterate_files(found.folder)}
        known.update(manifest.files if found.chain.is_closed else manifest.lasting_files, manifest.request)
        known.update(manifest.records, manifest.pictures, manifest.result_inputs, manifest.truth)
    present = dict(iterate_files(found.folder))
    sizes: dict[str, int | None] = {
        name: path.lstat().st_size
        for name, path in present.items()
        if name in doubtful - known and not name.startswith(REPORT) and not name.endswith(PARTIAL)
    }
    if not found.chain.is_closed or is_sealed(found.folder):
        return sizes
    is_simulated = not manifest.files.keys().isdisjoint(TRUTH_FILES)
    expected = (*LOG_FILES, WORLD_FILE) if is_simulated else LOG_FILES
    return sizes | dict.fromkeys(name for name in expected if name not in present)


def describe_unconfirmed_files(found: Inspection) -> Iterator[str]:
    """Describe, in sentences, the unverified files of a run whose last end has no seal."""
    if found.chain.lines and not is_sealed(found.folder) and (files := unsealed(found)):
        named = ", ".join(_name_files(files))
        yield f"not vouched for: {named}: the run has no seal, and a change since would not show"


def describe_unsealed_files(lines: tuple[Line, ...]) -> Iterator[str]:
    """Describe, in sentences, files and lost lines that the seal covers without vouching for them."""
    yield from describe_former_losses(lines)
    for number, line in enumerate(lines):
        files = line.get(UNSEALED)
        if isinstance(files, Mapping) and files:
            yield (
                f"not vouched for: {', '.join(_name_files(files))} had no seal when "
                f"{describe_restart(line)} after line {number} of its journal; a change before that "
                "would not show"
            )


def _name_files(files: Mapping[str, object]) -> Iterator[str]:
    """List files by name, giving only a count where a folder has several."""
    folders: dict[str, list[str]] = {}
    for name in map(str, files):
        folders.setdefault(str(PurePosixPath(name).parent), []).append(name)
    for folder, names in folders.items():
        if len(names) > 1 and folder != ".":
            yield f"{printable(folder)} ({format_count(len(names), 'file')})"
        else:
            yield from (f"{printable(name)} ({_describe_size(files[name])})" for name in names)


def _describe_size(size_bytes: object) -> str:
    return "missing" if size_bytes is None else f"{size_bytes} bytes"
