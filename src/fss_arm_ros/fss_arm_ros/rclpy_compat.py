"""Every use of a private name of rclpy, with its reason, its versions and its fallback.

All else in this workspace is built on rclpy's public interface. Checked with rclpy 7.1.6 (Jazzy)
and 9.1.2 (Kilted). The fallbacks are for versions that this module does not know.
"""

from collections.abc import Mapping

from rclpy.node import Node
from rclpy.parameter import Parameter

# rclpy raises these classes of its extension and offers no public name for them. In every version
# checked both are RuntimeErrors, which is all that their handlers rely on.
try:
    from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError
except ImportError:
    RCLError = UnknownROSArgsError = RuntimeError

__all__ = ["RCLError", "UnknownROSArgsError", "parameter_overrides"]


def parameter_overrides(node: Node) -> Mapping[str, Parameter]:
    """Return the parameters that the user gave to `node`, by name, whether declared or not.

    rclpy returns only the declared ones, so a misspelt `-p` would be ignored silently. Without the
    private attribute (7.1.6 and 9.1.2 have it) a misspelt one is ignored, as rclpy does.
    """
    given: Mapping[str, Parameter] = getattr(node, "_parameter_overrides", {})
    return given
