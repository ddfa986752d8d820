"""`python -m anther.cli`."""

import sys

from anther.cli.main import main

sys.exit(main())
