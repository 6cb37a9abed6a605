# make generate   virtual environment, then generate and build every robot in urdf/, and print one real result
# make test       the tests to wait for (4 min)  make check-generated   regenerate the robots of urdf/ and compare with
# make test-torch the wrapper for PyTorch, which is too large for the others: in none of them (TORCH= another wheel)
# make test-drake  Drake's conventions (docs/conventions.md), likewise
# make test-slow  the rest of the tests                                what is committed
# make lint       ruff and mypy                  make clean             remove what the above made (not generated/)
# make fuzz       the URDF reader, ten minutes   make random-robots     many random chains against Pinocchio
# make robots     real robots against Pinocchio, into docs/robots.md
# make bench      against what a user could take instead, into benchmarks/RESULTS.md
# make bench-cuda  the joint stiffness on this machine's GPU (needs nvcc)
# make experiment   the paper's bowl wiping in simulation, into examples/bowl_wiping/results/
# make identify   a task stiffness and a tool learned from a recording, by JAX; make identify-torch by PyTorch
# make adaptive   a stiffness that learns while the arm works, bounded by the controller's tank
# make optimal-control  postures and task stiffnesses for a wanted joint stiffness, by CasADi and IPOPT
# make whole-body   a quadruped on springs: predicted and simulated modes, into examples/whole_body/results/
# make fri-demo     the bowl wiped by the C++ client through FRI, with a simulated robot, into build/fri-demo/
# make fri-fuzz   the FRI client, a million hostile datagrams in each version under the sanitizers
# make fri-attack  hill-climbing attack on the FRI client, 20 000 hostile sessions in each version (some 20 minutes)
# make spring-digits  every spring with all axes against 60 digits, 1000 poses a case (some minutes)
# make random-warnings  gcc at every level on random robots
# make single-precision  float against double: times of batches in one run, errors of 10^6 states against their bounds
# make float-sines  every float through the generated sine and cosine (some minutes a build)
# make docs       these pages and the reference as a site, into build/site/html/, without network; its links are followed
# make soak       the controller: a million hostile steps under sanitizers, valgrind and an aborting allocator
# make closed-loop  the controller on a simulated arm: 500 random situations, 100 000 adversarial energy schedules, 10^7
#                   hostile steps with 10^5 bit flips under sanitizers; each part also alone: settle, energy, hostile
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
URDFS := $(sort $(wildcard urdf/*.urdf))
WORKERS ?= 2
# A worker takes tests in a row, so that it makes what a file's tests share once.
SPREAD := -n $(WORKERS) --dist worksteal
CONFIGURATIONS ?= 4194304
GENERATOR := $(shell find codegen -name '*.py' -o -name '*.j2' -o -name '*.[ch]')

TORCH ?= torch>=2.5
FUZZ ?= -max_total_time=600
COUNT ?= 100000
FRI_FUZZ ?= -runs=1000000
FRI_ATTACK ?= --sessions 20000

.PHONY: generate test test-torch test-drake test-slow lint check-generated fuzz random-robots robots bench bench-cuda experiment whole-body identify identify-torch adaptive optimal-control fri-demo fri-fuzz fri-attack random-warnings docs soak spring-digits closed-loop settle energy hostile clean rounding-errors targets single-precision float-sines
.DELETE_ON_ERROR:

$(VENV)/installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit("stiffgen needs Python 3.10 or newer; set PYTHON=") if sys.version_info < (3, 10) else 0'
	@$(PYTHON) -m venv $(VENV) || { echo "python3 -m venv failed; on Debian: apt-get install python3-venv" >&2; exit 1; }
	$(BIN)/pip install --quiet --disable-pip-version-check --editable .
	@touch $@

$(VENV)/installed-test: $(VENV)/installed
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[test,lint]'
	@touch $@

generate: $(VENV)/installed
	@set -e; for urdf in $(URDFS); do $(BIN)/stiffgen generate $$urdf; done
	@$(BIN)/python examples/bowl_posture.py

test: $(VENV)/installed-test
	$(BIN)/python -m pytest $(SPREAD) -m 'not slow'

test-slow: $(VENV)/installed-test
	$(BIN)/python -m pytest $(SPREAD) -m slow

$(VENV)/installed-torch: $(VENV)/installed-test
	$(BIN)/pip install --quiet --disable-pip-version-check '$(TORCH)'
	@touch $@

test-torch: $(VENV)/installed-torch
	$(BIN)/python -m pytest tests/campaigns/torch_wrapper.py

$(VENV)/installed-drake: $(VENV)/installed-test
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[test,drake]'
	@touch $@

test-drake: $(VENV)/installed-drake
	$(BIN)/python -m pytest tests/campaigns/drake_conventions.py

lint: $(VENV)/installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

check-generated: $(VENV)/installed
	@set -e; fresh=$$(mktemp -d); trap 'rm -rf "$$fresh"' EXIT; \
	$(BIN)/stiffgen generate urdf/iiwa14.urdf --no-build --output "$$fresh" >/dev/null; \
	diff -r -x '*.so' -x '*.pyd' -x __pycache__ "$$fresh/iiwa14" generated/iiwa14 \
	  || { echo "generated/ is out of date; run 'make generate' and commit what it changes" >&2; exit 1; }; \
	echo "generated/ is what the generator writes"

build/robots/iiwa14_plate: urdf/iiwa14.urdf examples/bowl_wiping/tool.py $(GENERATOR) $(VENV)/installed
	$(BIN)/python -m examples.bowl_wiping.tool --output build/robots
	@touch $@

$(VENV)/installed-examples: $(VENV)/installed
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[examples]'
	@touch $@

experiment: build/robots/iiwa14_plate $(VENV)/installed-examples
	$(BIN)/python -m examples.bowl_wiping

build/robots/iiwa14_tool: urdf/iiwa14.urdf $(GENERATOR) $(VENV)/installed-examples
	$(BIN)/stiffgen generate $< --name iiwa14_tool --tool runtime --derivatives --no-masses --output build/robots
	@touch $@

identify: build/robots/iiwa14_tool
	$(BIN)/python -m examples.identify jax

identify-torch: build/robots/iiwa14_tool $(VENV)/installed-torch
	$(BIN)/python -m examples.identify torch

build/robots/iiwa14_derivatives: urdf/iiwa14.urdf $(GENERATOR) $(VENV)/installed-examples
	$(BIN)/stiffgen generate $< --name iiwa14_derivatives --derivatives --output build/robots
	@touch $@

adaptive: build/robots/iiwa14_derivatives
	$(BIN)/python -m examples.adaptive

build/robots/iiwa14_wiping: urdf/iiwa14.urdf $(GENERATOR) $(VENV)/installed-examples
	$(BIN)/stiffgen generate $< --name iiwa14_wiping --tool-xyz 0 0 0.24 --derivatives --no-masses --output build/robots
	@touch $@

optimal-control: build/robots/iiwa14_wiping
	$(BIN)/python -m examples.optimal_control

build/robots/solo12: tests/data/solo12.urdf $(GENERATOR) $(VENV)/installed
	$(BIN)/stiffgen generate $< --floating-base $(addsuffix _FOOT,$(addprefix --tip ,FL FR HL HR)) --output build/robots
	@touch $@

whole-body: build/robots/solo12 $(VENV)/installed-examples
	$(BIN)/python -m examples.whole_body

fri-demo: build/robots/iiwa14_plate $(VENV)/installed-examples
	@$(BIN)/python -m examples.fri_robot.demo

$(VENV)/installed-fuzz: $(VENV)/installed-test
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[test,fuzz]'
	@touch $@

fuzz: $(VENV)/installed-fuzz
	PYTHONPATH=tests:. $(BIN)/python tests/campaigns/fuzz_reader.py build/fuzz-corpus $(FUZZ)

fri-fuzz: $(VENV)/installed-test
	PYTHONPATH=tests:. $(BIN)/python tests/campaigns/fuzz_fri.py build/fri-fuzz $(FRI_FUZZ)

fri-attack: $(VENV)/installed-test
	PYTHONPATH=tests:. $(BIN)/python tests/campaigns/attack_fri.py build/fri-attack $(FRI_ATTACK)

random-robots: $(VENV)/installed-test
	PYTHONPATH=tests:. $(BIN)/python tests/campaigns/long_run.py --chains $(COUNT) --broken $(COUNT)

robots: $(VENV)/installed-test
	PYTHONPATH=tests:. $(BIN)/python tests/campaigns/robots_table.py build/robots docs/robots.md

$(VENV)/installed-bench: $(VENV)/installed-test
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[test,bench]'
	@touch $@

bench: $(VENV)/installed-bench
	$(BIN)/python benchmarks/run.py

bench-cuda: $(VENV)/installed
	@$(BIN)/stiffgen generate urdf/iiwa14.urdf --cuda --derivatives --no-build --output build/cuda
	nvcc -O3 -arch=native -Ibuild/cuda/iiwa14 benchmarks/cuda_stiffness.cu build/cuda/iiwa14/iiwa14.cu \
	  build/cuda/iiwa14/iiwa14.c -o build/cuda/cuda_stiffness
	build/cuda/cuda_stiffness $(CONFIGURATIONS)

spring-digits: $(VENV)/installed-test
	PYTHONPATH=tests:. $(BIN)/python tests/campaigns/springs_digits.py $(OPTIONS)

rounding-errors: $(VENV)/installed-test generate
	PYTHONPATH=tests:. $(BIN)/python tests/campaigns/rounding_errors.py $(OPTIONS)

targets: $(VENV)/installed-test generate
	PYTHONPATH=tests:. $(BIN)/python tests/campaigns/targets.py $(OPTIONS)

single-precision: $(VENV)/installed
	$(BIN)/python benchmarks/single_precision.py $(OPTIONS)

float-sines: $(VENV)/installed-test
	PYTHONPATH=tests:. $(BIN)/python tests/campaigns/float_sines.py $(OPTIONS)

random-warnings: $(VENV)/installed-test
	PYTHONPATH=tests:. $(BIN)/python tests/campaigns/compiler_warnings.py

soak: $(VENV)/installed-test
	PYTHONPATH=tests:. $(BIN)/python tests/campaigns/soak.py

closed-loop: settle energy hostile

settle energy hostile: $(VENV)/installed-test
	PYTHONPATH=tests:. $(BIN)/python tests/campaigns/$@.py $(OPTIONS)

$(VENV)/installed-docs: $(VENV)/installed
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[docs]'
	@touch $@

docs: $(VENV)/installed-docs
	$(BIN)/python docs/site/build.py build/site

clean:
	rm -rf $(VENV) build .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
	rm -f generated/*/*.so
