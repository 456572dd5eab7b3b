# make            what can be made
# make PYTHON=python3.12 setup        another interpreter (3.11 or newer)
# make PIP_ARGS="--extra-index-url URL" setup
#     further arguments for pip. What pip takes as torch by default on Linux is its CUDA build (several GB).
#     On a machine without a GPU, name the index of torch's CPU builds here; with a GPU, name the index of the
#     build for your CUDA version, or nothing.
# make LOCK=none setup      newest packages within the ranges of pyproject.toml, not those of requirements/*.txt
# make TEST_JOBS=8 test               so many tests at once
# make SECONDS=600 fuzz              so long for each reader of files
# make DATA=FOLDER experiments        FOLDER holds contactnets_cube and pll_elbow (docs/results/index.md)
# make DATA=FOLDER tagslam            FOLDER holds tagslam_test (docs/results/vision.md)

PYTHON   ?= python3
PIP_ARGS ?=
LOCK     ?= auto
UV_ARGS  ?=
LOCK_ARGS := --quiet --extra dev --universal --python-version 3.11.5 --generate-hashes --no-header --no-annotate --upgrade
VENV     := .venv
BIN      := $(VENV)/bin
STAMP    := $(VENV)/.installed
DEV      := $(VENV)/.developing
TEST_JOBS ?= 2
SECONDS  ?= 60
UNAUDITED ?= refused
DATA     ?= $(or $(TOSSID_SHARED_DATA),../shared/data)
RUN_ONE  := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1

.DEFAULT_GOAL := help
.PHONY: help setup lock demo experiments coverage calibration unknown shapes links starts fields tagslam truth test coverage-report test-slow fuzz check format dependencies bench bench-against mutants docs figures clean distclean

help:  ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-15s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(STAMP)  ## build the environment in .venv (once); tests and checks add what they need

LOCKS := $(wildcard requirements/*)
WHICH_LOCK = lock=$(LOCK); [ "$$lock" != auto ] || lock=$$($(BIN)/python requirements/choose.py $(PIP_ARGS)) || exit 2
INSTALL = $(BIN)/python requirements/install.py

# what runs tossid
$(STAMP): pyproject.toml $(LOCKS)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
	  || { echo "tossid needs Python 3.11 or newer as '$(PYTHON)'; name another: make PYTHON=python3.12 $(MAKECMDGOALS)" >&2; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) \
	  || { rm -rf $(VENV); echo "could not make $(VENV); on Debian and Ubuntu: apt install python3-venv" >&2; exit 2; }
	@$(WHICH_LOCK); \
	if [ "$$lock" = none ]; then \
	  $(INSTALL) $(PIP_ARGS) -e .; \
	else \
	  $(INSTALL) --only requirements/run.names requirements/$$lock.txt $(PIP_ARGS) --require-hashes && \
	  $(BIN)/python -m pip install --quiet --no-deps --no-build-isolation -e .; \
	fi
	@$(RUN_ONE) $(BIN)/python -m pipelines.compile_kernels
	@touch $@

# what tests, checks and documents it, beside that
$(DEV): $(STAMP)
	@$(WHICH_LOCK); \
	if [ "$$lock" = none ]; then \
	  $(INSTALL) $(PIP_ARGS) -e '.[dev]'; \
	else \
	  $(INSTALL) $(PIP_ARGS) --require-hashes -r requirements/$$lock.txt; \
	fi
	@touch $@

lock: $(STAMP)  ## resolve requirements/*.txt anew: make UV_ARGS="--index URL" lock, where URL has torch's CPU builds
	$(BIN)/python -m pip install --quiet $(PIP_ARGS) uv
	$(BIN)/uv pip compile $(LOCK_ARGS) -o requirements/cuda.txt pyproject.toml
	@mkdir -p build
	sed -n 's/^\(torch==[0-9.]*\).*/\1+cpu/p' requirements/cuda.txt > build/override.txt
	$(BIN)/uv pip compile $(LOCK_ARGS) $(UV_ARGS) --override build/override.txt -o requirements/cpu.txt pyproject.toml
	printf 'editables\nhatchling\n' > build/build.in
	$(BIN)/uv pip compile $(filter-out --extra dev --generate-hashes --upgrade,$(LOCK_ARGS)) -c requirements/cuda.txt pyproject.toml build/build.in \
	  | sed -n 's/^\([A-Za-z0-9._-]*\)==.*/\1/p' | sort -u > requirements/run.names

demo: $(STAMP)  ## a simulator that is wrong in a sealed way, and what is found of it: make SEED=5 demo
	$(BIN)/python -m pipelines.demo $(if $(SEED),--seed $(SEED))

# what the studies read: made where it is missing
DATASETS := data/datasets
NOISE    := noise.position=0.00005 noise.rotation=0.0005 noise.velocity=0.005 noise.spin=0.05
$(DATASETS)/contactnets_cube.h5: | $(STAMP)
	$(BIN)/tossid ingest source=contactnets source.path=$(DATA)/contactnets_cube object=cube out=$@
$(DATASETS)/pll_elbow.h5: | $(STAMP)
	$(BIN)/tossid ingest source=pll source.path=$(DATA)/pll_elbow object=elbow defects=set_aside out=$@
$(DATASETS)/simulated_cube/tosses.h5: | $(STAMP)
	$(BIN)/tossid synthesize engine=lcp frames=false tosses=200 seed=1 $(NOISE) out=$(@D)
$(DATASETS)/mujoco_elbow/tosses.h5: | $(STAMP)
	$(BIN)/tossid synthesize object=elbow engine=mujoco frames=false tosses=256 seed=5 out=$(@D)
$(DATASETS)/simulated_elbow/tosses.h5: | $(STAMP)
	$(BIN)/tossid synthesize object=elbow engine=lcp frames=false tosses=80 seed=1 'splits=[0.6,0.2,0.2]' $(NOISE) \
	  noise.joint=0.0005 noise.joint_rate=0.05 out=$(@D)

# a study (conf/sweep) and what it reads, in order; each goes on where it was
STUDIES := gravity_full:contactnets_cube.h5 e2e:contactnets_cube.h5 baselines:contactnets_cube.h5 \
  data_efficiency:contactnets_cube.h5 inertia:simulated_cube/tosses.h5 gravity:simulated_cube/tosses.h5 \
  elbow:mujoco_elbow/tosses.h5 inertia:simulated_elbow/tosses.h5 elbow_real:pll_elbow.h5

experiments: $(addprefix $(DATASETS)/,$(sort $(foreach study,$(STUDIES),$(lastword $(subst :, ,$(study))))))  ## the studies on published recordings, hours: make DATA=FOLDER experiments
	@set -e; for study in $(STUDIES); do \
	  echo "tossid evaluate --sweep $${study%%:*} data=$(DATASETS)/$${study#*:}"; \
	  $(BIN)/tossid evaluate --sweep $${study%%:*} data=$(DATASETS)/$${study#*:}; \
	done

coverage: $(STAMP)  ## do intervals of learned parameters hold the truth? 100 sets of made tosses, a quarter of an hour
	$(RUN_ONE) $(BIN)/python -m experiments.coverage outputs/coverage.jsonl $(OPTIONS)

calibration: $(STAMP)  ## are intervals right? diagnoses of effects drawn at random, hours; goes on where it was
	$(BIN)/tossid audit cases=200 seed=1 'kinds=[effect]' 'engines=[lcp]' tosses=16 repeats=0 $(OPTIONS)

unknown: $(STAMP)  ## the published cube learned from nothing, beside its stated object: make DATA=FOLDER unknown
	$(RUN_ONE) $(BIN)/python -m experiments.starts outputs/starts.jsonl $(DATA) --nothing --tosses 64 16 8 $(OPTIONS)

starts: $(STAMP)  ## the published cube from 20 random starts: make DATA=FOLDER OPTIONS="--models cn --tosses 32" starts
	$(RUN_ONE) $(BIN)/python -m experiments.starts outputs/starts.jsonl $(DATA) --random 20 $(OPTIONS)

shapes: $(STAMP)  ## shapes tossed in MuJoCo, learned from nothing: make OPTIONS="--shapes ellipsoid --seeds 1" shapes
	$(RUN_ONE) $(BIN)/python -m experiments.shapes outputs/shapes.jsonl $(OPTIONS)

links: $(STAMP)  ## an elbow in MuJoCo, both links learned from nothing: make OPTIONS="--recorded elbow.h5" links
	$(RUN_ONE) $(BIN)/python -m experiments.links outputs/links.jsonl $(OPTIONS)

fields: $(STAMP)  ## fields of force in a learned acceleration, a quarter of an hour: make OPTIONS="--fields vortex" fields
	$(RUN_ONE) $(BIN)/python -m experiments.fields outputs/fields.jsonl $(OPTIONS)

tagslam: $(STAMP)  ## TagSLAM's published recordings against its own poses: make DATA=FOLDER tagslam
	$(RUN_ONE) $(BIN)/python -m experiments.vision.against_tagslam $(DATA)

truth: $(STAMP)  ## filmed tosses from images to velocities, against the truth; half an hour
	$(RUN_ONE) $(BIN)/python -m experiments.vision.against_truth

test: $(DEV)  ## the tests
	$(RUN_ONE) $(BIN)/python -m pytest -q -n $(TEST_JOBS)

coverage-report: $(DEV)  ## which lines and branches of tossid and pipelines the tests reach; slower than make test
	$(BIN)/coverage erase
	$(RUN_ONE) $(BIN)/coverage run -m pytest -q -n $(TEST_JOBS)
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage report --skip-covered --sort=cover

test-slow: $(DEV)  ## the tests that take minutes
	$(RUN_ONE) $(BIN)/python -m pytest -q -n $(TEST_JOBS) -m slow

fuzz: $(STAMP)  ## search for files that crash what reads them (atheris; Linux)
	$(BIN)/python -m pip install --quiet $(PIP_ARGS) -e '.[fuzz]'
	$(RUN_ONE) $(BIN)/python -m tests.fuzz.run --seconds $(SECONDS)

check: $(DEV)  ## formatter, linter, type checker, import rules
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(DEV)  ## format and fix what can be fixed
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

dependencies: $(DEV)  ## what is installed fits together, and has no known vulnerability (asks osv.dev)
	$(BIN)/python -m pip check
	@if $(BIN)/python -c 'import socket; socket.create_connection(("api.osv.dev", 443), 5)' 2>/dev/null; then \
	  $(BIN)/pip-audit --vulnerability-service osv --skip-editable --progress-spinner off; \
	else \
	  echo "NOT AUDITED for known vulnerabilities: osv.dev cannot be reached (UNAUDITED=allowed goes on)" >&2; \
	  [ "$(UNAUDITED)" = allowed ]; \
	fi

bench: $(STAMP)  ## speed of the simulators, the training and the command line
	$(BIN)/python -m benchmarks.bench

bench-against: $(STAMP)  ## the simulator's speed beside an earlier commit's, in turns: make COMMIT=NAME bench-against
	$(BIN)/python -m benchmarks.bench_against $(COMMIT)

mutants: $(DEV)  ## small faults in the sources, and the tests that notice them; hours: make OPTIONS="--count 6" mutants
	$(RUN_ONE) $(BIN)/python -m benchmarks.mutants $(OPTIONS)

docs: $(DEV)  ## the documentation as a site, in build/site
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

figures: $(STAMP)  ## the gallery, docs/gallery.md, on tosses made here; some minutes
	$(RUN_ONE) $(BIN)/python -m experiments.gallery

clean:  ## remove caches and logs (never data, runs or the environment)
	rm -rf .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache outputs/logs
	find . -name __pycache__ -type d -not -path './$(VENV)/*' -prune -exec rm -rf {} +

distclean: clean  ## also remove the environment
	rm -rf $(VENV)
