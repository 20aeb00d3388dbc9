"""What every node needs and no node owns: parameters, QoS, conversions, running."""
