"""unicon_node, as its console script starts it."""

import sys

from unicon_ros.node_main import main

sys.exit(main())
