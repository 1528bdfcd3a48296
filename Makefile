# make demo    render the sample scenes to out/
# make test    ruff, mypy and the tests; those of HTML reports are skipped without Chromium
#              (apt install chromium), which fails the run where CI is set
# make check   ruff and mypy alone
# make bench   error and time on the sample scenes, then the tests that measure time
# make clean   remove what these made, .venv too
#
# Each first makes .venv and installs into it what is missing. Variables:
#   PYTHON=python3.12       the Python to make .venv with
#   ARGS="-n 0 -k lens"     words for pytest, which runs two processes by default

PYTHON ?= python3
ARGS ?=
RUN := .venv/bin/python -m
PIP := $(RUN) pip install -q --disable-pip-version-check
STAMP := .venv/installed
TESTED := .venv/installed-for-tests

# Versions known to work together, what they ask for included; pyproject.toml asks for less.
PINS := torch==2.13.0 numpy==2.4.6 OpenEXR==3.5.3 OpenImageIO==3.2.2.0 click==8.5.1 tqdm==4.70.1 \
  hypothesis==6.170.15 mypy==2.4.1 playwright==1.65.2 greenlet==3.5.6 pytest==9.2.0 pytest-xdist==3.8.0 ruff==0.17.5 \
  setuptools==84.2.1 \
  ast_serialize==0.13.1 execnet==2.1.2 filelock==4.2.11 fileseq==3.4.0 fsspec==2026.9.0 iniconfig==2.3.1 \
  Jinja2==3.1.6 librt==0.16.0 llvmlite==0.50.0 MarkupSafe==3.0.4 mpmath==1.3.0 msgspec==0.22.0 mypy_extensions==1.2.0 \
  networkx==3.6.1 numba==0.68.1 packaging==26.3 pathspec==1.1.1 pluggy==1.7.0 Pygments==2.21.0 \
  sortedcontainers==2.4.0 sympy==1.14.0 typing_extensions==4.16.0

# Of the libraries that only some users need, which the tests need all of.
EXTRA_PINS := PyYAML==6.0.4 anyio==4.16.0 braceexpand==0.1.7 cloudpickle==3.1.3 contourpy==1.3.3 cycler==0.12.1 \
  dask==2026.8.0   datasets==5.2.0 dill==0.4.1 distributed==2026.8.0 flip-evaluator==1.7 fonttools==4.68.0 h11==0.16.0 h5py==3.16.0 \
  hf-xet==1.8.0 httpcore2==2.16.2 httpx2==2.16.2 huggingface_hub==2.4.0 idna==3.20 \
  importlib_metadata==10.2.0 kiwisolver==1.5.1 lazy-importer==0.1.0 locket==1.0.0 \
  matplotlib==3.11.2 msgpack==1.2.4 multiprocess==0.70.19 pandas==3.1.1 partd==1.4.2 \
  pillow==13.0.0 pillow-heif==1.8.1 psutil==7.2.2 pyarrow==26.0.1 pyparsing==3.3.3 \
  python-dateutil==4.0.0 scipy==1.17.1 tblib==3.2.2 tifffile==2026.3.3 toolz==1.2.0 tornado==6.6.1 \
  truststore==0.10.5 tzdata==2026.6 webdataset==1.0.2 xxhash==4.1.0 zict==3.0.0 zipp==4.1.2

.PHONY: help demo check test bench clean again

help:
	@sed -n '/^#/!q; s/^# \{0,1\}//p' Makefile

demo: $(STAMP)
	.venv/bin/python sample_scenes/demo.py --out out

check: $(STAMP)
	$(RUN) ruff check
	$(RUN) ruff format --check
	$(RUN) mypy

test: check $(TESTED)
	$(RUN) pytest -n 2 $(ARGS)

bench: $(TESTED)
	.venv/bin/defocus bench
	$(RUN) pytest -m bench $(ARGS)

clean:
	rm -rf .venv out build *.egg-info .*_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Scripts of a virtual environment hold its path: one that has been moved is made again.
ifneq ($(shell cat $(STAMP) 2>/dev/null),$(CURDIR))
$(STAMP): again
endif

$(STAMP): pyproject.toml Makefile
	@command -v $(PYTHON) >/dev/null || \
	  { echo "$(PYTHON): not found; install Python 3.11 or newer, or name one: make PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "$(PYTHON): is older than 3.11; name a newer one: make PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
	  { echo "$(PYTHON): has no venv; install it (Debian, Ubuntu: apt install python3-venv)" >&2; exit 1; }
	@echo 'Installing PyTorch and the rest into .venv; the first time takes a few minutes.'
	@$(PYTHON) -m venv .venv
	@$(PIP) $(PINS)
	@$(PIP) $(PINS) --no-build-isolation -e '.[dev]'
	@echo '$(CURDIR)' >$@

$(TESTED): $(STAMP)
	@echo 'Installing what only the tests need into .venv.'
	@$(PIP) $(PINS) $(EXTRA_PINS) --no-build-isolation -e '.[tests]'
	@touch $@
