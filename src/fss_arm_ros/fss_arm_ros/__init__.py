"""What every node needs and no node owns: settings, QoS, conversions, bags."""
