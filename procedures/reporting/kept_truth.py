"""The truth stored with a run: what the verifier of its simulated theatre found, as the seal confirms it.

It says whether a target was missed. So it is evidence: nobody shows or judges it unless the seal names it.
"""

from __future__ import annotations

import contextlib
import hashlib
from pathlib import Path

from procedures.reporting.outcome import Truth
from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.evidence.manifest import KEPT_TRUTH, find_valid_seal
from ronna_hw.records import write_atomically


def store_truth(run: Path, truth: Truth) -> Path:
    """Store the verifier's result in a run folder, for the next seal."""
    path = run / KEPT_TRUTH
    path.parent.mkdir(exist_ok=True)
    content = (truth.model_dump_json(indent=1) + "\n").encode()
    if not path.is_file() or path.stat().st_size != len(content) or path.read_bytes() != content:
        write_atomically(path, content)  # else nothing is: a finished run may lie where nobody can write
    return path


def load_truth(run: Path) -> Truth | None:
    """Load the result that this program has stored and seals next, or None if missing or unreadable."""
    return _parse(_read(run))


def load_sealed_truth(run: Path) -> Truth | None:
    """Load the stored result, or return None unless the seal confirms it."""
    content, seal = _read(run), find_valid_seal(run)
    if content is None or seal is None:
        return None
    return _parse(content) if seal.files.get(KEPT_TRUTH) == hashlib.sha256(content).hexdigest() else None


def drop_unsealed_truth(run: Path) -> bool:
    """Remove a stored result that no seal confirms, since the next seal would cover it."""
    path, seal = run / KEPT_TRUTH, find_valid_seal(run)
    named = None if seal is None else seal.files.get(KEPT_TRUTH)
    content = _read(run)
    if content is not None and named == hashlib.sha256(content).hexdigest():
        return False
    with contextlib.suppress(OSError):  # what is no file is not read either
        path.unlink()
        return True
    return False


def _read(run: Path) -> bytes | None:
    try:
        return read_json_bytes(run / KEPT_TRUTH)
    except (OSError, ValueError):
        return None


def _parse(content: bytes | None) -> Truth | None:
    try:
        return None if content is None else Truth.model_validate_json(content)
    except ValueError:
        return None
