"""`python -m scaffold_pipeline` is the command `scaffold-pipeline`."""

import sys

from scaffold_pipeline.cli.app import main

sys.exit(main())
