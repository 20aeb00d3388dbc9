"""Publication of a body's state: when it is measured, and at a rate while it is predicted."""

from collections.abc import Callable

from .body_filter import BodyFilter, BodyState, Pose


class TrackedBody:
    """A body whose state is published.

    Args:
        filter_: filter of its state.
        update: function that updates the filter with a pose [m, m, rad] at a time [ns]; it returns
            True if the pose was accepted.
        publish: function that publishes a state.
    """

    def __init__(
        self,
        filter_: BodyFilter,
        update: Callable[[int, float, float, float], bool],
        publish: Callable[[BodyState], None],
    ) -> None:
        self.filter, self.update, self.publish = filter_, update, publish
        self.published = -1  # time of the newest published state [ns]
        self.lost_reason = "not observed yet"  # why the state is not published; empty: it is

    def update_pose(self, t: int, pose: Pose) -> None:
        """Update with a pose measured at t [ns]; publish the state if the pose was accepted."""
        if self.update(t, *pose):
            self.publish_if_new(t)

    def publish_if_new(self, t: int) -> None:
        """Publish the state, if it is known at t [ns] and newer than the last one."""
        self.lost_reason = self.filter.lost_reason(t)
        if not self.lost_reason and self.filter.t > self.published:
            self.published = self.filter.t
            self.publish(self.filter.state())

    def publish_if_due(self, t: int, interval: float, predict: Callable[[int], None]) -> None:
        """Publish a prediction for t [ns], if the last state is older than an interval [ns]."""
        self.lost_reason = self.filter.lost_reason(t)
        if t - self.published > interval:
            if not self.lost_reason:
                predict(t)
            self.publish_if_new(t)
