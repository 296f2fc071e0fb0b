# Every command a newcomer needs. Each target sets up what it uses in a local virtual environment (.venv).
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
UV := $(BIN)/uv pip install --python $(BIN)/python --quiet
OUT ?= out

RUST := $(shell find rust -name '*.rs') Cargo.toml Cargo.lock rust/servo/Cargo.toml

.PHONY: demo build test test-long soak lint bench bank outside prove docs figures wheel data builtin clean test-rust test-python

demo: $(VENV)/.core
	$(BIN)/softmap demo --out $(OUT)/demo
	@echo 'The command softmap needs this first: source $(BIN)/activate'

# The package and the command `softmap` in .venv, compiled again if a Rust file changed.
build: $(VENV)/.core

# What compiles and what installs go side by side; then come the tests of Python.
test:
	$(MAKE) -j2 test-rust $(VENV)/.test
	$(MAKE) test-python

test-rust:
	cargo test --workspace --locked --quiet

# Three workers more than cores, each with one thread: tests of the robot wait more than they compute.
test-python: $(VENV)/.test
	RAYON_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -m "not long and not prove" -n $$(($$(nproc) + 3)) --dist loadfile --no-loadscope-reorder --durations 12

# Complete stories from hidden effect to diagnosis, training, and five hundred damaged files of each format.
test-long: $(VENV)/.test
	RAYON_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -m "long and not prove" -n $$(nproc) --dist loadfile --no-loadscope-reorder --durations 12

# Goes on where it stopped; `rm out/soak.jsonl` begins again.
soak: $(VENV)/.test
	mkdir -p out
	RAYON_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/support/soak.py out/soak.jsonl

# rustfmt by file: `cargo fmt` does not see the modules that a macro declares (rust/effects/mod.rs).
lint: $(VENV)/.lint
	rustfmt --check --edition 2024 $(filter %.rs,$(RUST))
	cargo clippy --workspace --locked --all-targets --quiet -- -D warnings
	cargo clippy --locked --features python --quiet -- -D warnings
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m mypy.stubtest softmap_edge._core

bench: $(VENV)/.bench
	$(BIN)/python -m benches

# The benchmark bank at its full sizes on seeds kept apart for figures; SEEDS=development for work. Goes on where it was stopped.
SEEDS ?= reporting
SHARE ?= 1
bank: $(VENV)/.test
	$(BIN)/python -m benches.bank --seeds $(SEEDS) --share $(SHARE) --out $(OUT)/bank

# Public data with known answers, compared with general methods; sets that are absent are skipped. Writes docs/benchmarks/outside.md as well.
outside: $(VENV)/.bench
	RAYON_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python -m benches.outside --out $(OUT)/outside --page

prove: wheel $(VENV)/.prove
	cargo test --workspace --locked --release --quiet -- --include-ignored
	PATH="$(abspath $(BIN)):$$PATH" $(BIN)/python rust/servo/prove.py coverage
	PATH="$(abspath $(BIN)):$$PATH" $(BIN)/python rust/servo/prove.py mutants
	$(BIN)/python -m pytest

# The documentation as a site in out/docs, with a search that works from a disk; every warning is an error.
docs: $(VENV)/.docs
	$(BIN)/python docs/make_reference.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	$(BIN)/python -m pytest -q docs/test_site.py
	@echo "Open out/docs/index.html"

# The pictures of the pages and the page of effects, measured again.
figures: $(VENV)/.test
	$(BIN)/python docs/make_effects.py
	$(BIN)/python docs/figures.py
	$(BIN)/python docs/figures_diagnosis.py
	$(BIN)/python docs/figures_tdcr.py
	$(BIN)/python docs/figures_beam.py
	$(BIN)/python docs/figures_track.py
	$(BIN)/python docs/figures_teleop.py

# For every Linux with glibc 2.17 or later (zig links it so), checked as it will be installed. TARGET=aarch64-unknown-linux-gnu for
# boards, once `rustup target add` has brought it.
TARGET ?= x86_64-unknown-linux-gnu
wheel: $(VENV)/.test
	$(UV) maturin ziglang
	rm -f dist/*.whl
	PATH="$(abspath $(BIN)):$$PATH" VIRTUAL_ENV="$(abspath $(VENV))" \
	  $(BIN)/maturin build --release --locked --zig --compatibility manylinux2014 --target $(TARGET) --out dist
	$(BIN)/python -m pytest -q tests/project/test_wheel.py

data: $(VENV)/.core
	$(BIN)/python examples/fetch_data.py data

# The bundle of the built-in finger, which ships in the wheel; run after a change to the simulator or to finger.toml.
builtin: $(VENV)/.core
	$(BIN)/softmap build --out softmap_edge/data/finger --force

clean:
	rm -rf $(VENV) target dist build $(OUT) softmap_edge/*.so

# --- the virtual environment, in layers -------------------------------------------------
$(VENV)/.venv:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check uv
	touch $@

# The package itself, compiled; python files are used in place.
$(VENV)/.core: $(VENV)/.venv $(RUST) pyproject.toml
	@echo "Compiling the core: a few minutes …"
	$(UV) --reinstall-package softmap-edge -e '.[report]'
	touch $@

# torch without what only GPUs need of it.
$(VENV)/.test: $(VENV)/.core training/pyproject.toml training/cpu.txt
	$(UV) --group pyproject.toml:test --override training/cpu.txt -e 'training[torch,baselines]'
	touch $@

# Peers for the benchmarks alone, without what libigl's wheel holds under other terms than the MPL 2.0: CGAL, TetGen, Triangle.
$(VENV)/.bench: $(VENV)/.test pyproject.toml
	$(UV) --group pyproject.toml:bench
	rm -rf $(VENV)/lib/python*/site-packages/igl/copyleft $(VENV)/lib/python*/site-packages/igl/triangle
	touch $@

# What counts covered lines and makes mutants; rustup brings the LLVM that can read the compiler's profiles.
$(VENV)/.prove: $(VENV)/.venv
	rustup component add llvm-tools
	cargo install --quiet --locked --root $(VENV) cargo-llvm-cov@0.9.1 cargo-mutants@27.1.0
	touch $@

$(VENV)/.lint: $(VENV)/.core
	$(UV) --group pyproject.toml:lint --group pyproject.toml:test
	touch $@

$(VENV)/.docs: $(VENV)/.test pyproject.toml
	$(UV) --group pyproject.toml:docs
	touch $@
