"""Compiled templates, kept beside their sources as Python keeps its modules."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path

import jinja2
from jinja2.bccache import Bucket

FOLDER = "__pycache__"


class CompiledTemplates(jinja2.FileSystemBytecodeCache):
    """Cache of compiled templates that counts only for this source, this environment and this Jinja."""

    def __init__(self, templates: Path, environment: Path) -> None:
        """Keep what the folder `templates` holds; `environment` is the module that sets its options."""
        self._folder = templates / FOLDER
        self._compiled_by = f"{jinja2.__version__}\n{environment.read_text(encoding='utf-8')}"
        super().__init__(str(self._folder))

    def get_source_checksum(self, source: str) -> str:
        """Return a checksum of a template and of everything that its compiled form depends on."""
        return super().get_source_checksum(self._compiled_by + source)

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Keep a compiled template; one that cannot be kept is compiled again by the next program."""
        if sys.dont_write_bytecode:
            return
        with contextlib.suppress(OSError):  # an installation that is read only
            self._folder.mkdir(exist_ok=True)
            super().dump_bytecode(bucket)
