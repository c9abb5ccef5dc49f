"""References to user methods, small enough to send to workers, which refuse to run another version.

The version is the hash of the method's module and of the modules of its folder or package that it imports.
"""

from __future__ import annotations

import hashlib
import importlib
import inspect
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import entry_points
from modulefinder import Module, ModuleFinder
from pathlib import Path
from types import ModuleType
from typing import Any

from ronna_hw.near_names import find_near
from studies.errors import MethodRefused
from studies.plugins.contracts import CONTRACTS, MethodKind

# A run records the version of these packages.
OURS = ("ronna_hw", "conformance", "drivers", "sim", "procedures", "studies", "console")
INSTALLED = ("site-packages", "dist-packages")
SHOWN_DIGITS = 12  # of a hash
FILE_ENDING = ".py"
MOST_NEAR = 3  # suggestions for a mistyped name
_loaded: dict[str, str] = {}  # module -> hash of the files loaded by this process


@dataclass(frozen=True)
class PluginMethod:
    """A `module:function` reference with its kind, its name in tables, and a hash of its files."""

    kind: MethodKind
    name: str
    reference: str
    sha256: str

    def function(self) -> Callable[..., Any]:
        """Load the function in this process; raises STU-012 if the file is missing or has changed."""
        found, module = _import_method(self.reference, self.kind)
        if hash_of(module) != self.sha256:
            raise MethodRefused(
                f"{self.reference} is a different version here from where the campaign was started",
                expected=f"files with hash {self.sha256[:SHOWN_DIGITS]}",
                got=f"{hash_of(module)[:SHOWN_DIGITS]} at {module.__file__}",
                action="Give every worker the same files, including those imported from the same folder.",
            )
        return found

    @property
    def source(self) -> Path | None:
        """File to send to remote workers, or None if the method is installed or part of a package."""
        module = sys.modules[self.reference.partition(":")[0]]
        if module.__file__ is None or "." in module.__name__:
            return None
        file = Path(module.__file__)
        return None if is_in_site_packages(file) else file


def find_plugin(kind: MethodKind, text: str) -> PluginMethod:
    """Find a method by entry point name, or as `module:function`. Raises STU-012.

    Modules are searched as Python does, and last in the current folder.
    """
    here = os.getcwd()
    if here not in sys.path:
        sys.path.append(here)
    reference = text if ":" in text else _reference_by_entry_point(kind, text)
    function, module = _import_method(reference, kind)
    _require_signature(kind, reference, function)
    return PluginMethod(kind, text, reference, hash_of(module))


def list_installed_plugins() -> tuple[str, ...]:
    """Return the names of all installed user methods of every kind."""
    return tuple(sorted({point.name for kind in MethodKind for point in entry_points(group=kind.group)}))


def signature_of(kind: MethodKind) -> str:
    """Return the call signature required of a kind, as shown in messages."""
    return str(inspect.Signature([one.replace(annotation=one.empty) for one in _required_parameters(kind)]))


def is_in_site_packages(file: Path) -> bool:
    return not {*INSTALLED}.isdisjoint(file.parts)


def local_modules(module: ModuleType) -> Mapping[str, Path]:
    """Map imported module names to their files, by following import statements without executing any.

    For an installed module, those of its package count; for a file of the user's own, those of its folder and
    their packages. Anything imported by a computed name, compiled or read as data is not found.
    """
    if module.__file__ is None:
        return {}
    file = Path(module.__file__).resolve()
    depth = module.__name__.count(".") + (file.stem == "__init__")
    finder = _LocalModuleFinder(
        file.parents[depth], module.__name__.partition(".")[0] if is_in_site_packages(file) else None
    )
    finder.import_hook(module.__name__)
    found = {name: vars(one)["__file__"] for name, one in finder.modules.items()}
    return {name: Path(path) for name, path in found.items() if path is not None} | {module.__name__: file}


def hash_of(module: ModuleType) -> str:
    """Return a SHA-256 over the module's file and its local imports; empty for a module without a file."""
    files = local_modules(module)
    hashes = {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()}
    if len(hashes) < 2:
        return "".join(hashes.values())
    lines = "".join(f"{sha256}  {name}\n" for name, sha256 in sorted(hashes.items()))
    return hashlib.sha256(lines.encode()).hexdigest()


class _LocalModuleFinder(ModuleFinder):
    def __init__(self, folder: Path, only: str | None) -> None:
        """Limit the search to `folder`, and to the package `only` if given."""
        super().__init__(path=[str(folder)])
        self._only = only

    def import_module(self, partname: str, fqname: str, parent: Module) -> Module | None:
        package = fqname.partition(".")[0]
        if package in OURS or self._only not in (None, package):
            return None
        return super().import_module(partname, fqname, parent)


def _reference_by_entry_point(kind: MethodKind, name: str) -> str:
    names = sorted(point.name for point in entry_points(group=kind.group))
    for point in entry_points(group=kind.group, name=name):
        return point.value.partition(" ")[0]
    for other in MethodKind:
        if other is not kind and name in {point.name for point in entry_points(group=other.group)}:
            raise MethodRefused(f"{name!r} is the name of a {other}", expected=f"a {kind}")
    near = find_near(name, names, MOST_NEAR) or names
    known = f" or an installed one ({', '.join(near)})" if near else ""
    raise MethodRefused(f"there is no {kind} {name!r}", expected=f"module:function{known}")


def _import_method(reference: str, kind: MethodKind) -> tuple[Callable[..., Any], ModuleType]:
    module_name, _, name = reference.partition(":")
    if not (name.isidentifier() and all(part.isidentifier() for part in module_name.split("."))):
        raise MethodRefused(f"{reference!r} does not name a {kind}", expected="module:function")
    if module_name.endswith(FILE_ENDING):
        raise MethodRefused(
            f"{module_name} is a file", expected=f"its module: {module_name.removesuffix(FILE_ENDING)}:{name}"
        )
    try:
        module = importlib.import_module(module_name)
        if (
            _loaded.setdefault(module_name, now := hash_of(module)) != now
        ):  # edited, or sent again to this worker
            for beside in local_modules(module):
                sys.modules.pop(beside, None)
            module = importlib.import_module(module_name)
            _loaded[module_name] = now
    except (Exception, SystemExit) as error:
        raise MethodRefused(
            f"the module {module_name} of the {kind} cannot be imported",
            expected=f"a module that is installed or in {os.getcwd()}",
            got=f"{type(error).__name__}: {error}",
        ) from error
    found = getattr(module, name, None)
    if found is None:
        near = find_near(name, dir(module), MOST_NEAR)
        raise MethodRefused(f"{module.__file__} has no {name!r}", expected=" or ".join(near) or f"a {kind}")
    if not callable(found):
        raise MethodRefused(
            f"{reference} is not a {kind}",
            expected=f"a function {signature_of(kind)}",
            got=type(found).__name__,
        )
    return found, module


def _require_signature(kind: MethodKind, reference: str, function: Callable[..., Any]) -> None:
    """Raise an error unless the method can be called with the arguments of its kind."""
    required = _required_parameters(kind)
    places = [one.name for one in required if one.kind is not one.KEYWORD_ONLY]
    names = {one.name: None for one in required if one.kind is one.KEYWORD_ONLY}
    try:
        signature = inspect.signature(function)
        signature.bind(*places, **names)
    except (TypeError, ValueError) as error:
        raise MethodRefused(
            f"{reference} cannot be called as a {kind}: {error}",
            expected=f"{'a class' if kind is MethodKind.STRATEGY else 'a function'} {signature_of(kind)}",
            got=str(signature) if isinstance(error, TypeError) else "no signature",
        ) from error


def _required_parameters(kind: MethodKind) -> list[inspect.Parameter]:
    _, *required = inspect.signature(CONTRACTS[kind].__call__).parameters.values()
    return required
