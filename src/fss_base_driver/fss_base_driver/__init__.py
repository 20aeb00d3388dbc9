"""The base's hardware: motion capture to poses."""
