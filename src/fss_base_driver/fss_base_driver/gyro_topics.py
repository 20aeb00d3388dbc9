"""The board's gyro: topic `fog/imu`, and the service that finds its bias."""

from math import inf
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.parameter import Parameter
from rclpy.task import Future
from sensor_msgs.msg import Imu
from std_srvs.srv import Trigger

from fss_arm_ros.convert import SECOND
from fss_arm_ros.qos import SENSOR
from fss_base_driver import messages
from fss_base_driver.gyro import Bias, BiasSearch, GyroSums
from fss_base_driver.session import BoardSample
from fss_base_driver.settings import BaseSettings, GyroSettings
from fss_link.session_node import SessionNode


class GyroTopics:
    """Publisher of the gyro's rate; on request it finds the gyro's bias and sets it."""

    def __init__(self, node: SessionNode) -> None:
        self.node, self.session = node, node.session
        self.settings: BaseSettings = node.settings
        self.sums, self.last_rate = GyroSums(), 0  # time of the last rate [ns]
        self.search: BiasSearch | None = None
        self.search_outcome, self.search_start = Future(), 0  # start of the search [ns]
        self.imu = node.create_publisher(Imu, "fog/imu", SENSOR)
        group = ReentrantCallbackGroup()  # the search takes long; other callbacks run meanwhile
        node.create_service(Trigger, "base/find_gyro_bias", self.on_find_bias, callback_group=group)

    def publish(self, sample: BoardSample, gyro: GyroSettings) -> None:
        """Publish the mean rate since the last frame, stamped at the middle of that time.

        The sample's stamp is of the node's clock, so that a step of the time of day falsifies
        neither that middle nor the duration of a search.
        """
        if (turn := self.sums.add(sample.frame, sample.stamp)) is None:
            return
        self.last_rate = self.node.now()
        rate, frame_id = gyro.scale * turn.counts, self.settings.base_frame
        deviation = self.settings.gyro_noise / turn.samples**0.5
        stamp = turn.stamp + self.node.clock.offset
        self.imu.publish(messages.imu(stamp, rate - gyro.bias, deviation, frame_id))
        if search := self.search:
            search.add(turn.stamp, rate, turn.samples, sample.frame.valves)
            if search.outcome:
                self.node.wakeup.trigger()

    def silence(self) -> float:
        """Return the time since the last rate [s], infinite if there was none."""
        return (self.node.now() - self.last_rate) / SECOND if self.last_rate else inf

    def values(self, gyro: GyroSettings) -> dict[str, Any]:
        """Return the values for diagnostics."""
        return {"gyro bias [rad/s]": gyro.bias, "gyro's age [s]": self.silence()}

    async def on_find_bias(self, _: Trigger.Request, response: Trigger.Response) -> Any:
        """Find the gyro's bias while the base is at rest, and set it."""
        s = self.settings
        with self.node.lock:
            if self.search or self.session.lost:
                running = "a search for the bias is already running"
                response.message = running if self.search else self.session.loss_reason
                return response
            self.search_outcome, self.search_start = Future(), self.node.now()
            self.search = BiasSearch(s.bias_time, s.bias_scatter, s.max_bias)
        outcome = await self.search_outcome
        self.search = None
        if isinstance(outcome, Bias):
            self.node.set_parameters([Parameter("gyro.bias", value=outcome.rate)])
        response.success, response.message = isinstance(outcome, Bias), str(outcome)
        return response

    def answer_request(self) -> None:
        """Answer the request for the bias if the search has ended, or cannot continue."""
        if search := self.search:
            duration = (self.node.now() - self.search_start) / SECOND
            if self.session.lost:
                search.fail(self.session.loss_reason)
            elif min(self.silence(), duration) > self.settings.timeout:
                search.fail("the gyro is silent")
            if search.outcome and not self.search_outcome.done():
                self.search_outcome.set_result(search.outcome)
