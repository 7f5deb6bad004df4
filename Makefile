.DEFAULT_GOAL := help
PYTHON ?= python3
BIN := .venv/bin
# property tests draw the same examples in every run: a red run can be repeated (see tests/python/conftest.py for Python's)
# small dense matrices of the tests only suffer from threads of their own
export OPENBLAS_NUM_THREADS ?= 1
export PROPTEST_RNG_SEED ?= 20
SOURCES := $(shell find rust python/binding -name '*.rs') Cargo.toml Cargo.lock python/binding/Cargo.toml pyproject.toml

.PHONY: help build demo test check bars bench docs slow clean
help: ## this list
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 10

.venv/.made: pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install -q --upgrade pip "maturin>=1.9,<2"
	$(BIN)/python -c "import tomllib" 2>/dev/null || $(BIN)/python -m pip install -q tomli
	$(BIN)/python python/requirements.py | xargs $(BIN)/python -m pip install -q
	@touch $@

.venv/.built: .venv/.made $(SOURCES)
	. $(BIN)/activate && maturin develop --release --quiet
	@touch $@

build: .venv/.built ## make .venv and install the release build with all that tests and demo use

demo: build ## the main job on real input: writes gallery/index.html
	$(BIN)/python -m beltrami gallery -o gallery

test: build ## all tests: Rust, Python, and what `make check` asks
	cargo test --release --workspace --quiet
	$(BIN)/python -m pytest -q
	@$(MAKE) --no-print-directory check

check: build ## formatting, lints, types, stubs
	cargo fmt --all --check
	cargo clippy --release --workspace --all-targets --quiet -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --no-deps --quiet
	$(BIN)/ruff check python tests benches examples docs
	$(BIN)/python -m mypy
	$(BIN)/python -m mypy.stubtest beltrami._core

bars: build ## the acceptance checks beside the project, where they are present
	@if [ -f ../shared/checks/all.py ]; then $(BIN)/python ../shared/checks/all.py; else echo "../shared/checks is absent: no bars to hold against"; fi

docs: build ## the site: site/index.html, with a reference of all names
	cargo doc --no-deps --quiet
	$(BIN)/python docs/build.py

bench: build ## times of the kernels, and side by side with other libraries where they are installed
	cargo bench --quiet
	@for script in benches/peers/*.py; do echo "== $$script"; $(BIN)/python $$script || exit 1; done

slow: build ## the sweeps that take minutes
	HYPOTHESIS_PROFILE=random $(BIN)/python -m pytest -q -m slow

clean: ## remove what was built
	rm -rf target .venv gallery site
