"""Run the command that makes the data set."""

import sys

from fss_rehearsal.dataset.command import main

if __name__ == "__main__":
    sys.exit(main())
