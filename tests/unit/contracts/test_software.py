from pathlib import Path

import pytest
from bad_inputs import app_of
from user_commands import in_this_process

from ronna_hw.command_line.launch import COMMANDS
from ronna_hw.software import LOCK, Software, identify_software


@pytest.fixture(scope="module")
def said() -> str:
    """Version and lock, as identified from all files: read once."""
    return str(identify_software())


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_prints_its_version_and_lock(name: str, said: str) -> None:
    done = in_this_process(app_of(name), "--version")
    assert done.returncode == 0
    assert done.stdout.strip() == said
    assert ", lock " in done.stdout


def test_packages_that_differ_from_the_lock_are_named(tmp_path: Path) -> None:
    (tmp_path / LOCK).parent.mkdir()
    (tmp_path / LOCK).write_text("pytest==0.1 ; python_version < '3'\npytest==0.2\nno-such-package==1.0\n")
    found = identify_software(tmp_path)
    assert [one.split(", ")[1] for one in found.otherwise] == ["locked 0.1 or 0.2"]
    assert found.commit is None


def test_packages_count_as_not_locked_without_a_checkout(tmp_path: Path) -> None:
    found = identify_software(tmp_path)
    assert found == Software(found.version, None, None)
    assert str(found).endswith("packages not locked")
