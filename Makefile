# Everything a user or a developer runs; each target makes the environment it needs.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test test-slow lint bench robots instructions soak schema clean

# Of BLAS: at the size of a step more threads only add noise.
ONE := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1

# What the extension is built from.
NATIVE := $(wildcard native/*/*.cpp native/*/*.hpp native/CMakeLists.txt)

# The stamp is newer than these files when the environment has what the project asks for.
$(VENV)/demo.stamp: pyproject.toml $(NATIVE)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --editable '.[menagerie,render]'
	touch $@

$(VENV)/test.stamp: pyproject.toml $(NATIVE)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --editable '.[menagerie,render,test]'
	touch $@

demo: $(VENV)/demo.stamp
	$(BIN)/rmrc solve configs/panda_line.yaml

# In two processes, a file in one of them: what its tests share is made once.
test: $(VENV)/test.stamp
	$(ONE) $(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

test-slow: $(VENV)/test.stamp
	$(BIN)/python -m pytest -m slow

lint: $(VENV)/test.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python native/check_includes.py
	$(BIN)/lint-imports
	$(BIN)/pyright

bench: $(VENV)/test.stamp
	$(BIN)/python bench/peers/environments.py
	$(ONE) $(BIN)/python bench/step.py --json bench/results.json
	$(ONE) $(BIN)/python bench/methods.py
	$(ONE) $(BIN)/python bench/safety.py --json bench/results.json
	$(ONE) $(BIN)/python bench/batch.py --json bench/results.json
	$(ONE) $(BIN)/python bench/jitter.py --json bench/results.json
	$(ONE) $(BIN)/python bench/slowest.py --json bench/results.json
	$(ONE) $(BIN)/python bench/scaling.py --json bench/results.json --plot docs/scaling.svg
	$(BIN)/python bench/still.py docs/unreachable.svg
	$(BIN)/python bench/table.py

# Every model file of other people's packages, in an environment of its own: hours.
robots: $(VENV)/test.stamp
	$(ONE) $(BIN)/python bench/robots.py --json bench/robots.json --table docs/robots.md

instructions: $(VENV)/test.stamp
	$(ONE) $(BIN)/python bench/instructions.py --check

soak: $(VENV)/test.stamp
	$(ONE) $(BIN)/python bench/soak.py --workers 2 --json bench/results.json

schema: $(VENV)/test.stamp
	$(BIN)/rmrc schema > rmrc.schema.json

clean:
	rm -rf $(VENV) bench/peers/.venvs runs comparisons .pytest_cache .ruff_cache .hypothesis
