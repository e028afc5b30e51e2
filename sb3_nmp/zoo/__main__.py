"""``python -m sb3_nmp.zoo``."""

import sys

from sb3_nmp.zoo.cli import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
