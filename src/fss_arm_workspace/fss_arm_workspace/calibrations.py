"""Calibrations of the described arm, whatever their order."""

from typing import Any

from fss_arm_ros.calibrated import Calibrated


class Calibrations:
    """The newest calibration of each kind, and the described arm after all of them."""

    def __init__(self, described: Calibrated) -> None:
        self.described = self.calibrated = described
        self.messages: dict[str, Any] = {}  # by topic, the newest last

    def add(self, topic: str, message: Any) -> None:
        """Replace the calibration of a topic.

        Raises:
            ValueError: it is not of this arm; nothing has changed.
        """
        messages = {k: v for k, v in self.messages.items() if k != topic} | {topic: message}
        calibrated = self.described
        for each in messages.items():
            calibrated = calibrated.with_message(*each)
        if calibrated.arm.n != self.described.arm.n:
            raise ValueError(f"it is for {calibrated.arm.n} links, expected {self.described.arm.n}")
        self.calibrated, self.messages = calibrated, messages
