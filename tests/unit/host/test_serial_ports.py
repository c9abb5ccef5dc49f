"""Permissions of a serial port are reported with the command that fixes them."""

from __future__ import annotations

import stat
from pathlib import Path

from ronna_hw.host.port_users import permission_advice, permissions


def test_permission_advice_depends_on_the_group_access_to_the_port(tmp_path: Path) -> None:
    port = tmp_path / "ttyUSB0"
    port.touch()
    port.chmod(stat.S_IRUSR | stat.S_IWUSR | stat.S_IRGRP | stat.S_IWGRP)
    assert "sudo usermod -aG " in permission_advice(str(port))
    assert permissions(str(port)).startswith("-rw-rw---- ")
    port.chmod(stat.S_IRUSR)
    assert "udev" in permission_advice(str(port))
    assert "dialout" in permission_advice("/dev/no-such-port")
