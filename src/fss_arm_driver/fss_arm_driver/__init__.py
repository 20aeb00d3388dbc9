"""Wire protocol of the links, their transports, and the nodes that drive the arm."""
