# make            what can be made
# make PYTHON=python3.12 setup        another interpreter (3.11 or newer)
# make PIP_ARGS="--extra-index-url URL" setup
#     further arguments for pip. torch is pinned to an exact version; what pip takes by default on Linux
#     is its CUDA build (several GB). On a machine without a GPU, name the index of torch's CPU builds here;
#     with a GPU, name the index of the build for your CUDA version, or nothing.
# make TEST_JOBS=8 test               so many tests at once
# make SECONDS=600 fuzz              so long for each reader of files
# make DATA=FOLDER experiments        FOLDER holds contactnets_cube (README.md, "Studies")
# make DATA=FOLDER tagslam            FOLDER holds tagslam_test (docs/experiments/vision.md)

PYTHON   ?= python3
PIP_ARGS ?=
VENV     := .venv
BIN      := $(VENV)/bin
STAMP    := $(VENV)/.installed
TEST_JOBS ?= 2
SECONDS  ?= 60
DATA     ?= $(or $(TOSSID_SHARED_DATA),../shared/data)
RUN_ONE  := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1

.DEFAULT_GOAL := help
.PHONY: help setup demo experiments tagslam truth test test-slow fuzz check format dependencies bench scale docs figures clean distclean

help:  ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(STAMP)  ## build the environment in .venv (once)

$(STAMP): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
	  || { echo "tossid needs Python 3.11 or newer as '$(PYTHON)'; name another: make PYTHON=python3.12 $(MAKECMDGOALS)" >&2; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) \
	  || { rm -rf $(VENV); echo "could not make $(VENV); on Debian and Ubuntu: apt install python3-venv" >&2; exit 2; }
	$(BIN)/python -m pip install --quiet $(PIP_ARGS) -e '.[dev]'
	@touch $@

demo: $(STAMP)  ## the main job, end to end, on embedded defaults
	$(BIN)/python -m pipelines.demo

experiments: $(STAMP)  ## the studies on published recordings, hours: make DATA=FOLDER experiments
	$(BIN)/python -m pipelines.experiments $(DATA)

tagslam: $(STAMP)  ## TagSLAM's published recordings against its own poses: make DATA=FOLDER tagslam
	$(RUN_ONE) $(BIN)/python -m pipelines.against_tagslam $(DATA)

truth: $(STAMP)  ## filmed tosses from images to velocities, against the truth; half an hour
	$(RUN_ONE) $(BIN)/python -m pipelines.against_truth

test: $(STAMP)  ## the tests
	$(RUN_ONE) $(BIN)/python -m pytest -q -n $(TEST_JOBS)

test-slow: $(STAMP)  ## the tests that take minutes
	$(RUN_ONE) $(BIN)/python -m pytest -q -n $(TEST_JOBS) -m slow

fuzz: $(STAMP)  ## search for files that crash what reads them (atheris; Linux)
	$(BIN)/python -m pip install --quiet $(PIP_ARGS) -e '.[fuzz]'
	$(RUN_ONE) $(BIN)/python -m tests.fuzz.run --seconds $(SECONDS)

check: $(STAMP)  ## formatter, linter, type checker, import rules
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(STAMP)  ## format and fix what can be fixed
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

dependencies: $(STAMP)  ## what is installed fits together, and has no known vulnerability (asks osv.dev)
	$(BIN)/python -m pipelines.dependencies

bench: $(STAMP)  ## speed of the simulators, the training and the command line
	$(BIN)/python -m pipelines.bench

scale: $(STAMP)  ## time and memory of the commands against tosses, minutes of film and workers, hours
	$(RUN_ONE) $(BIN)/python -m pipelines.scale

docs: $(STAMP)  ## the documentation as a site, in build/site
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict

figures: $(STAMP)  ## the gallery, docs/gallery.md, on tosses made here; some minutes
	$(RUN_ONE) $(BIN)/python -m pipelines.gallery

clean:  ## remove caches and logs (never data, runs or the environment)
	rm -rf .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache outputs/logs
	find . -name __pycache__ -type d -not -path './$(VENV)/*' -prune -exec rm -rf {} +

distclean: clean  ## also remove the environment
	rm -rf $(VENV) *.egg-info
