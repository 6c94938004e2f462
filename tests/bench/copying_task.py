# SPDX-License-Identifier: Apache-2.0
"""Stands for a task of a bench: python copying_task.py NOTES SCORES bench PLAN -o OUT --task N.

It leaves line N of SCORES as its record and notes when it began and ended. It knows nothing of
robir, so that it starts in a hundredth of a second.
"""

import json
import sys
import time
from pathlib import Path


def main():
    notes, scores, out = sys.argv[1], sys.argv[2], Path(sys.argv[sys.argv.index("-o") + 1])
    number = int(sys.argv[sys.argv.index("--task") + 1])
    with Path(notes).open("a") as log:
        print("begin", number, time.time(), file=log, flush=True)
        time.sleep(0.3)
        record = Path(scores).read_text().splitlines()[number]
        file = out / "records" / f"{json.loads(record)['name']}.json"
        file.parent.mkdir(exist_ok=True)
        file.write_text(record)
        print("end", number, time.time(), file=log, flush=True)


main()
