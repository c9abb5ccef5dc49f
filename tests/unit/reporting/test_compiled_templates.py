"""Compiled templates: kept for the next program, and compiled again when source or environment differ."""

from __future__ import annotations

import sys
from pathlib import Path

import jinja2
import pytest

from procedures.reporting.compiled_templates import FOLDER, CompiledTemplates

TEMPLATE = "page.html.j2"


@pytest.fixture(autouse=True)
def _writes_bytecode(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", False)


@pytest.fixture
def environment_file(tmp_path: Path) -> Path:
    path = tmp_path / "report.py"
    path.write_text("options = 1")
    return path


@pytest.fixture
def templates(tmp_path: Path) -> Path:
    folder = tmp_path / "template"
    folder.mkdir()
    (folder / TEMPLATE).write_text("one {{ 1 }}")
    return folder


def _render(templates: Path, environment_file: Path) -> str:
    """Render as a new program does."""
    cache = CompiledTemplates(templates, environment_file)
    environment = jinja2.Environment(loader=jinja2.FileSystemLoader(templates), bytecode_cache=cache)
    return environment.get_template(TEMPLATE).render()


def _forbid_compiling(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_arguments: object) -> None:
        raise AssertionError("compiled")

    monkeypatch.setattr(jinja2.Environment, "compile", refuse)


def test_the_next_program_finds_it_compiled(
    templates: Path, environment_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = _render(templates, environment_file)
    _forbid_compiling(monkeypatch)
    assert _render(templates, environment_file) == first == "one 1"


@pytest.mark.parametrize("name", [f"template/{TEMPLATE}", "report.py"])
def test_another_source_or_environment_is_compiled_again(
    templates: Path, environment_file: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    _render(templates, environment_file)
    (templates.parent / name).write_text("two {{ 1 }}")
    _forbid_compiling(monkeypatch)
    with pytest.raises(AssertionError, match="compiled"):
        _render(templates, environment_file)


def test_a_read_only_installation_keeps_nothing(
    templates: Path, environment_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_arguments: object, **_more: object) -> None:
        raise PermissionError

    monkeypatch.setattr(Path, "mkdir", refuse)
    assert _render(templates, environment_file) == "one 1"
    assert not (templates / FOLDER).exists()
