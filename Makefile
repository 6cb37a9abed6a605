# 'make' alone prints the targets that people use: one line each, from the comment behind the target.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# venv is silent, and pip while it unpacks: beside a command, say every second how much the environment has grown to,
# but not to CI.
beside_its_size = $(if $(CI),$(1),$(call with_its_meter,$(1)))
with_its_meter = (was=0; while sleep 1 && kill -0 $$$$ 2>/dev/null; do now=$$(du -sm $(VENV) 2>/dev/null | cut -f1); \
  [ "$$now" = "$$was" ] || echo "  $(VENV): $$now MB"; was=$$now; done) & beat=$$!; \
  $(1); code=$$?; kill $$beat; [ $$code = 0 ]
comma := ,
# CI compiles only the modules that it imports, when it imports them, with both processors.
pip = @echo "pip install $(1)"; \
  $(call beside_its_size,$(BIN)/pip install --disable-pip-version-check $(if $(CI),--no-compile )$(1))
URDFS := $(sort $(wildcard urdf/*.urdf))
GENERATOR := $(shell find codegen -name '*.py' -o -name '*.j2' -o -name '*.[ch]')
TORCH ?= torch>=2.5
CONFIGURATIONS ?= 4194304
WORKERS ?= 2
TESTS := not slow and not wide
# A room of the tests, such as core, families/springs or lab; all by default.
ROOM ?=
CHOSEN = $(if $(ROOM),$(wildcard tests/$(ROOM) $(ROOM)/tests))
# A worker takes neighbouring tests, so that it makes what they share only once.
SPREAD := -n $(WORKERS) --dist worksteal

# A copy that 'pip install .' put into the environment, without -e, hides this source; so does another clone's link.
PACKAGES := $(VENV)/lib/python*/site-packages
LINKED := $(shell grep -qsxF '$(CURDIR)/codegen' $(PACKAGES)/*stiffgen*.pth && echo yes)
ifneq ($(LINKED) $(wildcard $(PACKAGES)/stiffgen/__init__.py),yes )
.PHONY: $(VENV)/installed
endif

.PHONY: help generate test test-slow test-wide lint check-generated docs report dist bench bench-cuda campaign compare clean
.DELETE_ON_ERROR:

help:  ## print this list
	@awk -F ':.*## ' '/^[a-z].*:.*## / {printf "  make %-16s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

generate: $(VENV)/installed  ## generate and build every robot in urdf/, and print one result (2 minutes)
	@set -e; for urdf in $(URDFS); do $(BIN)/stiffgen generate $$urdf; done
	@$(BIN)/python examples/bowl_posture.py

test: $(VENV)/installed-test  ## run the quick tests or those of ROOM=control (9 minutes)
	$(if $(ROOM),$(if $(CHOSEN),,$(error ROOM=$(ROOM) has no tests; rooms are $(filter-out data support __pycache__,$(notdir $(patsubst %/,%,$(wildcard tests/*/)))) fri ros2)))
	$(BIN)/python -m pytest $(SPREAD) -m '$(TESTS)' $(CHOSEN)

test-slow: $(VENV)/installed-test  ## run the other tests, with the short forms of the campaigns (20 minutes)
	$(BIN)/python -m pytest $(SPREAD) -m 'slow and not wide' $(CHOSEN)

test-wide: $(VENV)/installed-test  ## run further robots, compilers and pages of what test-slow tests: before a release (hours)
	$(BIN)/python -m pytest $(SPREAD) -m wide

lint: $(VENV)/installed-test  ## run ruff, mypy and reuse (20 s)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/reuse lint --lines

check-generated: $(VENV)/installed  ## compare generated/iiwa14 with what the generator writes (10 s)
	@set -e; fresh=$$(mktemp -d); trap 'rm -rf "$$fresh"' EXIT; \
	$(BIN)/stiffgen generate urdf/iiwa14.urdf --no-build --output "$$fresh" >/dev/null; \
	versions() { sed -n '/"versions"/,/}/p' "$$1/manifest.json" | tr -d ' "\n'; }; \
	made=$$(versions generated/iiwa14); here=$$(versions "$$fresh/iiwa14"); \
	diff -r -x '*.so' -x '*.pyd' -x __pycache__ "$$fresh/iiwa14" generated/iiwa14 \
	  || { [ "$$made" = "$$here" ] || echo "generated/iiwa14 was made with other versions ($$made) than those here ($$here);" \
	    "'rm -r $(VENV)' and 'make' install those of requirements.lock" >&2; \
	  echo "generated/iiwa14 is out of date; run 'make generate' and commit what it changes" >&2; exit 1; }; \
	echo "generated/iiwa14 is what the generator writes"

docs: $(VENV)/installed-docs  ## build the pages and the reference as a site, into build/site/html/ (1 minute)
	$(BIN)/python docs/site/build.py build/site

report: docs  ## print docs/results.md as build/results.pdf (1 minute; needs chromium)
	@command -v chromium >/dev/null || { echo "chromium is not installed; on Debian: apt-get install chromium" >&2; exit 1; }
	chromium --headless --no-sandbox --disable-gpu --no-pdf-header-footer --print-to-pdf=build/results.pdf \
	  "file://$(CURDIR)/build/site/html/docs/results.html"

dist: build/dist-venv/installed $(VENV)/installed-test  ## build the wheels of stiffgen and of one robot, and check them (30 s)
	rm -rf build/dist
	$(BIN)/python -m build --no-isolation --outdir build/dist
	$(BIN)/pip wheel --quiet --no-deps --no-build-isolation --wheel-dir build/dist generated/iiwa14
	build/dist-venv/bin/twine check --strict build/dist/*

bench: $(VENV)/installed-test $(VENV)/installed-bench  ## time against what a user could take instead, into benchmarks/RESULTS.md (minutes)
	$(BIN)/python benchmarks/run.py
	$(BIN)/python -m benchmarks.pairs

bench-cuda: $(VENV)/installed-test  ## check every CUDA function, and time the joint stiffness, on this machine's GPU (minutes; needs nvcc)
	@PYTHONPATH=tests:. $(BIN)/python -m campaigns.receipts bench-cuda $(MAKE) --no-print-directory _bench-cuda

.PHONY: _bench-cuda
_bench-cuda:
	@PYTHONPATH=tests:. $(BIN)/python -m campaigns cuda
	@$(BIN)/stiffgen generate urdf/iiwa14.urdf --cuda --derivatives --no-build --output build/cuda
	nvcc -O3 -arch=native -Ibuild/cuda/iiwa14 benchmarks/cuda_stiffness.cu build/cuda/iiwa14/iiwa14.cu \
	  build/cuda/iiwa14/iiwa14.c -o build/cuda/cuda_stiffness
	build/cuda/cuda_stiffness $(CONFIGURATIONS)
	$(BIN)/python benchmarks/cuda_peers.py build/cuda
	$(BIN)/python benchmarks/cuda_grid.py build/cuda/grid

# Campaigns of one package more than the tests have.
campaign: $(VENV)/installed-test $(patsubst %,$(VENV)/installed-%,$(filter fuzz torch drake,$(NAME)))
campaign: $(if $(filter rounding-errors targets,$(NAME)),generate)
campaign:  ## run a long search: NAME=..., OPTIONS="...", RECEIPT=yes to record it; without a name, list them (minutes to hours)
	@PYTHONPATH=tests:. $(BIN)/python -m campaigns $(if $(RECEIPT),--receipt) $(NAME) $(OPTIONS)

compare: $(VENV)/installed-test  ## compare the controller with laws in use, into docs/results.md (minutes to hours)
	@PYTHONPATH=tests:. $(BIN)/python -m campaigns compare

clean:  ## remove what the above made, but not generated/
	rm -rf $(VENV) build .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
	rm -f generated/*/*.so

# Examples: each with the robot that it needs.
EXAMPLES := experiment flutter whole-body adaptive optimal-control fri-demo
.PHONY: $(EXAMPLES)
experiment: build/robots/iiwa14_plate build/robots/iiwa14_ball  ## run the paper's two experiments (3 minutes)
	$(BIN)/python -m examples.bowl_wiping
	$(BIN)/python -m examples.parkour
flutter: $(VENV)/installed-examples  ## push a ball joint that three drives hold, and one on a spring (1 minute)
	@mkdir -p build
	$(BIN)/python -m examples.flutter --figure build/flutter.svg --film build/flutter_film.svg
whole-body: build/robots/solo12  ## find the stiffness of a standing quadruped (4 minutes)
	$(BIN)/python -m examples.whole_body
adaptive: build/robots/iiwa14_derivatives  ## adapt the stiffness on an energy tank (1 minute)
	$(BIN)/python -m examples.adaptive
optimal-control: build/robots/iiwa14_wiping  ## choose the task stiffness along a trajectory (1 minute)
	$(BIN)/python -m examples.optimal_control
fri-demo: build/robots/iiwa14_plate  ## run the FRI client against a simulated LBR (5 minutes)
	@$(BIN)/python -m fri.robot.demo

iiwa14_derivatives := urdf/iiwa14.urdf --derivatives
iiwa14_wiping := urdf/iiwa14.urdf --tool xyz=0,0,0.24 --derivatives --no-masses
solo12 := tests/data/solo12.urdf --floating-base $(foreach foot,FL FR HL HR,--tip $(foot)_FOOT)
build/robots/%: urdf/iiwa14.urdf tests/data/solo12.urdf $(GENERATOR) $(VENV)/installed-examples
	$(BIN)/stiffgen generate $($*) --name $* --output build/robots
	@touch $@
iiwa14_plate := bowl_wiping
iiwa14_ball := parkour
build/robots/iiwa14_plate build/robots/iiwa14_ball: build/robots/%: urdf/iiwa14.urdf examples/experiments/tool.py \
  examples/bowl_wiping/tool.py examples/parkour/tool.py $(GENERATOR) $(VENV)/installed-examples
	$(BIN)/python -m examples.$($*).tool --output build/robots
	@touch $@

# The virtual environment, and what is installed into it: a file for each of pyproject.toml's extras.
# The generator's packages are locked by version and hash: without the mesh libraries that yourdfpy asks for, and that
# reading a URDF does not need, the environment takes a third less of the disk.
$(VENV)/installed: pyproject.toml requirements.lock
	@$(PYTHON) -c 'import sys; sys.exit("stiffgen needs Python 3.11 or newer; set PYTHON=") if sys.version_info < (3, 11) else 0'
	@echo "making the environment $(VENV), up to 15 s ..."
	@$(call beside_its_size,$(PYTHON) -m venv $(VENV)) \
	  || { echo "python3 -m venv failed; on Debian: apt-get install python3-venv" >&2; exit 1; }
	@echo "installing the packages of requirements.lock, 500 MB, usually 1 minute ..."
	$(call pip,--no-deps --require-hashes --requirement requirements.lock)
	$(call pip,--no-deps --no-build-isolation --editable .)
	@touch $@

.PHONY: lock
lock: build/lock-venv/installed  ## resolve the generator's packages anew, into requirements.lock
	@echo 'trimesh>=4' > build/lock-venv/without-extras.txt
	@printf 'hatchling>=1.25\neditables>=0.5\n' > build/lock-venv/builds-the-package.in
	build/lock-venv/bin/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-annotate \
	  --custom-compile-command 'make lock' --overrides build/lock-venv/without-extras.txt \
	  pyproject.toml build/lock-venv/builds-the-package.in --output-file requirements.lock
build/lock-venv/installed:
	@$(PYTHON) -m venv build/lock-venv
	build/lock-venv/bin/pip install --quiet --disable-pip-version-check uv
	@touch $@

build/dist-venv/installed:
	@$(PYTHON) -m venv build/dist-venv
	build/dist-venv/bin/pip install --quiet --disable-pip-version-check twine
	@touch $@


# The pip that comes with Python 3.11 needs a minute more than today's to choose 200 packages, but it will do, too.
$(VENV)/installed-test: $(VENV)/installed
	-$(call pip,--upgrade pip)
	$(call pip,--editable '.[test$(comma)lint]')
	$(call pip,--no-deps 'lerobot>=0.4.4')
	@touch $@

# What CI needs, found and installed at once.
$(VENV)/installed-ci: $(VENV)/installed
	-$(call pip,--upgrade pip)
	$(call pip,--editable '.[test$(comma)lint$(comma)docs$(comma)fuzz]')
	$(call pip,--no-deps 'lerobot>=0.4.4')
	@touch $(patsubst %,$(VENV)/installed-%,test docs fuzz) $@

$(VENV)/installed-torch: $(VENV)/installed-test
	$(call pip,'$(TORCH)')
	@touch $@

$(VENV)/installed-%: $(VENV)/installed
	$(call pip,--editable '.[$*]')
	@touch $@
