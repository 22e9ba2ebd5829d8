# `make help` lists the targets. Each does the set-up it needs; nothing else has to be run first.
SHELL := /bin/sh
VENV := .venv
RUN := . $(VENV)/setup.sh &&
# Half of the tests of nodes is waiting: more than twice the cores of a small machine.
WORKERS ?= 5
.DEFAULT_GOAL := help
.NOTPARALLEL:  # the steps share .venv, and each takes all cores itself
.PHONY: help setup messages kernels config demo robot-demo test lint build bench evaluate compare losses fuzz kills flips interruptions soak mutants clean

# Stamps, one for each step, so that a step is repeated only when what it reads has changed.
LIBRARIES := $(VENV)/.libraries
MESSAGES := $(VENV)/.messages
OTHERS := $(VENV)/.others
KERNELS := $(VENV)/.kernels
PACKAGE := $(VENV)/.package
INTERFACES := $(wildcard msg_defs msg_defs/* msg_defs/msg/*)
OTHER_INTERFACES := $(wildcard test/interfaces/* test/interfaces/*/* test/interfaces/*/*/*)
# Sourcing Jazzy from apt, or no longer doing so, asks for another environment; so does another place.
# An environment of wheels that is sourced itself is none of apt's.
PREFIXES := $(filter-out $(CURDIR)/$(VENV),$(subst :, ,$(AMENT_PREFIX_PATH)))
ROS := $(if $(and $(filter jazzy,$(ROS_DISTRO)),$(wildcard $(addsuffix /share/rclpy,$(PREFIXES)))),apt,wheels)
ifneq ($(subst none,wheels,$(file <$(VENV)/.ros)) $(file <$(VENV)/.place),$(ROS) $(CURDIR))
.PHONY: $(LIBRARIES)
endif

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1: /p' Makefile | awk -F': ' '{printf "  make %-10s %s\n", $$1, $$2}'

READY := $(LIBRARIES) $(MESSAGES) $(KERNELS) $(PACKAGE)

setup: $(OTHERS) $(READY) ## make .venv with ROS 2 Jazzy, all libraries, messages, kernels and mv_slapse

$(LIBRARIES): .setup/environment.sh $(wildcard .setup/*.txt)
	@sh .setup/environment.sh $(VENV)
	@touch $@

$(MESSAGES): $(LIBRARIES) .setup/messages.sh setup.py $(INTERFACES)
	@sh .setup/messages.sh $(VENV) msg_defs
	@touch $@

# Messages of other packages, too, which the tests need and no package index has; side by side.
$(OTHERS): $(LIBRARIES) .setup/messages.sh setup.py $(INTERFACES) $(OTHER_INTERFACES)
	@sh .setup/messages.sh $(VENV) msg_defs test/interfaces/*/
	@touch $(MESSAGES) $@

$(KERNELS): $(LIBRARIES) .setup/kernels.sh setup.py mv_slapse/kernels \
        $(wildcard mv_slapse/kernels/*.cpp mv_slapse/kernels/*.hpp mv_slapse/kernels/CMakeLists.txt)
	@sh .setup/kernels.sh $(VENV)
	@touch $@

$(PACKAGE): $(LIBRARIES) .setup/package.sh setup.py setup.cfg package.xml $(wildcard config/* mv_slapse/launch/*)
	@sh .setup/package.sh $(VENV)
	@touch $@

messages: $(OTHERS) ## generate the messages of msg_defs into .venv

kernels: $(KERNELS) ## compile the kernels of mv_slapse/kernels into .venv

config: setup ## write config/*.yaml, docs/parameters.md, docs/diagnostics.md and the SROS2 policy
	@$(RUN) python -m mv_slapse.tools.parameter_files config
	@$(RUN) python -m mv_slapse.tools.parameter_table docs/parameters.md
	@$(RUN) python -m mv_slapse.tools.state_table docs/diagnostics.md
	@$(RUN) python -m mv_slapse.tools.security_policy docs/topics.md config/sros2_policy.xml

demo: $(READY) ## render a street with known truth, run everything on it, write out/demo
	@$(RUN) mv_slapse demo -o out/demo

out/demo/video.mpg: $(READY)
	@$(RUN) mv_slapse demo -o out/demo --quiet

robot-demo: setup out/demo/video.mpg ## play the demo into the four nodes over DDS, write out/robot_demo
	@$(RUN) cd test && PYTHONPATH=.:..:$$PYTHONPATH python system/robot_demo.py ../out/demo ../out/robot_demo

# Pictures that tests render are made of arrays of megabytes; glibc gives each back to the system, and
# pages that come anew take a third of the time of rendering. Other C libraries do not read these.
HEAP := MALLOC_MMAP_THRESHOLD_=33554432 MALLOC_TRIM_THRESHOLD_=134217728 MALLOC_TOP_PAD_=33554432

test: setup ## run all tests, real ROS nodes included
	@$(RUN) $(HEAP) python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder $(ARGS)

lint: setup ## check style, known dangers (bandit), and that libraries have the versions that were tested
	@$(RUN) ruff check .
	@$(RUN) bandit -q -r mv_slapse
	@$(RUN) python .setup/pinned.py

build: setup ## colcon build (also --symlink-install), start every node, colcon test, in a temporary workspace
	@sh .setup/workspace.sh

bench: setup ## measure the speed of each stage
	@set -e; $(RUN) for script in benchmarks/speed.py benchmarks/consistency.py; do \
	    [ -e "$$script" ] || { echo 'make bench: there is no benchmark in benchmarks/ yet'; exit 2; }; \
	    echo "== $$script"; python "$$script"; done

evaluate: setup ## run every sequence in ../shared/data and write docs/results.md
	@$(RUN) python -m mv_slapse.tools.evaluate $(ARGS)

compare: $(READY) ## run the papers as printed and others beside the package, and write docs/comparison.md
	@$(RUN) python benchmarks/compare.py $(ARGS)

# The long tests; what they last gave stands in docs/reliability.md.
RELIABILITY := cd test && OPENBLAS_NUM_THREADS=1 PYTHONPATH=.:..:$$PYTHONPATH python reliability

losses: setup ## leave out packets of every codec (ARGS="--places 50 --given 12")
	@$(RUN) $(RELIABILITY)/losses.py $(ARGS)

fuzz: setup ## damage streams, messages, bags, files (ARGS="--streams 300 --messages 400 --bags 50 --files 50")
	@$(RUN) $(RELIABILITY)/fuzz.py $(ARGS)

kills: setup ## kill the four nodes while a street is driven (ARGS="--moments 100")
	@$(RUN) $(RELIABILITY)/kills.py $(ARGS)

flips: setup ## flip a bit a second in a real drive (ARGS="--seeds 10")
	@$(RUN) $(RELIABILITY)/bit_flips.py $(ARGS)

interruptions: setup ## fill the disk, kill a run, cut a bag (ARGS="--places 20 --moments 100 --cuts 100")
	@$(RUN) $(RELIABILITY)/interruptions.py $(ARGS)

soak: setup ## play a minute of video and watch the memory (ARGS="--minutes 60" for an hour)
	@$(RUN) $(RELIABILITY)/soak.py $(ARGS)

mutants: setup ## plant 60 mistakes, one after another, and run the tests near by (ARGS="--every 6" for some)
	@$(RUN) $(RELIABILITY)/mutants.py $(ARGS)

clean: ## remove what the targets above have made, .venv included
	rm -rf $(VENV) build install log out *.egg-info .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
