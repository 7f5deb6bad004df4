.DEFAULT_GOAL := help
PYTHON ?= python3
BIN := .venv/bin
# the binding's tests and lints look for a Python: that of the environment, which is always there
export PYO3_PYTHON := $(CURDIR)/$(BIN)/python
# where rustup puts cargo, if this shell has not been told yet
export PATH := $(PATH):$(HOME)/.cargo/bin
# small dense matrices of the tests only suffer from threads of their own
export OPENBLAS_NUM_THREADS ?= 1
# property tests draw the same examples in every run: a red run can be repeated (see tests/python/conftest.py for Python's)
export PROPTEST_RNG_SEED ?= 20
# two sections of the gallery show research data where they lie beside the project
export BELTRAMI_DATA ?= $(wildcard $(CURDIR)/../shared/data)
SOURCES := $(shell find rust python/binding -name '*.rs') Cargo.toml Cargo.lock python/binding/Cargo.toml pyproject.toml

.PHONY: help system build demo test check bars bench docs slow wheel wheels clean
help: ## print this list
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 10

system: ## install what a bare Debian or Ubuntu lacks (linker, venv, Rust); elsewhere say what is missing
	@missing=; command -v cc >/dev/null || missing="build-essential"; \
	$(PYTHON) -c "import ensurepip, venv" 2>/dev/null || missing="$$missing python3 python3-venv"; \
	command -v cargo >/dev/null || command -v curl >/dev/null || missing="$$missing curl ca-certificates"; \
	if [ -n "$$missing" ]; then \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then apt-get update -qq && apt-get install -qq -y $$missing >/dev/null; \
	  else echo "please install first: $$missing"; exit 1; fi; \
	fi
	@command -v cargo >/dev/null || curl --proto '=https' --tlsv1.2 -sSf https://sh.rustup.rs | sh -s -- -q -y --profile default

.venv/.made: pyproject.toml | system
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install -q --upgrade pip "maturin>=1.9,<2"
	$(BIN)/python -c "import tomllib" 2>/dev/null || $(BIN)/python -m pip install -q tomli
	$(BIN)/python python/requirements.py | xargs $(BIN)/python -m pip install -q
	@touch $@

.venv/.built: .venv/.made $(SOURCES)
	. $(BIN)/activate && PIP_QUIET=1 maturin develop --release --quiet
	@touch $@

build: .venv/.built ## create .venv with the release build and everything that tests and demo use

demo: build ## write gallery/index.html: the main results on real shapes
	$(BIN)/python -m beltrami gallery -o gallery

test: build ## run all tests, Rust and Python, and then `make check`
	cargo test --release --workspace --quiet
	$(BIN)/python -m pytest -q
	@$(MAKE) --no-print-directory check

check: build ## check formatting, lints, types and stubs
	@cargo fmt --version >/dev/null 2>&1 && cargo clippy --version >/dev/null 2>&1 || rustup component add rustfmt clippy
	cargo fmt --all --check
	cargo clippy --release --workspace --all-targets --quiet -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --release --no-deps --quiet
	$(BIN)/ruff check python tests benches examples docs
	$(BIN)/python -m mypy
	$(BIN)/python -m mypy.stubtest beltrami._core

bars: build ## run the acceptance checks, if they lie beside the project
	@if [ -f ../shared/checks/all.py ]; then $(BIN)/python ../shared/checks/all.py; else echo "../shared/checks is absent: no bars to hold against"; fi

docs: build ## build the site: site/index.html, with a reference of all names
	cargo doc --release --no-deps --quiet
	$(BIN)/python docs/build.py

bench: build ## time the kernels, compare with other libraries where installed, measure cost against size
	cargo bench --quiet
	$(BIN)/python benches/results.py
	$(BIN)/python benches/scale.py

wheel: build ## build the wheel in dist/ and try it in empty environments (PYTHONS="python3.10 python3.13")
	rm -rf dist && . $(BIN)/activate && maturin build --release --locked --out dist
	$(BIN)/python python/try_wheel.py dist/*.whl $(PYTHONS)

# zig, a Python package, links for every one of them
CROSS := x86_64-unknown-linux-gnu aarch64-unknown-linux-gnu x86_64-unknown-linux-musl aarch64-unknown-linux-musl aarch64-apple-darwin
wheels: build ## cross-build wheels for the platforms in CROSS with zig, in dist/ (releases use release.yml)
	rustup target add $(CROSS)
	$(BIN)/python -m pip install -q "maturin[zig]>=1.9,<2" abi3audit
	rm -rf dist && . $(BIN)/activate && for target in $(CROSS); do \
	  maturin build --release --locked --zig --target $$target --out dist || exit 1; done
	for wheel in dist/*; do $(BIN)/python -m abi3audit --strict $$wheel || exit 1; done

slow: build ## run the sweeps that take minutes, with new seeds in every run
	PROPTEST_CASES=100000 PROPTEST_RNG_SEED=$$(date +%s) cargo test --release --quiet --test io --test hostile
	HYPOTHESIS_PROFILE=random $(BIN)/python -m pytest -q -m slow

clean: ## remove everything that was built
	rm -rf target .venv gallery site
