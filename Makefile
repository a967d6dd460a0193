# Needs Python 3.11 or later and nothing else: the first target that is made creates .venv.
PYTHON ?= python3
EXTRAS ?= dev
BIN := .venv/bin
READY := .venv/.ready-$(EXTRAS)
unexport PYTHONDONTWRITEBYTECODE
DEMO := out/demo

.PHONY: setup demo test collected bench endurance docs dist lint changelog clean

setup: $(READY)

$(READY): pyproject.toml constraints.txt $(wildcard setup.py orchestrator/engine/*.pyx orchestrator/engine/c_loop/*.pxi)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "$(PYTHON) is older than 3.11; give another one: make PYTHON=python3.12"; exit 1; }
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt -e '.[$(EXTRAS)]'
	@$(BIN)/python -m compileall -qq -j 0 -x '/tests?/' .venv || true  # as pip does, by all processors
	@touch $@

demo: $(READY)
	$(BIN)/servotwin build --out $(DEMO)/fmus
	$(BIN)/servotwin test scenarios/butterfly/bus/procedure.yaml --out $(DEMO) -v

# Three at a time on two processors: many wait for processes, buses and compilers. PYTEST_ADDOPTS may ask for more.
test: $(READY)
	@$(MAKE) --no-print-directory -j 2 lint collected
	PYTEST_ADDOPTS="--durations=10 $$PYTEST_ADDOPTS" $(BIN)/python -m pytest -n 3 -m "not readme and not shipped"

# All tests, compiled while types are checked; each of the three processes would do it by itself.
collected: $(READY)
	@$(BIN)/python -m pytest -n 0 -m "" --collect-only -q > /dev/null 2>&1 || true  # what is wrong the tests will tell

bench endurance:
	@$(MAKE) --no-print-directory setup EXTRAS=dev,bench
	$(BIN)/python -m tests.benchmarks $(if $(filter endurance,$@),--endurance)

docs:
	@$(MAKE) --no-print-directory setup EXTRAS=dev,docs
	$(BIN)/python -m sphinx -W --keep-going -q -E docs out/docs

# Wheel, sources, the parts that they bring along (CycloneDX) and whose these are; the wheel is installed and used.
dist:
	@$(MAKE) --no-print-directory setup EXTRAS=dev,dist
	rm -rf dist build/installed
	SOURCE_DATE_EPOCH=$$(git log -1 --format=%ct 2> /dev/null || echo 315532800) $(BIN)/python -m build --outdir dist
	$(PYTHON) -m venv build/installed
	build/installed/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt dist/*.whl
	$(BIN)/cyclonedx-py environment build/installed/bin/python --pyproject pyproject.toml --output-reproducible -o dist/sbom.cdx.json
	$(BIN)/pip-licenses --python build/installed/bin/python --format plain-vertical --with-urls --with-license-file --no-license-path --output-file dist/THIRD_PARTY.txt
	build/installed/bin/python .ci/try-install.py

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# Joins the fragments in changes/ into CHANGELOG.md.
changelog:
	$(PYTHON) .ci/changelog.py

clean:
	rm -rf .venv out build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
