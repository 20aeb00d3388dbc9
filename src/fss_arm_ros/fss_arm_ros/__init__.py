"""Common parts of all nodes: parameters, QoS, conversions, running a node."""
