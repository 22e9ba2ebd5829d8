"""``python -m mv_slapse``: the command line."""

import sys

from mv_slapse.tools.main import main

if __name__ == '__main__':
    sys.exit(main())
