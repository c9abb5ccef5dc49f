"""The modules of a user method: its own, and those of its folder or package that it imports, even lazily."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from modulefinder import Module, ModuleFinder
from pathlib import Path
from types import ModuleType

OURS = (
    "ronna_hw",
    "conformance",
    "drivers",
    "sim",
    "procedures",
    "studies",
    "console",
)  # a run records their version
INSTALLED = ("site-packages", "dist-packages")


def is_installed(file: Path) -> bool:
    """Whether a file belongs to an installed package."""
    return not {*INSTALLED}.isdisjoint(file.parts)


def modules_beside(module: ModuleType) -> Mapping[str, Path]:
    """The file of each module by name, from the import statements; nothing is executed.

    For an installed module, those of its package count; for a file of the user's own, those of its folder and
    their packages. Anything imported by a computed name, compiled or read as data is not found.
    """
    if module.__file__ is None:
        return {}
    file = Path(module.__file__).resolve()
    depth = module.__name__.count(".") + (file.stem == "__init__")
    finder = _Beside(file.parents[depth], module.__name__.partition(".")[0] if is_installed(file) else None)
    finder.import_hook(module.__name__)
    found = {name: vars(one)["__file__"] for name, one in finder.modules.items()}
    return {name: Path(path) for name, path in found.items() if path is not None} | {module.__name__: file}


def hash_of(module: ModuleType) -> str:
    """SHA-256 of the module's file, or of all files if there are more; empty for a module without a file."""
    files = modules_beside(module)
    hashes = {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()}
    if len(hashes) < 2:
        return "".join(hashes.values())
    lines = "".join(f"{sha256}  {name}\n" for name, sha256 in sorted(hashes.items()))
    return hashlib.sha256(lines.encode()).hexdigest()


class _Beside(ModuleFinder):
    def __init__(self, folder: Path, only: str | None) -> None:
        """`only` is the package outside which nothing counts."""
        super().__init__(path=[str(folder)])
        self._only = only

    def import_module(self, partname: str, fqname: str, parent: Module) -> Module | None:
        package = fqname.partition(".")[0]
        if package in OURS or self._only not in (None, package):
            return None
        return super().import_module(partname, fqname, parent)
