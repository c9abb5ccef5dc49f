"""Diagnosis of OpenIGTLink servers: what a server sends, and whether its tracker can be configured."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing

from drivers.openigtlink_tracker.connection import Connection
from drivers.openigtlink_tracker.driver import LOOK_S, OpenIGTLinkTracker
from drivers.openigtlink_tracker.options import OpenIGTLinkOptions
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.probing import (
    CONNECT_LIMIT_S,
    Diagnostic,
    Inspection,
    Progress,
    connect_and_identify,
    endpoints_of,
    inspect_nothing,
    refusal,
    reporting,
)
from ronna_hw.endpoints import Endpoint
from ronna_hw.errors import RonnaError

NOTHING_SENT = (
    "Start acquisition, bring a tool into view, and list its transform among the TransformNames of the "
    "server."
)
LINE_SHARE = 0.5  # of the whole probe; the rest is for connecting


class OpenIGTLinkProbe:
    """Diagnosis for the OpenIGTLink tracker driver."""

    endpoint_schemes = frozenset({"igtl"})

    def __call__(
        self, name: str, config: DeviceConfig, progress: Progress, inspect: Inspection = inspect_nothing
    ) -> Sequence[Diagnostic]:
        found = self.probe_endpoints(endpoints_of(config), lambda share: progress(LINE_SHARE * share))
        return (*found, *connect_and_identify(name, config, OpenIGTLinkTracker, inspect=inspect))

    def probe_endpoints(self, endpoints: Sequence[Endpoint], progress: Progress) -> Sequence[Diagnostic]:
        """Name the transforms that each server sends within a moment."""
        return [_look(endpoint) for endpoint in reporting(endpoints, progress)]


probe = OpenIGTLinkProbe()


def _look(endpoint: Endpoint) -> Diagnostic:
    subject = f"server {endpoint}"
    try:
        opened = Connection("probe", endpoint, OpenIGTLinkOptions(), HostClock(), None, CONNECT_LIMIT_S)
        with closing(opened):
            opened.greet(CONNECT_LIMIT_S)
            opened.start()
            opened.await_names(set(), LOOK_S)  # as long as it takes
            opened.stop()
            names = sorted(opened.names)
    except RonnaError as error:
        return refusal(subject, error)
    seen = f"sends {', '.join(names)}" if names else "replies, but sends no transform"
    return Diagnostic(subject, True, seen, "" if names else NOTHING_SENT)
