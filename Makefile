# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0

BIN := .venv/bin
CORE_SOURCES = $(shell find core -name '*.[ch]pp')

# Nothing leaves this machine, and no sourced ROS or Python path leaks in.
export ROS_AUTOMATIC_DISCOVERY_RANGE = LOCALHOST
unexport AMENT_PREFIX_PATH PYTHONPATH PYTHONHOME

.PHONY: help demo dist development test test-slow lint format bench tables alarm discovery discovery-independent discovery-hidden discovery-real models intervals rollouts nanodrone pictures golden fuzz environment clean

help: ## list these targets
	@sed -n 's/^\([a-z-]*\):.*## /\1|/p' $(MAKEFILE_LIST) | while IFS='|' read -r target text; do \
	    printf 'make %-14s %s\n' "$$target" "$$text"; done

demo: environment ## identify, predict, replay through live nodes, report (DEMO_ARGS="--data FOLDER --rate 4")
	@$(BIN)/quadpi demo $(DEMO_ARGS)

# The tests of one marker: on all cores, and beside them those of live nodes, which wait more than they compute, by
# two workers, each in a ROS domain of its own; these go first where cores are short, and print when all have ended.
# Readers of files are forks, which take 22 in the place of 37 ms where glibc asks for memory in large pages.
# With TEST_ARGS, those that it names, in one process.
define run_tests
@sh tools/bootstrap.sh --test --train
$(if $(TEST_ARGS),\
    @$(BIN)/python -m pytest -m "$(1)" $(TEST_ARGS),\
    @mkdir -p out; \
    $(BIN)/python -m pytest -m "$(1)" --numprocesses 2 --dist loadfile test/ros >out/live-tests.log 2>&1 & live=$$!; \
    OMP_NUM_THREADS=1 GLIBC_TUNABLES=glibc.malloc.hugetlb=1 nice -n 5 \
        $(BIN)/python -m pytest -m "$(1)" --numprocesses auto --dist worksteal --ignore test/ros; \
    others=$$?; wait $$live; live=$$?; cat out/live-tests.log; exit $$((others | live)))
endef

test: ## the fast tests, live nodes included (TEST_ARGS="-k intervals -x" for some)
	$(call run_tests,not slow)

test-slow: ## the other tests: cluster, statistics, real flights, commands of the documents, searches, fuzzing
	$(call run_tests,slow)

lint: development ## ruff, clang-format, mypy, the order of the rooms and the house rules, as CI runs them
	@$(BIN)/ruff check
	@$(BIN)/ruff format --check
	@$(BIN)/clang-format --dry-run --Werror $(CORE_SOURCES)
	@$(BIN)/mypy
	@$(BIN)/lint-imports --no-logo
	@$(BIN)/python tools/house_rules.py

format: development ## format the code and mend what ruff can mend
	@$(BIN)/ruff format
	@$(BIN)/clang-format -i $(CORE_SOURCES)
	@$(BIN)/ruff check --fix

bench: ## every benchmark, each against its baseline, into out/bench.json (ONLY=name for one)
	@sh tools/bootstrap.sh --test --train --bench
	@$(BIN)/python -m benchmarks $(if $(ONLY),--only $(ONLY))

tables: ## renew experiments/results/paper-tables.md (TABLES_ARGS="--only tunnel --data FOLDER")
	@sh tools/bootstrap.sh --test --train
	@$(BIN)/python experiments/paper_tables.py $(TABLES_ARGS)

nanodrone: development ## the nano-drone benchmark, beside what is published (NANODRONE_TEST=FOLDER of test flights)
	@$(BIN)/python experiments/nanodrone.py $(NANODRONE_TEST)

discovery: development ## renew experiments/results/discovery.md: searches for hidden effects, scored (DISCOVERY_ARGS="--short")
	@$(BIN)/python experiments/discovery.py $(DISCOVERY_ARGS)

discovery-independent: ## searches for effects hidden in flights of RotorPy (DISCOVERY_ARGS="--short", "--reserved")
	@sh tools/bootstrap.sh --test --train --bench
	@$(BIN)/python experiments/discovery_independent.py $(DISCOVERY_ARGS)

discovery-hidden: development ## exact changes hidden in real flights of QUADPI_DATA (DISCOVERY_ARGS="--half report", "--short")
	@$(BIN)/python experiments/discovery_hidden.py $(DISCOVERY_ARGS)

discovery-real: development ## renew experiments/results/discovery-real.md: searches on real flights, those of QUADPI_DATA
	@$(BIN)/python experiments/discovery_real.py $(DISCOVERY_ARGS)

models: ## renew experiments/results/models.md: kinds of model on real flights left out (MODELS_ARGS="--methods polynomial,physical")
	@sh tools/bootstrap.sh --test --train
	@$(BIN)/python experiments/model_methods.py $(MODELS_ARGS)

intervals: ## renew experiments/results/intervals-raced.md: our intervals against others (INTERVALS_ARGS="--methods physical")
	@sh tools/bootstrap.sh --test --train
	@$(BIN)/python experiments/intervals_raced.py $(INTERVALS_ARGS)

rollouts: development ## renew the table of experiments/results/rollouts.md: real flights predicted ahead (ROLLOUTS_ARGS="--only NeuroBEM")
	@$(BIN)/python experiments/rollout_tables.py $(ROLLOUTS_ARGS)

alarm: ## renew the tables of experiments/results/alarm.md (ALARM_ARGS="--no-ensembles --seeds 2 --data FOLDER")
	@sh tools/bootstrap.sh --test --train
	@$(BIN)/python experiments/alarm_tables.py $(ALARM_ARGS)

pictures: development ## renew the pictures of pages in docs/images, by a headless Chromium
	@QUADPI_PICTURES=docs/images $(BIN)/python -m pytest -q -k pictures test/core/view/test_view_page.py \
	    test/core/report/test_written_pages.py

golden: development ## renew the golden trace in test/golden, saying what changed (GOLDEN_ARGS=--model: its model too)
	@$(BIN)/python tools/golden_trace.py $(GOLDEN_ARGS)

fuzz: development ## damaged input for every reader, changed arguments for every public call (FUZZ_ARGS="--minutes 2 --formats mcap api")
	@$(BIN)/python -m benchmarks.fuzzing $(FUZZ_ARGS)

dist: development ## source archive and wheel in dist/, the wheel tried in an environment of its own
	@sh tools/dist.sh $(BIN)/python

environment: ## make or update .venv (PYTHON=python3.12 to choose the interpreter)
	@sh tools/bootstrap.sh

development: ## what tests and lint need beside it
	@sh tools/bootstrap.sh --test

clean: ## remove .venv and everything built or written
	rm -rf .venv build dist install log out .mypy_cache .pytest_cache .ruff_cache
