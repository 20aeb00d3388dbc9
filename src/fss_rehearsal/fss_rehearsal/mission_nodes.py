"""Test bed and nodes of a mission, in lockstep on a busy computer."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fss_rehearsal.processes import Nodes

TELEMETRY_RATE = 20.0  # of the links [Hz]
TRUTH_RATE = 50.0  # [Hz]
MAX_SILENCE = 10.0  # of a board or driver [s]


def start_mission_nodes(
    nodes: Nodes,
    links: int,
    parameters: Mapping[str, Mapping[str, Any]],
    speed: float,
    bag: Path | None = None,
) -> None:
    """Start the simulated test bed, drivers, navigation, control and guidance.

    Args:
        nodes: the processes.
        links: number of links.
        parameters: of the nodes, by name of the node.
        speed: largest speed of the simulation, in multiples of real time.
        bag: folder for a recording; None: nothing is recorded.
    """
    clock, ports = {"use_sim_time": True}, nodes.domain.ports(2 * links + 2)
    board, base = ports[2 * links :]
    if bag:
        nodes.start("record", "fss_arm_bags", "record", output=bag, **clock)
    timeouts = {"timeout": MAX_SILENCE, "watchdog": MAX_SILENCE}
    options: dict[str, tuple[str, str, dict[str, Any]]] = {
        "testbed": (
            "fss_sim",
            "testbed",
            {
                "ports": ports[:links],
                "board_port": board,
                "keep_clock": True,
                "lockstep": True,
                "speed": speed,
                "truth_rate": TRUTH_RATE,
                "telemetry_rate": TELEMETRY_RATE,
            },
        ),
        "links": (
            "fss_arm_driver",
            "link",
            {"urls": nodes.domain.urls(links), "rate": TELEMETRY_RATE, **timeouts, **clock},
        ),
        "arm": (
            "fss_arm_driver",
            "arm",
            {"rate": TELEMETRY_RATE, "time_to_live": MAX_SILENCE, **clock},
        ),
        "base": (
            "fss_base_driver",
            "base",
            {"url": f"udp://127.0.0.1:{board}?bind={base}", "timeout": MAX_SILENCE, **clock},
        ),
        "navigation": ("fss_gnc", "navigation", clock),
        "control": ("fss_gnc", "control", {"max_pause": MAX_SILENCE, **clock}),
        "guidance": ("fss_gnc", "guidance", clock),
    }
    for name, (package, executable, fixed) in options.items():
        nodes.start(name, package, executable, **parameters.get(name, {}), **fixed)
