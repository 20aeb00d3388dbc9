"""The whole arm: what its joints do, and whose turn it is to move them."""
