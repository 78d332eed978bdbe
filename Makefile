# Everything a fresh machine needs is Python >= 3.11, make and a package registry.
PYTHON ?= python3
VENV := .venv
PY := $(VENV)/bin/python
RUN := runs/ppt_push

.PHONY: demo push study test check bench clean

# Evaluate the published PPT policy: table, figure and video in runs/demo.
demo: $(VENV)/.installed
	$(PY) recipes/evaluate.py pretrained/ppt_push --episodes 128 --film 2 --report runs/demo

# Train PPT on box pushing (or go on with a run that was cut off), then evaluate: table, figures, video, checkpoint.
push: $(VENV)/.installed
	$(PY) recipes/ppo_ppt_push.py --run-dir $(RUN) $(if $(wildcard $(RUN)/checkpoints/*),--resume)
	$(PY) recipes/evaluate.py $(RUN) --per-box --baseline --report $(RUN)/report

# Compare the four variants over three seeds (hours; go on by running it again): results/push.
study: $(VENV)/.installed
	$(PY) recipes/study.py --task push --seeds 3 --episodes 512 --pretrained pretrained

# Run the tests.
test: $(VENV)/.installed
	$(PY) -m pytest -n auto --dist loadfile

# Format, lint, types.
check: $(VENV)/.installed
	$(PY) -m ruff format --check .
	$(PY) -m ruff check .
	$(PY) -m mypy

# Control steps a second, against MuJoCo alone.
bench: $(VENV)/.installed
	$(PY) benchmarks/step_rate.py

clean:
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis

$(VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(PY) -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	touch $@
