"""Run the command as a module: ``python -m sysid``."""

import sys

from sysid.cli import main

if __name__ == "__main__":
    sys.exit(main())
