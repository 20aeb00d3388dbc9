"""Gymnasium environments of the floating arm: FssReach-v0, FssHold-v0 and FssCapture-v0."""
