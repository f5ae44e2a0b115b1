# Everything runs from wheels in .venv, whatever ROS the shell has sourced: mixing the two loads libraries of both.
PYTHON ?= python3
BIN := .venv/bin
REQUIREMENTS := requirements/requirements.txt
SETUP := .venv/.done
EXECUTABLES := install/flatsat_ros/lib/flatsat_ros
# the loop of a Crazyflie 2.1 at 50 Hz: lag of its profile, 30 ms for motion capture, computation and radio
CF21 := --vehicle cf21 --thrust-max-g 1.45 --rate 1.25 --period 0.02 --delay 0.03
SOURCED := . install/setup.sh &&
ARGS ?=

PYTHON_NOBLE ?= $(firstword $(wildcard $(HOME)/.pyenv/versions/3.12*/bin/python) $(shell command -v python3.12))
NOBLE := .venv-noble
WITHOUT_ROS := $(addprefix test/,base law certificate flight crazyflie synthesis plans planning identification sim falsification demo test_fuzz.py paper/test_errata.py paper/test_offset_free.py paper/test_tracking.py)
NOBLE_REQUIREMENTS := requirements/noble.txt
NOBLE_SETUP := $(NOBLE)/.done

# the oldest and the newest Python, for test-kernels, as far as they are found
python_found = $(firstword $(wildcard $(HOME)/.pyenv/versions/$(1)*/bin/python) $(shell command -v python$(1)))
EXTREMES := $(foreach version,3.10 3.13,$(if $(call python_found,$(version)),.venv-$(version)))

unexport PYTHONPATH AMENT_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH RMW_IMPLEMENTATION _ROS_WHEELS_BOOTSTRAP_COMPLETE
# every node that starts, and every worker of the tests, would compile the package again
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help setup build demo test test-noble test-kernels bench reproduce falsify faults soak fuzz lint docs identification certificates designs clean test-browser test-crazyswarm2

help:  ## this list
	@grep -hE '^[a-z0-9-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## */\t/' | expand -t 18

setup: $(SETUP)  ## .venv from pinned requirements, for scripts, too; PYTHON=python3.12 chooses the interpreter

$(SETUP): $(REQUIREMENTS)
	@$(PYTHON) -c 'import sys; (3, 10) <= sys.version_info[:2] <= (3, 13) or sys.exit("flatsat_ros needs Python 3.10-3.13, $(PYTHON) is " + sys.version.split()[0] + ": make setup PYTHON=python3.12")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --disable-pip-version-check --requirement $(REQUIREMENTS)
	@# the source, for scripts; what install/setup.sh puts on PYTHONPATH goes before it
	for packages in .venv/lib/python3*/site-packages; do echo ../../../.. > $$packages/flatsat_ros.pth; done
	touch $@

build: setup  ## colcon build into install/
	rm -rf build/flatsat_ros install/flatsat_ros  # colcon leaves modules behind that the source has no more
	$(BIN)/colcon build --packages-select flatsat_ros

demo: build  ## three simulated drones swap places; ARGS="--seconds 10" and so on
	$(SOURCED) $(EXECUTABLES)/demo $(ARGS)

test: build  ## every test, on what was installed; ARGS="-k swap" and so on
	$(SOURCED) $(BIN)/pytest --numprocesses auto --dist loadgroup $(ARGS)

test-noble: $(NOBLE_SETUP)  ## the tests without ROS with the versions of Ubuntu 24.04
	$(NOBLE)/bin/python -m pytest --numprocesses auto $(ARGS) $(WITHOUT_ROS)

$(NOBLE_SETUP): $(NOBLE_REQUIREMENTS)
	$(if $(PYTHON_NOBLE),,$(error test-noble needs Python 3.12: make test-noble PYTHON_NOBLE=/path/to/python3.12))
	$(PYTHON_NOBLE) -m venv $(NOBLE)
	$(NOBLE)/bin/python -m pip install --disable-pip-version-check --requirement $(NOBLE_REQUIREMENTS)
	touch $@

test-kernels: setup $(EXTREMES:%=%/.done)  ## law, flight layer, certificates, synthesis as on other processors, and on Python 3.10 and 3.13
	$(BIN)/python test/kernels.py --certificate="$(CF21)" --pytest="--numprocesses auto $(ARGS)" $(BIN)/python $(EXTREMES:%=%/bin/python)

.venv-3.%/.done: $(REQUIREMENTS)
	$(call python_found,3.$*) -m venv $(@D)
	$(@D)/bin/python -m pip install --disable-pip-version-check --requirement $(REQUIREMENTS)
	touch $@

test-browser: build .venv/.browser  ## the pages as a person uses them; needs Debian's chromium and chromium-driver
	$(SOURCED) $(BIN)/pytest $(ARGS) test/viewing/browser_report.py test/viewing/browser_console_page.py test/nodes/browser_console.py test/nodes/browser_console_life.py

.venv/.browser: requirements/browser.txt
	$(BIN)/python -m pip install --disable-pip-version-check --requirement $<
	touch $@

test-crazyswarm2: build .venv-crazyswarm2/.done  ## flights with crazyswarm2 itself, SOURCE=CHECKOUT of it; PACKAGES="more interfaces to build"
	$(SOURCED) $(BIN)/python test/crazyswarm2.py --python .venv-crazyswarm2/bin/python --source "$(SOURCE)" $(PACKAGES:%=--package %) $(ARGS)

.venv-crazyswarm2/.done: requirements/crazyswarm2.txt
	$(BIN)/python -m venv $(@D)
	$(@D)/bin/python -m pip install --disable-pip-version-check --requirement $<
	touch $@

bench: build .venv/.bench  ## the benchmark against solvers and a bare rclpy node; ARGS="--missions FOLDER" plans those
	$(SOURCED) $(BIN)/python bench/run.py $(ARGS)

.venv/.bench: requirements/bench.txt
	$(BIN)/python -m pip install --disable-pip-version-check --requirement $<
	touch $@

reproduce: build  ## every number and figure of the paper, computed again, into out/reproduce/
	$(SOURCED) $(EXECUTABLES)/reproduce $(ARGS)

falsify: build  ## a million closed loops against certificates; ARGS="--runs 20000" and so on
	$(SOURCED) $(EXECUTABLES)/falsify $(ARGS)

faults: build  ## every fault in every phase of flight, into out/faults/; ARGS="--fault y_up" and so on
	$(SOURCED) $(EXECUTABLES)/faults $(ARGS)

soak: build  ## ten simulated drones for an hour, into out/soak/; ARGS="--minutes 1" and so on
	$(SOURCED) $(EXECUTABLES)/soak $(ARGS)

fuzz: build  ## a million bad inputs for whatever reads what others wrote, into out/fuzz/; ARGS="--kind recording" and so on
	$(SOURCED) $(BIN)/python test/fuzz.py $(ARGS)

identification: setup  ## predictions and intervals on real flights, DATA=FOLDER of CSV logs of one drone, and on simulated ones
	OMP_NUM_THREADS=1 $(BIN)/python bench/identification.py $(DATA) $(ARGS)

certificates: build  ## the certificates in config/, computed again; those of whole loops from stored designs, without a search
	$(SOURCED) $(EXECUTABLES)/synthesize --paper all --output-dir config --force
	$(SOURCED) $(EXECUTABLES)/synthesize $(CF21) --output config/cf21_50hz.yaml --force
	$(SOURCED) OMP_NUM_THREADS=1 $(EXECUTABLES)/synthesize --designs config/designs/flight.yaml --output-dir config --force

designs: build  ## search designs of flight certificates for the packaged profiles again, into out/designs/; minutes each
	mkdir -p out/designs
	$(SOURCED) for vehicle in brushless cf21 cf21_plus cf2x_2025 thrust_kit; do for gain in 1.5 4; do \
		OMP_NUM_THREADS=1 $(EXECUTABLES)/synthesize --flight --vehicle $$vehicle --gain-max $$gain --output out/designs/$${vehicle}_$$gain.yaml --force $(ARGS) || exit; \
	done; done

lint: setup  ## style, format and types: ruff, mypy --strict over the whole package
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: setup  ## the reference of the Python API, into docs/api/, a warning is an error; and docs/flight_modes.md
	$(BIN)/python docs/build_api.py
	$(BIN)/python docs/build_flight_modes.py

clean:  ## remove what was built, not .venv
	rm -rf build install log out docs/api .coverage .hypothesis .mypy_cache .pytest_cache .ruff_cache
