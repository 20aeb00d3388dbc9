"""Parameter that every node has. Without imports, so that `--help` starts fast."""

ALLOW = "allow_duplicate"
ABOUT = "start beside a node that has the same name, or offers the same services, in the ROS domain"
