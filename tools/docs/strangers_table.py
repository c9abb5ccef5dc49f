"""Page of strangers: clients and servers of others, what they can do, and where they fail.

The outcomes were kept by `make strangers`, in docs/reference/strangers.toml.
"""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from reference_tables import REFERENCE, ROOT, table

sys.path.append(str(ROOT / "tools" / "strangers"))

from stranger_cases import Case, Protocol
from stranger_catalogue import CLIENTS, SERVERS, Client, Server

RESULTS = REFERENCE / "strangers.toml"
PASSES, FAILS, NOT_ASKED = "passes", "**fails**", "–"


@dataclass(frozen=True)
class Result:
    """Outcomes of one stranger, by the name of a case: `passes` or the failure."""

    name: str
    version: str
    protocol: str
    cases: dict[str, str]

    def as_table(self) -> dict[str, Any]:
        """Return the entry of the file."""
        return {"name": self.name, "version": self.version, "protocol": self.protocol, "cases": self.cases}


def read_results(path: Path = RESULTS) -> list[Result]:
    """Read the outcomes that were kept; none without the file."""
    if not path.exists():
        return []
    return [Result(**entry) for entry in tomllib.loads(path.read_text(encoding="utf-8"))["stranger"]]


def strangers() -> str:
    """Compose a section for each protocol: cases by client, foreign devices, each failure with its code."""
    results = {one.name: one for one in read_results()}
    protocols = dict.fromkeys(one.protocol for one in (*CLIENTS, *SERVERS))
    return "\n".join(
        f"## {protocol.title}\n\n{''.join(_describe(protocol, results))}" for protocol in protocols
    )


def _describe(protocol: Protocol, results: dict[str, Result]) -> Iterator[str]:
    clients = [one for one in CLIENTS if one.protocol is protocol and one.name in results]
    if clients:
        yield table(
            (protocol.heading, *(f"{one.name} {results[one.name].version}" for one in clients)),
            [
                (case.words, *(_outcome(one, results[one.name], case) for one in clients))
                for case in protocol.cases
            ],
        )
    for server in SERVERS:
        if server.protocol is protocol and server.name in results:
            yield _describe_server(server, results[server.name])
    for client in clients:
        yield from _failures(client, results[client.name])


def _outcome(client: Client, result: Result, case: Case) -> str:
    """Return the cell of a case, with the report of the project, if it has one."""
    found = result.cases.get(case.name)
    if found is None:
        return NOT_ASKED
    outcome = PASSES if found == PASSES else FAILS
    report = client.reports.get(case.name)
    return f"{outcome} ({_link(report)})" if report else outcome


def _link(report: str) -> str:
    project, _, number = report.partition("#")
    return f"[{project.rpartition('/')[2]}#{number}](https://github.com/{project}/issues/{number})"


def _failures(client: Client, result: Result) -> Iterator[str]:
    sources = client.sources()
    for name, outcome in result.cases.items():
        if outcome != PASSES:
            words = name.replace("_", " ")
            place = f"[{client.program}](../../{client.path.relative_to(ROOT)})"
            heading = f"### {client.name} fails: {words}\n\n{outcome}. In {place}:"
            yield f"\n{heading}\n\n```python\n{sources[name]}\n```\n"


def _describe_server(server: Server, result: Result) -> str:
    """Tabulate our suite's cases, run by our driver against a foreign device."""
    rows = [
        (
            case.number,
            case.statement,
            _shown(result.cases[case.number]),
        )
        for case in server.suite.cases
        if case.number in result.cases
    ]
    return f"\n{table(('case', 'our driver finds that', f'{server.name} {result.version}'), rows)}"


def _shown(outcome: str) -> str:
    return PASSES if outcome == PASSES else f"{FAILS}: {outcome}"
