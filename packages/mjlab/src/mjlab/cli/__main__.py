"""`python -m mjlab.cli`, which needs no installed script."""

import sys

from mjlab.cli import main

sys.exit(main())
