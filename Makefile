# Everything a newcomer needs: make study, make test. The environment is made on first use in .venv.
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
export BAYESCAL_TRUST := 1  # the repository's own configs run its own code
THREADS := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1

.PHONY: study real audits reproduce update-manifests test test-runs test-browser test-dask test-nautilus test-slow check docs dist data picture benchmark hostile clean help

help:
	@echo "make study      the telescope study: environment, run, ranking, report (two to three minutes on two cores)"
	@echo "make real       real machines, really measured: six of them (about ten minutes)"
	@echo "make audits     all shipped identifiability audits"
	@echo "make reproduce  the papers: RR-8096, Yu 2023 and Sika 2008, all that their pages in docs name"
	@echo "make test       environment and the quick tests"
	@echo "make test-runs  whole small experiments, seconds each"
	@echo "make test-slow  the slow statistical suites"
	@echo "make test-dask  schedulers and workers of dask, killed and late (installs dask.distributed)"
	@echo "make test-nautilus  posteriors and evidence by another library's sampler (installs nautilus)"
	@echo "make test-browser  every kind's page in the system's Chromium (installs playwright, no browser)"
	@echo "make check      linter, types (installs basedpyright), import contracts"
	@echo "make update-manifests  the manifests of committed results, of the files that git has of them"
	@echo "make data       simulate the shipped twins again"
	@echo "make docs       the documentation, its tutorials run, into docs/_build/html (installs Sphinx)"
	@echo "make dist       the wheel, into dist"
	@echo "make picture    README's picture of a report, from committed results (needs Chromium)"
	@echo "make hostile    mutated configs, tables and results, kills, full disks and runs that meet; on and on for MINUTES"
	@echo "make benchmark  speed of every model, and against NUTS (installs numpyro)"

study: $(STAMP)
	$(THREADS) $(BIN)/bayescal run experiments/telescope/study.toml

real: $(STAMP)
	$(THREADS) $(BIN)/bayescal run experiments/hangprinter/study.toml
	$(THREADS) $(BIN)/bayescal run experiments/mmt_mount/study.toml
	$(THREADS) $(BIN)/bayescal run experiments/flsun_v400/study.toml
	$(THREADS) $(BIN)/bayescal run experiments/jugglebot/study.toml
	$(THREADS) $(BIN)/bayescal run experiments/panda_socket/study.toml
	$(THREADS) $(BIN)/bayescal run experiments/ur10/study.toml
	$(THREADS) $(BIN)/bayescal run experiments/ur10/study_300.toml

audits: $(STAMP)
	@for design in $(filter-out %_mechanism.toml %_tracker.toml,$(wildcard experiments/audit/*.toml)); do \
	  echo "$$design" && $(THREADS) $(BIN)/bayescal audit $$design || exit $$?; \
	done

PAPERS := rr8096/figure5 telescope/study telescope/model_error telescope/ridges telescope/table5 telescope/table6 \
  telescope/table7 yu2023/table1 yu2023/table4 yu2023/table8 yu2023/figure10 pose_selection/rr8096_figure14 \
  sika2008/calibrations

reproduce: $(STAMP)
	@for paper in $(PAPERS); do \
	  echo "$$paper" && $(THREADS) $(BIN)/bayescal run experiments/$$paper.toml || exit $$?; \
	done

test: $(STAMP)
	$(THREADS) $(BIN)/python -m pytest -q -n 2 --dist loadfile

test-runs: $(STAMP)
	$(THREADS) $(BIN)/python -m pytest -q -n 2 --dist loadfile -m "runs and not slow"

test-dask: $(STAMP)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[dask]"
	$(THREADS) $(BIN)/python -m pytest -q -m "slow or not slow" tests/experiments/runner/test_distributed.py

test-nautilus: $(STAMP)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[nautilus]"
	$(THREADS) $(BIN)/python -m pytest -q -m "runs or not runs" tests/inference/test_samplers.py

test-browser: $(STAMP)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[browser]"
	$(THREADS) $(BIN)/python -m pytest -q -m slow tests/report tests/experiments/runner/test_pages_in_browser.py

test-slow: $(STAMP)
	$(THREADS) $(BIN)/python -m pytest -q -n 2 -m slow

check: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[types]"
	$(BIN)/python -m pytest -q -m "runs or not runs" tests/typed

update-manifests: $(STAMP)
	rm -rf build/manifests && git checkout-index --prefix=build/manifests/ $$(git ls-files results)
	@for provenance in $$(git ls-files 'results/*/provenance.json'); do \
	  folder=$$(dirname $$provenance) && rm -f build/manifests/$$folder/manifest.json && \
	  $(BIN)/bayescal update-manifest build/manifests/$$folder && cp build/manifests/$$folder/manifest.json $$folder || exit $$?; \
	done

data: $(STAMP)
	@for folder in telescope m2_hexapod m2_hexapod_table hexaglide camera_hexapod; do \
	  $(BIN)/bayescal simulate experiments/$$folder/simulate.toml --out experiments/$$folder/data || exit $$?; \
	done
	@for month in january february march april may june; do \
	  $(BIN)/bayescal simulate experiments/m2_hexapod_sessions/$$month.toml \
	    --out experiments/m2_hexapod_sessions/data/$$month || exit $$?; \
	done

docs: $(STAMP)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[docs]"
	$(THREADS) $(BIN)/python -m sphinx --fail-on-warning --keep-going --fresh-env --jobs 2 -q docs docs/_build/html

dist: $(STAMP)
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir dist .

picture: $(STAMP)
	$(BIN)/python docs/make_picture.py

benchmark: $(STAMP)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[benchmark]"
	$(BIN)/python benchmarks/likelihood.py
	$(BIN)/python benchmarks/sampling.py --dense-mass --name sampling_dense_mass

hostile: $(STAMP)
	$(THREADS) $(BIN)/python tests/fuzz/suite.py --minutes $(or $(MINUTES),0) --write docs/hostile.md

clean:
	rm -rf $(VENV) build *.egg-info

# A Python of at least 3.12, whatever it is called here; a clear word where there is none.
$(STAMP): pyproject.toml constraints.txt
	@python=""; \
	for name in $(PYTHON) python3 python3.12 python3.13 python3.14 python; do \
	  if command -v $$name >/dev/null 2>&1 && $$name -c 'import sys, venv; sys.exit(sys.version_info < (3, 12))' >/dev/null 2>&1; \
	  then python=$$name; break; fi; \
	done; \
	if [ -z "$$python" ]; then \
	  echo "bayescal needs Python 3.12 or newer with venv; found: $$(python3 --version 2>&1 || echo none)." >&2; \
	  echo "Install it, or name it: make PYTHON=/path/to/python3.12 $(MAKECMDGOALS)" >&2; exit 2; \
	fi; \
	echo "making the environment in $(VENV) with $$($$python --version)"; \
	$$python -m venv $(VENV) && \
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[dev]" && \
	touch $(STAMP)
