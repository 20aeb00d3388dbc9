"""Stuck valves: by parameters, and as detected by the navigation."""

from collections.abc import Mapping
from typing import Any

from fss_base_driver.protocol import VALVES

STUCK_STATES = "stuck_open", "stuck_closed"


def stuck_valves(configured: Mapping[str, Any], detected: Any) -> tuple[list[int], list[int]]:
    """Return the valves that are stuck open, and those that are stuck closed, numbered from 0.

    Args:
        configured: ValveSettings by prefix, `valve_1` and so on.
        detected: ThrusterHealth.
    """

    def find(how: str) -> list[int]:
        flags = getattr(detected, how)
        return [i for i in range(VALVES) if flags[i] or getattr(configured[f"valve_{i + 1}"], how)]

    return find("stuck_open"), find("stuck_closed")


def describe_stuck_valves(configured: Mapping[str, Any], detected: Any) -> dict[str, str]:
    """Return the values for diagnostics; arguments as of `stuck_valves`."""
    values = {}
    for i in range(1, VALVES + 1):
        by_parameters = [how for how in STUCK_STATES if getattr(configured[f"valve_{i}"], how)]
        by_navigation = [how for how in STUCK_STATES if getattr(detected, how)[i - 1]]
        for source, found in (("configured", by_parameters), ("detected", by_navigation)):
            if found:
                words = " and ".join(found).replace("_", " ")
                values[f"valve_{i} is {source} as"] = words
    return values
