#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# make demo: a capture in, an asset, a relit picture and a report out.
# Usage: demo.sh FOLDER [CAPTURE [MASKS]]; without CAPTURE a test scene is rendered first.
set -eu

folder=$1
capture=${2:-}
masks=${3:-}

if [ -z "$capture" ]; then
  capture=$folder/capture
  result=$folder/truck
  "$BIN/python" -m blender_scenes truck "$capture" \
    --view-transform Filmic --resolution 160 --views 40
  truth=$capture
else
  result=$folder/$(basename "$capture")
  truth=
fi

"$BIN/robir" check "$capture" ${masks:+--masks "$masks"}
"$BIN/robir" reconstruct "$capture" -o "$result" --resume ${masks:+--masks "$masks"}
if [ -n "$truth" ]; then
  "$BIN/robir" evaluate "$result" --truth "$truth"
fi

report=$result/report/index.html
echo
echo "Asset:   $result/export/asset.glb"
echo "Scene:   $result/export/scene.blend"
echo "Report:  $report"
if [ -n "${DISPLAY:-}${WAYLAND_DISPLAY:-}" ] && command -v xdg-open >/dev/null; then
  xdg-open "$report"
fi
