"""What the nodes of a link and of the base's board have in common: a session over a transport.

A thread takes datagrams and publishes what they say; commands and stops may have threads of their
own; all else happens in the executor. What they share is the session, under a lock.
"""

from abc import abstractmethod
from threading import RLock
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool

from fss_arm_driver.complaints import Complaints
from fss_arm_driver.host_clock import HostClock
from fss_arm_driver.receiver import Receiver
from fss_arm_driver.session import Arming, CommandError, Session, StatusLog
from fss_arm_driver.transport import Transport, is_exposed
from fss_arm_ros.diagnostics import Diagnostics, Health
from fss_arm_ros.events import report
from fss_arm_ros.parameters import declare
from fss_arm_ros.rclpy_compat import RCLError
from fss_arm_ros.timer_clock import timer_clock

SIMULATED_STEP = 0.01  # of /clock [s]


class SessionNode(Node):
    """Talks to a partner at a steady rate, arms it, and says how it is.

    A kind of node makes its session, gives it to `connect`, makes its topics, and ends its making
    with `begin`.

    Args:
        name: of the node.
        kind: of its settings, which have `url`, `keys` and `rate`.
        clock: the computer's, but for tests.
        live: whether the node has parameters that may be set while it runs.
    """

    session: Session[Any]
    unconfirmed: str  # what a partner that was disarmed does not say, in words

    def __init__(
        self,
        name: str,
        kind: type,
        *,
        clock: HostClock | None = None,
        live: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(name, **options)
        self.settings: Any = declare(self, kind, live=live)
        simulated = self.get_parameter("use_sim_time").value
        if simulated:
            clock = HostClock(self.simulated_now, self.simulated_now)
        self.resolution = SIMULATED_STEP if simulated else 0.0
        self.clock = clock or HostClock()
        self.now = self.clock.now
        self.lock = RLock()
        self.complaints = Complaints()
        self.waiting: list[Future] = []  # for the partner to arm, or to disarm

    def simulated_now(self) -> int:
        """The time of /clock [ns]; 0 before its first message."""
        return int(self.get_clock().now().nanoseconds)

    def connect(self, session: Session[Any], transport: Transport, danger: str) -> None:
        """Take the session and the way to the partner.

        Args:
            session: of this kind of node.
            transport: to the partner.
            danger: what strangers can do to one whose frames are not signed, in words.
        """
        self.session, self.transport = session, transport
        self.name = session.partner.name  # in answers
        self.changes = StatusLog(session)
        self.complaints.begins("trouble", self.trouble())  # what begins so is no news
        if is_exposed(self.settings.url, self.settings.keys):
            self.get_logger().warning(
                f"{self.settings.url}: frames are not signed, so anybody on this network can "
                f"{danger}; see docs/how-to/security.md"
            )

    def begin(self, service: str) -> None:
        """Begin to talk; `service` arms and disarms."""
        group = ReentrantCallbackGroup()  # the answer waits for the partner's; all else goes on
        self.create_service(SetBool, service, self.on_arm, callback_group=group)
        self.steady = self.create_timer(
            1.0 / self.settings.rate, self.send, clock=timer_clock(self)
        )
        self.diagnostics = Diagnostics(self, self.health, self.settings.url)
        self.news = self.create_guard_condition(self.answer)
        self.receiver = Receiver(self.transport, self.poll, self.news)

    @abstractmethod
    def take(self, data: bytes, now: int) -> None:
        """Publish what a datagram says."""

    @abstractmethod
    def transmit(self) -> None:
        """Send the command of the moment."""

    @abstractmethod
    def state_words(self) -> str:
        """How the partner is, for people."""

    @abstractmethod
    def health(self) -> Health:
        """For diagnostics."""

    def has_news(self) -> bool:
        """Whether there is something to answer or to report."""
        return bool(self.waiting)

    def poll(self, datagrams: list[bytes]) -> None:
        """Take what has come. Without a clock yet nothing can be stamped: it is dropped."""
        with self.lock:
            now = self.now()  # not before: it would run back in the session
            try:
                for data in datagrams if now else ():
                    self.take(data, now)
            except RCLError:
                if self.context.ok():
                    raise
                return  # shut down meanwhile
        if self.has_news():
            self.news.trigger()

    def send(self) -> None:
        """Send the command of the moment, and say what has become of earlier requests."""
        self.transmit()
        self.answer()
        self.complain()

    def complain(self) -> None:
        """Log what has changed, and what is wrong, once each time that it begins."""
        with self.lock:
            news = self.changes(self.now())
        report(self, news)
        self.warn("trouble", self.trouble())
        self.warn("rival", self.session.rival)
        self.warn("strain", self.session.strain)

    def trouble(self) -> str:
        """What is wrong with the way to the partner, in words."""
        trouble = self.transport.trouble
        return trouble and f"{self.settings.url}: {trouble}"

    def warn(self, kind: str, text: str) -> None:
        """Log a warning of a kind when it begins; an empty one ends it."""
        if self.complaints.begins(kind, text):
            self.get_logger().warning(text)

    async def on_arm(self, request: SetBool.Request, response: SetBool.Response) -> Any:
        """Arm or disarm; answer when the partner has."""
        try:
            with self.lock:
                if request.data:
                    self.session.arm(self.now())
                else:
                    self.session.disarm()
            self.waiting.append(settled := Future())
            self.send()
            await settled
            response.success, response.message = self.outcome(request.data)
        except CommandError as error:
            response.success, response.message = False, str(error)
        return response

    def outcome(self, arm: bool) -> tuple[bool, str]:
        """Whether the partner has armed or disarmed, and how it is in words."""
        session = self.session
        done = session.armed if arm else session.released
        if done or arm or session.arming is not Arming.DISARMED:
            words = self.state_words(), "" if done else session.strain
            return done, "; ".join(filter(None, words))
        how = "is lost" if session.lost else self.unconfirmed
        return False, f"{self.name} {how}: asked to disarm, not confirmed"

    def answer(self) -> None:
        """Answer requests to arm or disarm that have come to an end."""
        if self.receiver.error and self.context.ok():
            raise self.receiver.error
        while self.waiting and self.session.settled:
            self.waiting.pop().set_result(None)

    def close(self) -> None:
        """Give the port back."""
        self.receiver.close()
        self.transport.close()
