#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# What Slurm runs: robir with the words that follow; in an array the task's number is one of them.
if [ -n "$SLURM_ARRAY_TASK_ID" ]; then set -- "$@" --task "$SLURM_ARRAY_TASK_ID"; fi
exec "$ROBIR_PYTHON" -P -m robir "$@"
