# One place for set-up and checks. Needs python3 (3.10 or newer, with venv) and nothing else.
#
#   make demo       set up, run the main job with ROS 2 on, print a summary
#   make test       set up, run the tests            make test-slow   soaks and second distributions
#   make check      format, lint, types, imports     make bench       side by side measurements
#   make venv       only the set-up                  make docs       write the API reference to out/docs
#   make test-fast  a minute of them, at each save   make test-changed  those that a change touches
#   make clean      remove what was built            make faults     measure each fault, write out/faults.md
#   make pictures   make the pictures of the documents

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/unicon.stamp

# What the demo runs, and how long one test may take in [s].
DEMO_WORKFLOW ?= go2_walk
DEMO_ARGS ?=
FAULTS_ARGS ?=
TEST_TIMEOUT ?= 120
TEST_ARGS ?=
# Files of tests that run at once; tests marked `alone` measure time and have the machine for themselves.
TEST_JOBS ?= 2
# All that `unicon bench` knows.
BENCHES ?= $(shell $(BIN)/python -c 'from unicon_ros.cli.bench import BENCHES; print(*BENCHES)')

# The ROS wheels start Python twice and leave these two to child processes, where they would load
# another venv's libraries. A sourced ROS needs its LD_LIBRARY_PATH, so it goes only with the guard.
ifdef _ROS_WHEELS_BOOTSTRAP_COMPLETE
unexport LD_LIBRARY_PATH
endif
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE

# ROS stays on this machine unless the user says otherwise.
demo bench faults: export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
demo bench faults: export ROS_DOMAIN_ID ?= 42
# Plain pipelines find each other at once; our own nodes do so by themselves.
bench faults: export FASTRTPS_DEFAULT_PROFILES_FILE ?= $(CURDIR)/config/dds/fast_discovery.xml
bench faults: export FASTDDS_DEFAULT_PROFILES_FILE ?= $(FASTRTPS_DEFAULT_PROFILES_FILE)

.PHONY: help venv demo test test-fast test-changed test-slow check format docs pictures bench faults clean clean-venv
.DEFAULT_GOAL := help

help:
	@sed -n '3,9s/^# *//p' Makefile

venv: $(STAMP)

$(STAMP): setup.py pyproject.toml tools/lib/make_venv.py
	$(PYTHON) tools/lib/make_venv.py $(VENV)
	@touch $@

demo: $(STAMP)
	@mkdir -p out/demo
	$(BIN)/unicon run $(DEMO_WORKFLOW) --ros --report out/demo/report.json \
		--picture out/demo/report.png $(DEMO_ARGS)

test: $(STAMP)
	$(BIN)/python -m pytest -q --timeout=$(TEST_TIMEOUT) -n $(TEST_JOBS) --dist loadfile \
		--no-loadscope-reorder $(TEST_ARGS)

# What one runs at each save: folders that take no processes, no ROS and a minute.
FAST := analysis blocks controls flow gap map members models schema teleop trajectory
SINCE ?= HEAD

test-fast: $(STAMP)
	$(BIN)/python -m pytest -q --timeout=$(TEST_TIMEOUT) -n $(TEST_JOBS) --dist worksteal \
		-m "not slow and not alone" $(TEST_ARGS) $(addprefix test/,$(FAST))

# By the imports of the tests; SINCE=main for all of a branch.
test-changed: $(STAMP)
	@files=$$($(BIN)/python tools/lib/changed_tests.py $(SINCE)); test -z "$$files" || \
		$(BIN)/python -m pytest -q --timeout=$(TEST_TIMEOUT) -n $(TEST_JOBS) --dist loadfile \
		--no-loadscope-reorder $(TEST_ARGS) $$files

# Parts of the slow tests, by folders of test/; `others` is what no part names.
SLOW_ros := ros
SLOW_processes := clients interop ros_slow
SLOW_packages := packaging
SLOW_robots := attack gates hardware
SLOW_simulators := ik images models peripherals platforms terrain transfer whole_body
SLOW_check := check
SLOW_fuzz := fuzz mutation
SLOW_files := map policies workflow
SLOW_soak := bench faults runtime soak states
SLOW_PARTS := ros processes packages robots simulators check fuzz files soak
SLOW_others := $(filter-out $(foreach part,$(SLOW_PARTS),$(SLOW_$(part))),\
	$(patsubst test/%/,%,$(dir $(wildcard test/*/*.py))) $(notdir $(wildcard test/test_*.py)))
PART ?=

test-slow: $(STAMP)
	$(if $(PART),$(if $(SLOW_$(PART)),,$(error PART=$(PART) is none of: $(SLOW_PARTS) others)))
	$(BIN)/python -m pytest -q --timeout=1800 -m slow $(TEST_ARGS) \
		$(if $(PART),$(addprefix test/,$(sort $(SLOW_$(PART)))))

check: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(STAMP)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

docs: $(STAMP)
	$(BIN)/pdoc -d google -o out/docs unicon_base unicon_core unicon_msgs_map unicon_ros unicon_sims unicon_hardware \
		unicon_manipulation unicon_lab "!unicon_ros.bench"
	@echo "out/docs/index.html"

# Half an hour; with Chromium, playwright and the public models (UNICON_ASSETS).
pictures: $(STAMP)
	$(BIN)/python tools/lib/gallery.py
	$(BIN)/python tools/lib/pictures_of_reports.py
	$(BIN)/python tools/lib/picture_of_page.py
	$(BIN)/python tools/lib/picture_of_teleoperation.py

bench: $(STAMP)
	@mkdir -p out/bench
	@for bench in $(BENCHES); do $(BIN)/unicon bench $$bench --json out/bench/$$bench.json || exit 1; done

# An hour; FAULTS_ARGS="--ticks 1" takes less.
faults: $(STAMP)
	$(BIN)/unicon bench faults --assert --markdown out/faults.md $(FAULTS_ARGS)

clean:
	rm -rf build dist out *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find . -path ./$(VENV) -prune -o -name __pycache__ -type d -print | xargs rm -rf

clean-venv:
	rm -rf $(VENV)
