"""What every node's program does: start, spin, and an end that says what went wrong."""

import atexit
import faulthandler
import gc
import signal
import sys
from collections.abc import Callable, Sequence

import rclpy
from rclpy.exceptions import NotInitializedException, ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.utilities import remove_ros_args

from fss_arm_ros import duplicates, memory
from fss_arm_ros.command_line import in_words
from fss_arm_ros.rclpy_compat import RCLError, UnknownROSArgsError
from fss_arm_ros.subscription_set import relax_events

LEAVING = 5.0  # at most, once all is closed [s]
SWITCH_INTERVAL = 0.0005  # between Python's threads: a stop waits no longer for a computation [s]
ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # what ends a command


def run(
    make_node: Callable[..., Node | Sequence[Node]],
    args: Sequence[str] | None = None,
    takes: str = "",
) -> int:
    """Make a node, spin it until it is asked to stop or ends by itself, and clean up.

    A node ends by itself by raising SystemExit in a callback, with a code or a reason. A node
    that has a `close()` is closed before it is destroyed, however it ends. One that has a job to
    finish says in `unfinished()` how far it is, or nothing once that is done. No node begins
    beside another of its name, or that offers what it does, unless `allow_duplicate` is set.

    Args:
        make_node: the node's class, or a function that makes one or several; called with the
            plain arguments.
        args: the command line; sys.argv by default.
        takes: what the plain arguments are, as `BAG...`; without it there may be none.

    Returns:
        The exit code: 0 after SIGINT, SIGTERM or shutdown, but 130 if they interrupted a job; 1
        when the node cannot be made (its ValueError or OSError is printed in one line), 2 for a
        wrong command line. A node that cannot leave the graph is ended with 1, and says where.
    """
    argv = list(sys.argv if args is None else args)
    name = argv[0].rsplit("/", 1)[-1]
    try:
        plain = remove_ros_args(argv)[1:]
    except UnknownROSArgsError as error:
        return _failed(name, f"{error} is not understood after --ros-args", 2)
    except RCLError as error:
        return _failed(name, str(error).split(", at /")[0], 2)  # the rest: places in rcl's source
    if plain and not takes:
        return _failed(name, f"{plain[0]!r} is not understood; try --help", 2)
    _tune_process()
    nodes: Sequence[Node] = ()
    executor: SingleThreadedExecutor | None = None
    begun = False
    try:
        signal.signal(signal.SIGINT, _interrupt_next)
        rclpy.init(args=argv)
        begun = True
        with duplicates.looking():
            made = make_node(*plain)
            nodes = made if isinstance(made, Sequence) else [made]
            duplicates.check_services(nodes)
        executor = SingleThreadedExecutor()
        for node in nodes:
            relax_events(node)
            executor.add_node(node)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except SystemExit as end:
        if isinstance(end.code, str):
            return _failed(name, end.code, 1)
        return end.code or 0
    except (RCLError, NotInitializedException) as error:
        # A context shut down by a signal shows as one of these in whatever call it meets.
        if rclpy.ok() or not begun:
            if nodes:
                raise
            return _failed(name, error, 2)
    except (ValueError, OSError, ParameterException) as error:
        if nodes and not isinstance(error, duplicates.DuplicateError):
            raise
        if rclpy.ok() or not begun:  # a ValueError is what an action meets in a context shut down
            return _failed(name, error, 1)
    finally:
        for node in nodes:
            getattr(node, "close", lambda: None)()
        # Fast DDS (2.14) was seen to wait for ever, holding Python's lock, as many left at once.
        faulthandler.dump_traceback_later(LEAVING, exit=True, file=2)
        if executor:
            executor.shutdown()
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
        faulthandler.cancel_dump_traceback_later()
        signal.signal(signal.SIGINT, signal.default_int_handler)
    left = [words for node in nodes if (words := getattr(node, "unfinished", str)())]
    return _failed(name, f"interrupted {'; '.join(left)}", 130) if left else 0


def _tune_process() -> None:
    """Apply settings of the whole process, which no library should change."""
    memory.bound()
    sys.setswitchinterval(SWITCH_INTERVAL)
    atexit.register(gc.freeze)  # else the interpreter collects garbage at exit, 0.25 s with numba


def _interrupt_next(*_: object) -> None:
    """Leave the first SIGINT to rclpy, which ends the context by it; the next one interrupts."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def spin_once(node: Node, timeout: float) -> None:
    """rclpy's, of a command; signals are handled at its end.

    What a handler raises while rclpy's extension converts what it took is lost in a TypeError.

    Args:
        node: whose callbacks are called.
        timeout: at most until something has come [s].
    """
    came: list[int] = []
    # Others are ignored, as under nohup, or end the process.
    handlers = {number: by for number in ENDS if callable(by := signal.getsignal(number))}
    for number in handlers:
        signal.signal(number, lambda which, _: came.append(which))
    try:
        rclpy.spin_once(node, timeout_sec=timeout)
    finally:
        for number, by in handlers.items():
            signal.signal(number, by)
    for which in came:
        signal.raise_signal(which)


def _failed(name: str, reason: object, code: int) -> int:
    print(f"{name}: {in_words(reason)}", file=sys.stderr)
    return code
