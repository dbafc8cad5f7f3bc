# Everything is installed into .venv; `make` alone says what there is to make.

JOBS ?= 2
BIN := .venv/bin
READY := .venv/.ready

export TF_CPP_MIN_LOG_LEVEL ?= 3
# pytest keeps the tests that it has rewritten as bytecode; without, each process rewrites them for 4 s.
unexport PYTHONDONTWRITEBYTECODE

# Instruction sets of other processors, whose rounding differs, and the tests that train.
ISAS ?= AVX2 SSE4_2
TRAINING := $(addprefix tests/methods/test_,bptt.py methods.py together.py checkpoint.py)

GOLDEN ?=

# More options of pytest, for all targets that test.
PYTEST ?=
TESTS := $(BIN)/python -m pytest -n $(JOBS) --dist loadfile --no-loadscope-reorder -p no:benchmark $(PYTEST)

.PHONY: help run test test-exhaustive test-isa test-all golden reports docs lint bench clean

help:
	@echo "make run       install, then train and compare everything in the quick suite"
	@echo "make test      install, then run the tests in JOBS=$(JOBS) processes"
	@echo "make test-all  make test, then test-exhaustive (every plug-in in every simulator) and"
	@echo "               test-isa (the tests that train, as on processors with $(ISAS))"
	@echo "make golden    install, then make answers again that a change of structure must not move"
	@echo "make reports   install, then write the pages in reports/ again from the tables in results/"
	@echo "make docs      install, then build the documentation into site/"
	@echo "make lint      install, then check style, types and layers"
	@echo "make bench     install, then measure the speed of what is slow"
	@echo "make clean     remove .venv, caches and the results of the quick suite"

run: $(READY)
	@echo "Running the quick suite: tables go to results/quick, documents to reports/quick."
	@$(BIN)/bench run

test: $(READY)
	@echo "Running the tests in $(JOBS) processes."
	@$(TESTS) -m "not exhaustive"

test-exhaustive: $(READY)
	@echo "Running the exhaustive tests in $(JOBS) processes."
	@$(TESTS) -m exhaustive

test-isa: $(READY)
	@for isa in $(ISAS); do \
		echo "Running the tests that train, compiled for $$isa, in $(JOBS) processes."; \
		XLA_FLAGS="$$XLA_FLAGS --xla_cpu_max_isa=$$isa" $(TESTS) $(TRAINING) || exit 1; \
	done

test-all: test test-exhaustive test-isa

golden: $(READY)
	@echo "Comparing diagnoses, keys and rows with the kept ones (GOLDEN=--write keeps)."
	@$(BIN)/python -m tests.golden --jobs $(JOBS) $(GOLDEN)

# Suites whose runs the paper's claims are about: one page judges them together.
CLAIMED := paper off_spec budget ablations

reports: $(READY)
	@echo "Writing the pages in reports/ from the tables in results/."
	@$(BIN)/bench claims $(addprefix results/,$(CLAIMED)) --notes reports/paper_notes.md
	@$(BIN)/bench claims results/paper_rotorpy --out reports/rotorpy_claims.md
	@for suite in $(CLAIMED) floor scale transfer field_parts field contact worlds paper_rotorpy; do \
		$(BIN)/bench leaderboard results/$$suite > /dev/null && $(BIN)/bench report results/$$suite \
			|| exit 1; \
	done
	@$(BIN)/bench worlds results/paper results/transfer --notes reports/worlds_notes.md
	@$(BIN)/bench worlds results/worlds --out reports/worlds_trained.md --notes reports/worlds_trained_notes.md
	@$(BIN)/bench worlds results/paper results/paper_rotorpy --out reports/rotorpy.md --notes reports/rotorpy_notes.md
	@$(BIN)/bench worlds results/paper results/field_parts --out reports/field_parts.md --notes reports/field_parts_notes.md
	@$(BIN)/bench worlds results/paper results/contact --out reports/contact.md --notes reports/contact_notes.md
	@$(BIN)/python -m bench.paper.tuning results/tuning reports/tuning.md
	@$(BIN)/bench blind --report

docs: $(READY)
	@$(BIN)/python -c "import material, mkdocstrings" 2> /dev/null || $(BIN)/python -m pip install --quiet \
		--disable-pip-version-check -c constraints.txt -e '.[dev,docs]'
	@echo "Building the documentation into site/."
	@said=$$(NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict 2>&1) \
		|| { echo "$$said" | grep -v ^INFO; exit 1; }  # --quiet would hide warnings from --strict

lint: $(READY)
	@echo "Checking style, types and layers."
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/pyright
	@$(BIN)/lint-imports

bench: $(READY)
	@echo "Measuring speed, one benchmark after another."
	@mkdir -p .benchmarks
	@$(BIN)/python -m pytest benchmarks --benchmark-only --benchmark-json .benchmarks/last.json; \
		missed=$$?; $(BIN)/python -m benchmarks.tables .benchmarks/last.json && exit $$missed

clean:
	@echo "Removing .venv, caches and the results of the quick suite."
	@rm -rf .venv site *.egg-info .pytest_cache .ruff_cache .hypothesis .benchmarks .import_linter_cache
	@rm -rf "$$HOME/.cache/fidelity-bench/tests"
	@rm -rf results/quick reports/quick examples/plugin/build examples/plugin/*.egg-info
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Python 3.11, or else a newer python3; a python3.11 that is there but does not start is passed over.
.venv/bin/python:
	@echo "Creating a virtual environment in .venv."
	@for python in python3.11 python3; do \
		if $$python -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2> /dev/null; then \
			exec $$python -m venv .venv; \
		fi; \
	done; \
	echo "Python 3.11 or newer is needed, and neither python3.11 nor python3 is one." >&2; exit 1

$(READY): pyproject.toml constraints.txt | .venv/bin/python
	@echo "Installing fidelity-bench and what it needs into .venv (minutes the first time)."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $(READY)
