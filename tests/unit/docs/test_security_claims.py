"""Tests back the claims of `docs/explanation/security.md`, and it names every listening module."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs/explanation/security.md").read_text(encoding="utf-8")
TEST = re.compile(r"`(tests/[\w/]+\.py)::(\w+)`")
OURS = ("ronna_hw", "conformance", "drivers", "sim", "procedures", "studies", "console")
SERVERS = {"create_server", "ThreadingTCPServer", "ThreadingHTTPServer", "HTTPServer", "TCPServer"}
SERVERS.add("ThreadedAssociationServer")  # of pynetdicom
LISTENING = re.compile(
    rf"\b({'|'.join((*sorted(SERVERS), 'bind'))})\b"
)  # a source without it need not be parsed


def test_every_claim_names_an_existing_test() -> None:
    claimed = TEST.findall(PAGE)
    assert claimed
    assert [f"{path}::{name}" for path, name in claimed if name not in _functions_of(path)] == []


def test_every_bullet_names_a_test_or_states_what_is_not_covered() -> None:
    bullets = re.split(r"\n- ", PAGE)[1:]
    assert [one for one in bullets if not TEST.search(one) and not one.startswith("Not covered")] == []


def test_every_row_names_a_test_or_states_what_is_not_covered() -> None:
    _, _, *rows = [line for line in PAGE.splitlines() if line.startswith("|")]
    assert [one for one in rows if not TEST.search(one) and "Not covered" not in one] == []


def test_every_module_that_opens_a_listening_socket_is_named() -> None:
    found = {
        path.relative_to(ROOT).as_posix()
        for package in OURS
        for path in (ROOT / package).rglob("*.py")
        if LISTENING.search(source := path.read_text(encoding="utf-8")) and _listens(ast.parse(source))
    }
    named = re.findall(r"`((?:ronna_hw|conformance|drivers|sim|procedures|studies|console)/[\w/.]*)`", PAGE)
    assert [module for module in sorted(found) if not any(module.startswith(name) for name in named)] == []
    assert [name for name in named if not any(module.startswith(name) for module in found)] == []


def _functions_of(path: str) -> set[str]:
    file = ROOT / path
    tree = ast.parse(file.read_text(encoding="utf-8")) if file.exists() else ast.Module([], [])
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


def _listens(tree: ast.AST) -> bool:
    """Whether a socket is bound to an address: `bind` with one argument in its place, or a server."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Attribute | ast.Name | ast.Call):
            continue
        called = node.func if isinstance(node, ast.Call) else node
        name = called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")
        if name in SERVERS:
            return True
        method = isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
        if name == "bind" and method and node.args and not isinstance(node.args[0], ast.Starred):
            return True  # with one argument in its place: a logger binds names, a signature many arguments
    return False
