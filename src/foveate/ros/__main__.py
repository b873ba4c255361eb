"""`python -m foveate.ros`: the node."""

import sys

from foveate.ros.node import main

sys.exit(main())
