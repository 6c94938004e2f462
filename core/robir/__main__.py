# SPDX-License-Identifier: Apache-2.0
"""`python -m robir` is `robir`."""

import sys

from robir.cli import main

sys.exit(main())
