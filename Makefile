# Every target does its own set-up: a clean clone needs Python >= 3.11 and make, nothing else.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
RUNS := $(VENV)/.runs
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
# Many tests wait for processes and ports: three workers keep two cores busy, and a worker that has nothing left
# takes over from the others. Each imports and collects everything, which takes 8 s of processor.
PYTEST := $(BIN)/python -m pytest -n 3 --dist worksteal
# Each worker collects all that it is given: where nothing is for `make test`, there is no need to look.
QUICK := tests/unit tests/system tests/hazards
# pip compiles what it copies; this is not copied. Otherwise each worker would compile all of it at the same time.
OURS := ronna_hw conformance drivers sim procedures studies console

.PHONY: setup demo wheel budget test test-all test-browser test-browser-all soak fuzz lint bench bench-history profile docs strangers lock clean

# The tests start hundreds of processes. OpenBLAS's threads cost each of them a tenth of a second and gain nothing
# with three workers on two cores; without bytecode each would compile again what the one before it has compiled.
test test-all test-browser test-browser-all soak fuzz: export OPENBLAS_NUM_THREADS := 1
test test-all test-browser test-browser-all soak fuzz: export PYTHONDONTWRITEBYTECODE :=

setup: $(STAMP)

# The stamps depend on the locks and on the project's metadata: a second run installs nothing.
$(STAMP): requirements/locked.txt pyproject.toml
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "installing the locked dependencies into $(VENV) (once)"
	@$(PIP) --require-hashes -r requirements/locked.txt
	@$(PIP) --no-deps --no-build-isolation --editable .
	@$(BIN)/python -m compileall -q $(OURS)
	@touch $(RUNS) $(STAMP)

# What a case needs, without the tools of who works on the code: a third of all modules. Each is compiled when it
# is first imported, for most never are.
$(RUNS): requirements/run.txt pyproject.toml
	@echo "Installing what a case needs into $(VENV), once: about 60 packages, 0.8 GB, half a minute to 2 minutes."
	@echo "pip shows each package as it fetches it, then unpacks all of them."
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --disable-pip-version-check --no-compile --require-hashes -r requirements/run.txt
	@$(PIP) --no-compile --no-deps --no-build-isolation --editable .
	@touch $(RUNS)

# Measured on two cores with packages in reach: 18 s to install, 20 s for the case, 10 s more for the first one, which
# compiles. What only console, studies and foreign decoders need comes with `make setup`, or with pip as they say.
demo: export PYTHONDONTWRITEBYTECODE :=
demo: about-demo $(RUNS)
	@echo "Simulating a case with three targets, from the CT to the error at each needle tip: half a minute to 2 minutes."
	@$(BIN)/ronna-procedure run --sim --seed 7 --out runs

.PHONY: about-demo
about-demo:
	@echo "This rehearses an operation with simulated devices on this computer; a script answers for the surgeon."

test: setup
	@$(PYTEST) -m "not slow and not soak and not browser" $(QUICK)

test-all: setup
	@$(PYTEST) -m "not soak and not browser" --every-hazard
	@$(BIN)/python -m pytest -p no:xdist tests/browser/test_benchmarks.py

soak: setup
	@$(PYTEST) -m soak

fuzz: setup
	@$(PIP) --require-hashes -r requirements/fuzz.txt
	@$(BIN)/python -m pytest -n auto -m soak tests/soak/test_hostile_guided.py

# One after the other and never beside the others: a browser takes the processor from the robot's link.
test-browser: setup
	@$(BIN)/python -m pytest -p no:xdist -m "browser and not slow" tests/browser

test-browser-all: setup
	@$(BIN)/python -m pytest -p no:xdist -m browser tests/browser

lint: setup
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports

# Some measurements only, as ONLY="registration ct".
bench: setup
	@$(BIN)/python -P benchmarks/run.py $(addprefix --only ,$(ONLY))

# Against the figures of tools/budget/budget.toml; WHOLE=1 for all, STEADY=1 for calls, theatre time and bytes,
# WRITE="reason" to set them.
budget: setup
	@OPENBLAS_NUM_THREADS=1 $(BIN)/python tools/budget/budget.py $(if $(WHOLE),--whole) $(if $(STEADY),--steady) $(if $(WRITE),--because "$(WRITE)")

bench-history: setup
	@$(BIN)/python -m benchmarks.history $(addprefix --only ,$(ONLY))

# Options of `ronna-procedure run`, as CASE="--scene mini --seed 3".
CASE := --seed 7
profile: setup
	@$(BIN)/python -P tools/profiling/profile_case.py $(CASE)

# Reference pages, and the pictures of pages that have changed since: two minutes, with Chromium. ALL=1 for all pictures.
docs: setup
	@$(BIN)/python tools/docs/generate.py
	@$(BIN)/python tools/docs/page_pictures.py $(if $(ALL),--all)

# Every foreign client and device that is installed here against every case: ten minutes. ONLY="ndicapi RSIPI" for some.
strangers: setup
	@$(BIN)/python tools/strangers/run_strangers.py $(ONLY)
	@$(BIN)/python tools/docs/generate.py

# For an environment without this clone: pip install dist/ronna_hw-*.whl, in quotes with [console] for the pages.
wheel: setup
	@$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation --wheel-dir dist .

# The lock names no package index: it holds versions and hashes only.
lock:
	uv pip compile --universal --generate-hashes --no-header --no-emit-index-url --no-emit-find-links \
	  --python-version 3.11 --extra dev pyproject.toml -o requirements/locked.txt
	uv pip compile --universal --generate-hashes --no-header --no-emit-index-url --no-emit-find-links --no-annotate \
	  --python-version 3.11 --extra build \
	  -c requirements/locked.txt pyproject.toml -o requirements/run.txt
	uv pip compile --universal --generate-hashes --no-header --no-emit-index-url --no-emit-find-links --no-annotate \
	  --python-version 3.11 --group fuzz -o requirements/fuzz.txt

clean:
	rm -rf $(VENV) build dist runs *.egg-info .pytest_cache .mypy_cache .ruff_cache
