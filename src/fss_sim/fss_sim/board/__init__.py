"""The base's board, as the link's electronics are, and the way to its driver."""
