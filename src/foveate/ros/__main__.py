"""`python -m foveate.ros`: the node."""

import sys

from foveate.ros.main import main

if __name__ == "__main__":
    sys.exit(main())
