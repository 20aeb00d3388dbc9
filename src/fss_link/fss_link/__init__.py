"""Sessions with electronics over an unreliable network: frames, arming, clocks."""
