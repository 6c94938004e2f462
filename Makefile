# SPDX-License-Identifier: Apache-2.0
# make demo                        render a test scene, reconstruct it, relight it, show the report
# make demo CAPTURE=path [MASKS=dir] [DEMO=dir]   the same for a capture of your own
# make test                        everything the project checks about itself
# make setup                       only the environment; .venv/bin/robir is then the command

PYTHON ?= $(shell command -v python3.11 || command -v python3 || echo python3.11)
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DEMO ?= demo

# What Blender's wheel links against and a bare Debian lacks.
SYSTEM_LIBRARIES := libXrender.so.1 libXfixes.so.3 libXi.so.6 libxkbcommon.so.0 libSM.so.6 libGL.so.1
SYSTEM_PACKAGES := libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libgl1

.PHONY: setup demo test fast lint system-packages
.DEFAULT_GOAL := setup

setup: $(STAMP)
	@missing=`$(BIN)/python -c "$$CHECK_LIBRARIES" $(SYSTEM_LIBRARIES)`; \
	if [ -n "$$missing" ]; then \
	  echo "Blender's wheel needs system libraries that are missing: $$missing"; \
	  echo "On Debian or Ubuntu:  sudo apt-get install $(SYSTEM_PACKAGES)"; exit 1; \
	fi

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null || { \
	  echo "Python 3.11 is needed (Blender's wheel knows no other); found none as '$(PYTHON)'."; \
	  echo "Install it, or name it: make setup PYTHON=/path/to/python3.11"; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || { \
	  rm -rf $(VENV); echo "On Debian or Ubuntu:  sudo apt-get install python3-venv"; exit 1; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[blender,dev]'
	@touch $@

define CHECK_LIBRARIES
import ctypes, sys
for name in sys.argv[1:]:
    try:
        ctypes.CDLL(name)
    except OSError:
        print(name, end=" ")
endef
export CHECK_LIBRARIES

# As root on Debian or Ubuntu; a machine that only runs the tests uses it.
system-packages:
	apt-get update -qq && apt-get install -y -qq --no-install-recommends $(SYSTEM_PACKAGES)

demo: setup
	@BIN=$(BIN) sh -c "$$RUN_DEMO" demo "$(DEMO)" "$(CAPTURE)" "$(MASKS)"

# A capture in, an asset, a relit picture and a report out; without one a test scene is rendered.
define RUN_DEMO
set -eu
folder=$$1
capture=$${2:-}
masks=$${3:-}

if [ -z "$$capture" ]; then
  capture=$$folder/capture
  result=$$folder/truck
  "$$BIN/python" -m blender_scenes truck "$$capture" \
    --view-transform Filmic --resolution 160 --views 40
  truth=$$capture
else
  result=$$folder/$$(basename "$$capture")
  truth=
fi

"$$BIN/robir" check "$$capture" $${masks:+--masks "$$masks"}
"$$BIN/robir" reconstruct "$$capture" -o "$$result" --resume $${masks:+--masks "$$masks"}
if [ -n "$$truth" ]; then
  "$$BIN/robir" evaluate "$$result" --truth "$$truth"
fi

report=$$result/report/index.html
echo
echo "Asset:   $$result/export/asset.glb"
echo "Scene:   $$result/export/scene.blend"
echo "Report:  $$report"
if [ -n "$${DISPLAY:-}$${WAYLAND_DISPLAY:-}" ] && command -v xdg-open >/dev/null; then
  xdg-open "$$report"
fi
endef
export RUN_DEMO

lint: setup
	$(BIN)/ruff check core tests blender_scenes robir_addon
	$(BIN)/ruff format --check core tests blender_scenes robir_addon
	$(BIN)/lint-imports
	$(BIN)/pyright --pythonpath $(BIN)/python

test: lint
	$(BIN)/python -m pytest -q

fast: lint
	$(BIN)/python -m pytest -q -m 'not slow'
