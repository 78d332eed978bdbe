# Everything a fresh machine needs is Python 3.11 or 3.12, make and a package registry.
PYTHON ?= python3
VENV := .venv
PY := $(VENV)/bin/python
PPT_RL := $(VENV)/bin/ppt-rl
RUN := runs/ppt_push

.PHONY: demo push study test check bench docs clean

# Judge the published PPT policy: tables, figure and video in runs/demo.
demo: $(VENV)/.installed
	$(PPT_RL) evaluate ppt_push --episodes 128 --film 2 --report runs/demo

# Train PPT on box pushing, then judge it: tables, figures, video, checkpoint. Run it again after a cut: --resume goes on
# from the last checkpoint, and starts afresh where there is none.
push: $(VENV)/.installed
	$(PY) recipes/ppo_ppt_push.py --run-dir $(RUN) --resume
	$(PPT_RL) evaluate $(RUN) --per-group --baseline --report $(RUN)/report

# Compare the four pushing variants of the paper over five seeds (hours; run it again to continue): results/push.
study: $(VENV)/.installed
	$(PPT_RL) study push --seeds 5 --episodes 512 --eval-seed 50000 60000 --publish pretrained

# Run the tests.
test: $(VENV)/.installed
	$(PY) -m pytest -n auto --dist loadfile

# Format, lint, types.
check: $(VENV)/.installed
	$(PY) -m ruff format --check .
	$(PY) -m ruff check .
	$(PY) -m mypy

# Control steps per second, compared with MuJoCo alone.
bench: $(VENV)/.installed
	$(PY) benchmarks/step_rate.py

# Build the documentation site, with every tutorial run, and fail on any warning: docs/_build/html/index.html.
docs: $(VENV)/.docs
	rm -rf docs/_build docs/api/generated docs/tutorials
	OMP_NUM_THREADS=1 $(PY) -m sphinx --fail-on-warning --keep-going --nitpicky -b html docs docs/_build/html

clean:
	rm -rf docs/_build docs/api/generated docs/tutorials
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis

$(VENV)/.installed: pyproject.toml setup.py constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(PY) -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	touch $@

$(VENV)/.docs: $(VENV)/.installed
	$(PY) -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev,docs]'
	touch $@
