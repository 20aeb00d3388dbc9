"""What the arm does to its base: predicted from momentum conservation, beside what was measured.

Before each motion the base's pose and twist are fitted to its drift while the arm rests
(`prediction.fit_drift`); from there the prediction of Eq. 6 follows the joints alone, with the
momentum it began with, until the next motion (`prediction.Prediction`). A known tilt of the table
pulls. The band holds the calibration's covariance, the fit's and the tilt's.
"""

from .reaction import BaseReaction, Reaction

__all__ = ["BaseReaction", "Reaction"]
