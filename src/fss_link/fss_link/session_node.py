"""Base class of the nodes of a link and of the base's board: a session over a transport.

A thread receives datagrams and publishes their contents. Another one receives stops, which thus
wait for no other message. All other work is done by the executor. The threads share the session,
under a lock.
"""

from abc import abstractmethod
from threading import RLock
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool

from fss_arm_ros.diagnostics import Diagnostics, Health
from fss_arm_ros.events import report
from fss_arm_ros.parameters import declare
from fss_arm_ros.rclpy_compat import RCLError
from fss_arm_ros.subscriptions import SubscriptionThread
from fss_arm_ros.timers import timer_clock
from fss_link.health import SessionHealth
from fss_link.host_clock import HostClock
from fss_link.pacer import Pacer
from fss_link.receiver import Receiver
from fss_link.session import CommandError, Session, StatusLog
from fss_link.transport import Transport, exposure
from fss_link.warning_filter import WarningFilter

SIMULATED_STEP = 0.01  # step of /clock [s]


class SessionNode(Node):
    """Node that sends commands to a partner at a steady rate, arms it, and reports its state.

    The constructor of a subclass creates a session, passes it to `connect`, creates its topics,
    calls `start_communication`, and finally creates `commands`.

    Args:
        name: of the node.
        kind: of its settings, which have `url`, `keys`, `rate` and `max_rate`.
        clock: by default the computer's; tests may pass another.
    """

    session: Session[Any]
    commands: SubscriptionThread  # that receives stops
    HAS_LIVE_PARAMETERS = False  # which may be set while it runs

    def __init__(
        self, name: str, kind: type, *, clock: HostClock | None = None, **options: Any
    ) -> None:
        super().__init__(name, **options)
        self.settings: Any = declare(self, kind, live=self.HAS_LIVE_PARAMETERS)
        simulated = self.get_parameter("use_sim_time").value
        self.resolution = SIMULATED_STEP if simulated else 0.0
        now = self.simulated_now
        self.clock = HostClock(now, now) if simulated else clock or HostClock()
        self.now = self.clock.now
        self.lock, self.warnings = RLock(), WarningFilter()
        self.waiting: list[Future] = []  # for the partner to arm, or to disarm

    def simulated_now(self) -> int:
        """Return the time of /clock [ns]; 0 before its first message."""
        return int(self.get_clock().now().nanoseconds)

    def connect(self, session: Session[Any], transport: Transport) -> None:
        """Store the session and the transport to the partner; warn if others can command it."""
        self.session, self.transport, self.status_log = session, transport, StatusLog(session)
        self.pacer = Pacer(self.settings.max_rate)
        self.warnings.is_new("connection", self.connection_problem())  # the first is not logged
        if risk := exposure(self.settings.url, self.settings.keys, session.partner.threat):
            self.get_logger().warning(risk)

    def start_communication(self, service: str, health: type[SessionHealth]) -> None:
        """Start the communication; `service` arms and disarms, `health` is for diagnostics."""
        group = ReentrantCallbackGroup()  # other callbacks run while the response waits
        self.create_service(SetBool, service, self.on_arm, callback_group=group)
        period = 1.0 / self.settings.rate
        self.steady = self.create_timer(period, self.send, clock=timer_clock(self))
        self.session_health = health(self.session, self.transport, bool(self.settings.keys))
        self.diagnostics = Diagnostics(self, self.health, self.settings.url)
        self.wakeup = self.create_guard_condition(self.answer_requests)
        self.receiver = Receiver(self.transport, self.process_datagrams, self.wakeup)

    @abstractmethod
    def process_datagram(self, data: bytes, now: int, sheds: bool) -> None:
        """Publish the contents of a datagram, without its telemetry if the node sheds it."""

    @abstractmethod
    def complete_command(self, now: int) -> None:
        """Send and publish what belongs to the command that is sent at `now`."""

    def has_pending_answers(self) -> bool:
        """Return True if there is a request to answer or a status to report."""
        return bool(self.waiting)

    def process_datagrams(self, datagrams: list[bytes], overloaded: bool) -> None:
        """Process datagrams; under overload, publish the telemetry of the newest one alone."""
        shed = max(0, len(datagrams) - 1) if overloaded else 0
        self.transport.counts["telemetry_shed"] += shed
        with self.lock:
            now = self.now()  # under the lock, so that the session's time does not go back
            try:
                for k, data in enumerate(datagrams if now else ()):  # none without a clock
                    self.process_datagram(data, now, k < shed)
            except RCLError:
                if self.context.ok():
                    raise
                return  # shut down meanwhile
        if self.has_pending_answers():
            self.wakeup.trigger()

    def transmit(self) -> None:
        """Send the current command; the next one follows a period later."""
        with self.lock:
            now = self.now()
            self.transport.send(self.session.command(now))
            self.pacer.sent(now)
            self.complete_command(now)
            self.steady.reset()

    def send(self) -> None:
        """Send the current command, answer earlier requests, and log changes."""
        self.transmit()
        self.answer_requests()
        self.log_changes()

    def log_changes(self) -> None:
        """Log changes and problems, each problem once when it starts."""
        with self.lock:
            lines = self.status_log(self.now())
        report(self, lines)
        problems = {"connection": self.connection_problem(), **self.session.problems}
        for kind, text in problems.items():
            self.warn(kind, text)

    def health(self) -> Health:
        """Return the status for diagnostics."""
        with self.lock:
            return self.session_health(self.now())

    def connection_problem(self) -> str:
        """Return the problem of the connection to the partner, in words; empty: none."""
        problem = self.transport.problem
        return problem and f"{self.settings.url}: {problem}"

    def warn(self, kind: str, text: str) -> None:
        """Log a warning of a kind when it starts; an empty text ends it."""
        if self.warnings.is_new(kind, text):
            self.get_logger().warning(text)

    async def on_arm(self, request: SetBool.Request, response: SetBool.Response) -> Any:
        """Arm or disarm; respond when the partner has done so or failed."""
        try:
            with self.lock:
                if request.data:
                    self.session.arm(self.now())
                else:
                    self.session.disarm()
            self.waiting.append(settled := Future())
            self.send()
            await settled
            response.success, response.message = self.session.describe_outcome(request.data)
        except CommandError as error:
            response.success, response.message = False, str(error)
        return response

    def answer_requests(self) -> None:
        """Answer requests to arm or disarm that have succeeded or failed."""
        if self.receiver.error and self.context.ok():
            raise self.receiver.error
        while self.waiting and self.session.settled:
            self.waiting.pop().set_result(None)

    def close(self) -> None:
        """Close the threads and the port."""
        self.commands.close()
        self.receiver.close()
        self.transport.close()
