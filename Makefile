# The main targets are `make demo` and `make test`. Every target first installs into .venv if that is missing or out of date.
#
# `make proof` runs the long proofs; GROUP=attack, bridge, server, ... runs one group.
#
# Without an NVIDIA card, PyTorch comes from its CPU index: 200 MB instead of several GB. To choose yourself, add
# TORCH_INDEX=ADDRESS, or TORCH_INDEX= for pip's own index.

TORCH_INDEX ?= $(if $(wildcard /dev/nvidia0),,https://download.pytorch.org/whl/cpu)
# The first of these that starts: a name on the path may be a shim of a version that is not there.
PYTHONS := python3.11 python3.12 python3.13
PYTHON ?= $(firstword $(foreach name,$(PYTHONS),$(shell $(name) -c 'import venv, ensurepip' 2>/dev/null && echo $(name))) python3.11)
BIN := .venv/bin
STAMP := .venv/.installed
export OMP_NUM_THREADS ?= 1

.PHONY: setup demo test check lint look docs bench proof results pictures release clean

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt tools/pybullet_fork.txt
	@$(PYTHON) -c 'import sys, venv, ensurepip; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null || \
	  { echo "wcsim needs Python 3.11, 3.12 or 3.13 with venv, and $(PYTHON) is none. On Debian or Ubuntu: sudo apt install python3.11 python3.11-venv. Elsewhere: make PYTHON=/path/to/python3.11" >&2; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@echo "installing into .venv (the first time takes some minutes) ..."
	@echo "1/3 PyTorch ..."
	@$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt $(if $(TORCH_INDEX),--retries 2 --extra-index-url $(TORCH_INDEX)) torch
	@$(BIN)/python -c 'import sys; sys.exit(sys.version_info >= (3, 12))' || \
	  $(BIN)/pip install --quiet --disable-pip-version-check --no-deps --require-hashes --requirement tools/pybullet_fork.txt
	@echo "2/3 SUMO, PyBullet and the other packages ..."
	@$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt $$($(BIN)/python tools/dev_requirements.py)
	@echo "3/3 wcsim ..."
	@$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --no-build-isolation --editable '.[train]'
	@# Python reads this link in the locale's letters, and dies of others; a relative path has none.
	@echo ../../../.. | tee .venv/lib/python3.*/site-packages/_editable_impl_wcsim.pth > /dev/null
	@touch $(STAMP)
	@echo "installed. Next: source .venv/bin/activate && wcsim doctor"

demo: $(STAMP)
	$(BIN)/wcsim demo

look: $(STAMP)
	$(BIN)/wcsim look

check: $(STAMP)
	$(BIN)/ruff check wcsim tests examples tools benchmarks
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

lint: check
	$(BIN)/python -m tests.api.ceilings

# Tests start many processes; with compiled modules on disk each of them starts faster.
# One of them counts what `make lint` prints.
test: check
	env -u PYTHONDONTWRITEBYTECODE $(BIN)/pytest -n 3 --dist loadfile --no-loadscope-reorder -m 'not proof'

proof: $(STAMP)
	$(BIN)/pytest -n 2 --dist worksteal -m proof $(if $(GROUP),tests/$(GROUP))

# The tables about learning, in parts of at most 90 minutes. PART=laptop-1 runs one part, PART=--list names them.
results: $(STAMP)
	$(BIN)/python -m tools.results $(PART)

# The pictures and figures of README and docs, from runs in results/. PART=film makes one part of tools/pictures.py.
pictures: $(STAMP)
	$(BIN)/python -m tools.pictures $(PART)

# The pages of docs/ as a website with search and signatures: build/site/index.html. NO_MKDOCS_2_WARNING hides a notice of
# mkdocs-material about its own future.
docs: $(STAMP)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict --config-file tools/docs_site/mkdocs.yml
	@echo "built build/site/index.html. For the search: python -m http.server --directory build/site"

bench: $(STAMP)
	$(BIN)/python -m benchmarks tick
	$(BIN)/python -m benchmarks camera

# Builds wheel and source archive, and tries the wheel, without PyTorch, in a fresh venv. The version is that of pyproject.toml.
VERSION ?= $(shell sed -n 's/^version = "\(.*\)"/\1/p' pyproject.toml)
release: $(STAMP)
	rm -rf dist build/release
	@mkdir -p dist
	$(BIN)/python tools/release_notes.py $(VERSION) > dist/NOTES.md
	$(BIN)/python -m build --no-isolation
	$(PYTHON) -m venv build/release
	@echo "installing the wheel into a fresh venv ..."
	build/release/bin/pip install --quiet --disable-pip-version-check --constraint constraints.txt dist/*.whl
	cd build/release && bin/wcsim doctor && bin/wcsim scene run car-at-zebra
	@ls -l dist

clean:
	rm -rf .venv build dist look
