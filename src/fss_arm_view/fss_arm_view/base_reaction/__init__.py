"""Reaction of the base to the arm: predicted from momentum conservation, and measured.

Before each motion the base's pose and twist are fitted to its drift while the arm rests
(`prediction.fit_drift`). From there the prediction of Eq. 6 depends on the joints alone, with the
initial momentum, until the next motion (`prediction.Prediction`). A known tilt of the table
accelerates the system. The band includes the covariances of calibration, fit and tilt.
"""

from .reaction import BaseReaction, Reaction

__all__ = ["BaseReaction", "Reaction"]
