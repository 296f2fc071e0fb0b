"""Run the `softmap` command: `python -m softmap_edge`."""

import sys

from softmap_edge.cli import main

sys.exit(main())
