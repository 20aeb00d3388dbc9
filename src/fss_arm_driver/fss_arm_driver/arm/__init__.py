"""The whole arm: states of all joints, and the motions that command them."""
