"""``python -m defocus_cli`` is ``defocus``."""

import sys

from defocus_cli.main import main

if __name__ == "__main__":
    sys.exit(main())
