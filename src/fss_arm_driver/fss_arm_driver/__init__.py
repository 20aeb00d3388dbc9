"""The link's wire protocol, its transports, and the nodes that drive the arm."""
