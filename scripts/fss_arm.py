"""Send a command to the arm, and print its answer.

move ANGLE...  move all joints to these angles [deg], arriving together, in
               --seconds or as fast as their limits allow (arm/move)
execute FILE   wait until the arm is ready, execute a plan that `plan` wrote
               (arm/execute), compare predicted and measured motion of the base
arm            arm all links (arm/enable)
disarm         release the joints of all links (arm/enable)
stop           brake all joints at once, of all vehicles or of the one named,
               and hold those that are on, under power, until disarmed or armed
               again (arm/stop); fails unless each link and board confirms
home           each armed link without a reference searches for it, in turn
clear          disarm all links and clear their drives' latched faults
valves         enable the base's valves (base/arm), until stop
solve          all running calibrations end the current rest or motion and solve
forget         each running calibration drops its data

If move or execute is interrupted, the joints come to rest.
"""

import argparse
import os
import re
import sys
from math import nan
from pathlib import Path
from typing import NoReturn

import rclpy
from rclpy.exceptions import InvalidNamespaceException
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.validate_namespace import validate_namespace
from std_srvs.srv import SetBool

from fss_arm_commands import Answer, NoAnswerError, calibrations, call, clear, home, move
from fss_arm_ros.command_line import in_words, interrupt_at_end
from fss_arm_ros.rclpy_compat import RCLError
from fss_arm_ros.run import check_domain
from fss_arm_stop import Stop, vehicles

COMMANDS = (
    *("move", "execute", "arm", "disarm", "stop", "home", "clear", "valves", "solve", "forget"),
)
MAX_TIME, MAX_ANGLE = 3600.0, 36_000.0  # [s], [deg]
NAMESPACE = re.compile(r"/?[A-Za-z]\w*(/[A-Za-z]\w*)*", re.ASCII)
HINT = re.compile(r"(scripts/fss_arm\.sh) (\w+)")  # in messages of nodes


def execute(node: Node, file: str, wait: float, options: argparse.Namespace) -> Answer:
    """Execute the plan in a file, whose path starts in the folder of the user's shell.

    Raises:
        NoAnswerError: no node offers the action.
    """
    # Imported here because it compiles kernels: a stop must not wait for them.
    from fss_arm_motion.execute_action import NoMotionNodeError, execute_plan

    path = Path(os.environ.get("FSS_CALLED_IN", "."), file)

    def say(line: str) -> None:
        print(repeat_options(line, options), flush=True)

    try:
        return execute_plan(node, path.absolute(), wait, say)
    except NoMotionNodeError as error:
        raise NoAnswerError(str(error)) from None


def repeat_options(words: str, options: argparse.Namespace) -> str:
    """Return a message whose commands have the vehicle and the configuration of this one."""
    vehicle = f" --vehicle {options.vehicle}" if options.vehicle else ""
    configuration = os.environ.get("FSS_ARM_CONFIG", "")
    after = f" {configuration}" if configuration else ""
    return HINT.sub(lambda hint: f"{hint[1]}{vehicle} {hint[2]}{after}", words)


def run_command(node: Node, options: argparse.Namespace) -> Answer:
    """Run a command.

    Raises:
        NoAnswerError: a node does not exist, or does not answer.
    """
    what, wait = options.what, 10.0 if options.wait is None else options.wait
    if what == "move":
        return move(node, options.arguments, options.seconds, wait)
    if what == "execute":
        return execute(node, options.arguments[0], wait, options)
    if what == "home":
        return home(node, wait, options.within)
    if what in ("arm", "disarm"):
        return call(node, SetBool, "arm/enable", SetBool.Request(data=what == "arm"), wait)
    if what == "valves":
        return call(node, SetBool, "base/arm", SetBool.Request(data=True), wait)
    if what == "clear":
        return clear(node, wait)
    return calibrations(node, what, wait)


def namespace(text: str) -> str:
    """Return the namespace of a vehicle, checked.

    Raises:
        argparse.ArgumentTypeError: it is none.
    """
    try:
        if text != "/" and not NAMESPACE.fullmatch(text):
            raise InvalidNamespaceException(text, "", 0)
        validate_namespace(f"/{text.lstrip('/')}")
    except InvalidNamespaceException:
        raise argparse.ArgumentTypeError(
            f"{text!r} is no namespace of a vehicle, expected a letter and then letters, digits "
            "and _, as fss2; without it, stop is for all vehicles"
        ) from None
    return text


def duration(text: str) -> float:
    """Return a time [s], checked.

    Raises:
        argparse.ArgumentTypeError: it is none.
    """
    return _number(text, 0.0, MAX_TIME, f"0 to {MAX_TIME:.0f} s")


def angle(text: str) -> float:
    """Return an angle [deg], checked.

    Raises:
        argparse.ArgumentTypeError: it is none.
    """
    return _number(text, -MAX_ANGLE, MAX_ANGLE, "an angle in degrees")


def _number(text: str, least: float, greatest: float, expected: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = nan
    if not least <= number <= greatest:
        raise argparse.ArgumentTypeError(f"{text!r} is given, expected {expected}")
    return number


class Parser(argparse.ArgumentParser):
    """Reports an error in one line; an option has one name, not its abbreviations."""

    def error(self, message: str) -> NoReturn:
        """Exit with 2, as ROS nodes do after a wrong command line."""
        self.exit(2, f"{self.prog}: {' '.join(message.split())}\n")


def check_arguments(parser: Parser, options: argparse.Namespace) -> None:
    """Check the arguments of a command, and convert those of a move to angles [deg]."""
    what, count = options.what, len(options.arguments)
    if what == "execute":
        if count != 1:
            parser.error(f"execute has {count} files, expected one, as `plan` writes it")
        return
    try:
        options.arguments = [angle(text) for text in options.arguments]
    except argparse.ArgumentTypeError as error:
        parser.error(f"argument ANGLE: {error}")
    if bool(count) != (what == "move"):
        expected = "one for each joint [deg]" if what == "move" else "none"
        parser.error(f"{what} has {count} angles, expected {expected}")


def parsed() -> tuple[argparse.Namespace, str | None]:
    """Read the command line; return its options, and the namespace of the vehicle, if any.

    A wrong one ends the program.
    """
    parser = Parser(
        "fss_arm.sh",
        allow_abbrev=False,
        description=__doc__,
        epilog="Exit codes: 0 done, 1 not done, 2 wrong command line, 130 interrupted.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "what", nargs="?", choices=COMMANDS, metavar="COMMAND", help="one of those above"
    )
    parser.add_argument(
        "arguments",
        nargs="*",
        metavar="ARGUMENT",
        help="move: the angle of each joint [deg]; execute: the file of the plan",
    )
    parser.add_argument(
        "--vehicle",
        "--namespace",
        type=namespace,
        help="namespace of the vehicle (default: the one in FSS_NAMESPACE; stop: all vehicles)",
    )
    parser.add_argument(
        "--wait", type=duration, help="timeout waiting for the node [s] (default 10; stop 2)"
    )
    parser.add_argument(
        "--within",
        type=duration,
        default=60.0,
        help="timeout of home for each link [s] (default 60)",
    )
    parser.add_argument(
        "--seconds",
        type=duration,
        default=0.0,
        help="shortest duration of a move [s] (default: as fast as limits allow)",
    )
    options = parser.parse_intermixed_args()
    if options.what is None:
        also = f" (--vehicle is {options.vehicle!r})" if options.vehicle else ""
        parser.error(f"COMMAND is missing{also}, expected one of {', '.join(COMMANDS)}")
    check_arguments(parser, options)
    if options.vehicle is not None:
        return options, options.vehicle
    try:
        return options, namespace(os.environ.get("FSS_NAMESPACE") or "/")
    except argparse.ArgumentTypeError as error:
        if options.what == "stop":  # for all vehicles, whatever the shell's one is called
            return options, None
        parser.error(f"FSS_NAMESPACE: {error}")


def _searched_place(node: Node) -> str:
    """Return the ROS domain, and the namespace, that were searched."""
    domain = f" in ROS domain {os.environ.get('ROS_DOMAIN_ID') or 0}"
    return domain if node.get_namespace() == "/" else f" in {node.get_namespace()},{domain}"


def _next_step(node: Node, problem: str) -> str:
    """Return what to do if a node does not answer: name another vehicle, or start the nodes."""
    found = vehicles(node)
    if others := [v for v in found if v != node.get_namespace()]:
        return f"; --vehicle is one of {', '.join(others)}"
    if found and problem == "no node offers base/arm":
        return ": it needs a node base that runs, as config/fss_gnc_sim.sh has"
    start = "name the configuration that runs, or start one with scripts/fss_up.sh CONFIG"
    return "" if found else f": {start}"


def main() -> int:
    """Run; the exit code is 0 if the arm did so, 1 if not, 130 if interrupted before."""
    options, vehicle = parsed()
    try:
        check_domain()
        # A plan that is interrupted is canceled, which needs a context that still works.
        executes = options.what == "execute"
        signals = SignalHandlerOptions.NO if executes else SignalHandlerOptions.ALL
        rclpy.init(signal_handler_options=signals)
        if executes:
            interrupt_at_end()
    except (ValueError, RCLError) as error:
        print(f"fss_arm.sh: {in_words(error).split(', at /')[0]}", file=sys.stderr)
        return 2
    node = Node("fss_arm", namespace=vehicle)
    code = 1
    try:
        if options.what == "stop":
            done, words = Stop(node, options.vehicle)(2.0 if options.wait is None else options.wait)
        else:
            done, words = run_command(node, options)
            words = f"{vehicle}: {words}" if vehicle and len(node.get_namespace()) > 1 else words
        code = 0 if done else 1
    except NoAnswerError as error:
        words = f"{error}{_searched_place(node)}{_next_step(node, str(error))}"
    except (KeyboardInterrupt, ExternalShutdownException):
        code, words = 130, "interrupted"
    except RCLError:
        if rclpy.ok():
            raise
        code, words = 130, "interrupted"
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    print(repeat_options(words, options), file=sys.stderr if code else sys.stdout)
    return code


if __name__ == "__main__":
    sys.exit(main())
