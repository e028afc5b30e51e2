"""``python -m results``: the same as ``nmp-bench``."""

import sys

from results.cli import main

if __name__ == "__main__":
    sys.exit(main())
