"""Parameter that every node has. Without imports, so that `--help` starts fast."""

ALLOW = "allow_duplicate"
ABOUT = "whether to start beside a node with the same name or services in the ROS domain"
