"""pytest plugin: simulated devices as fixtures, for the tests of any program that talks to such devices.

`ronna_polaris`, `ronna_kuka`, `ronna_ur`, `ronna_cameras` and `ronna_theatre` start a simulator for each
test, on endpoints that nobody else uses; with --ronna-shared one of each serves all tests, without faults at
the beginning of each. An indirect parameter gives other options of `ronna-sim`. `ronna_simulator` starts any
number of simulators for a test, `ronna_shared_simulator` for all tests.

Every run of pytest in this environment imports this module, so it imports nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from sim.simulators import Simulator

StartSimulator = Callable[..., "Simulator"]  # with the name of the simulator, and its options
KUKA_OPTIONS = ("--autostart",)  # a client of the stream need not know the project's command channel


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of the simulators."""
    group = parser.getgroup("ronna", "simulated devices of ronna-hw")
    group.addoption(
        "--ronna-scene", metavar="FILE", help="Scene of the simulators: a file, or a name as in ronna-sim."
    )
    group.addoption(
        "--ronna-shared",
        action="store_true",
        default=None,
        help="Use one simulator of each kind for all tests; faults end with the test that injected them.",
    )
    parser.addini("ronna_scene", "Scene of the simulators, as --ronna-scene.")
    parser.addini("ronna_shared", "One simulator of each kind for all tests, as --ronna-shared.", type="bool")


@pytest.fixture
def ronna_simulator(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[StartSimulator]:
    """Start simulators for this test: `ronna_simulator("polaris", "--profile", "vega")`."""
    with ExitStack() as stack:
        started: list[Simulator] = []

        def start(kind: str, *options: str) -> Simulator:
            started.append(_start(stack, request.config, tmp_path_factory, kind, options))
            return started[-1]

        yield start
        _require_alive(started)


@pytest.fixture(scope="session")
def ronna_shared_simulator(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[StartSimulator]:
    """Start simulators for all tests: the same arguments give the same one, without faults, while it runs."""
    with ExitStack() as stack:
        started: dict[tuple[str, ...], Simulator] = {}

        def start(kind: str, *options: str) -> Simulator:
            key = (kind, *options)
            if key in started and started[key].alive:
                started[key].clear()
            else:
                started[key] = _start(stack, request.config, tmp_path_factory, kind, options)
            return started[key]

        yield start


@pytest.fixture
def ronna_polaris(request: pytest.FixtureRequest) -> Iterator[Simulator]:
    """A simulated NDI Polaris, by default a Spectra on TCP."""
    yield from _provide(request, "polaris")


@pytest.fixture
def ronna_kuka(request: pytest.FixtureRequest) -> Iterator[Simulator]:
    """A simulated KR C4 with its arm, which streams to `ronna_kuka.host` and `ronna_kuka.port`."""
    yield from _provide(request, "kuka", KUKA_OPTIONS)


@pytest.fixture
def ronna_ur(request: pytest.FixtureRequest) -> Iterator[Simulator]:
    """A simulated controller of Universal Robots with its arm, by default a UR5e, at `ronna_ur.host`."""
    yield from _provide(request, "ur")


@pytest.fixture
def ronna_cameras(request: pytest.FixtureRequest) -> Iterator[Simulator]:
    """A simulated pair of GigE Vision cameras."""
    yield from _provide(request, "basler")


@pytest.fixture
def ronna_theatre(request: pytest.FixtureRequest) -> Iterator[Simulator]:
    """A simulated theatre in real time: tracker, arm and cameras, which see the same room."""
    yield from _provide(request, "theatre")


def _provide(request: pytest.FixtureRequest, kind: str, options: Sequence[str] = ()) -> Iterator[Simulator]:
    options = getattr(request, "param", options)
    config = request.config
    shares = config.getoption("--ronna-shared")
    if shares is None:
        shares = config.getini("ronna_shared")
    start = request.getfixturevalue("ronna_shared_simulator" if shares else "ronna_simulator")
    simulator: Simulator = start(kind, *options)
    yield simulator
    if shares:
        _require_alive([simulator])


def _start(
    stack: ExitStack,
    config: pytest.Config,
    folders: pytest.TempPathFactory,
    kind: str,
    options: Sequence[str],
) -> Simulator:
    from sim.simulators import running  # late: with the first simulator

    scene = config.getoption("--ronna-scene") or config.getini("ronna_scene") or None

    def new_folder() -> Path:
        return folders.mktemp("theatre")

    return stack.enter_context(running(kind, options, scene, new_folder))


def _require_alive(simulators: Sequence[Simulator]) -> None:
    """Fail a test during which a simulator has ended by itself: what it found then says little."""
    if ended := [reason for one in simulators if (reason := one.describe_failure())]:
        pytest.fail("; ".join(ended), pytrace=False)
