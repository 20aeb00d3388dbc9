"""Vehicles that share a table: their common start, and their faults as parameters."""

from collections.abc import Sequence
from dataclasses import replace
from threading import RLock

from rclpy.node import Node

from fss_arm_ros.parameters import declare_live
from fss_sim.settings import TestbedSettings
from fss_sim.testbed import State, place_on_table
from fss_sim.vehicle_topics import VehicleTopics
from fss_sim.vicon import TARGET


def start_vehicles(
    vehicles: Sequence[VehicleTopics], settings: TestbedSettings, states: Sequence[State], seed: int
) -> None:
    """Create the vehicles in these states, with a common table, radio channel and VICON."""
    bed = None
    if settings.vehicles:
        made = [v.make_vehicle(state) for v, state in zip(vehicles, states, strict=True)]
        bed = place_on_table(made, states)
    states = align_frames(states)
    kinds = [kind for vehicle in vehicles for kind in vehicle.subjects]
    kinds += [TARGET] if settings.target_mass else []
    radio_channel = settings.radio_channel(f"{seed}, {states[0].boots}")
    vicon = settings.vicon(seed, kinds)
    for number, (vehicle, state) in enumerate(zip(vehicles, states, strict=True)):
        own_seed = seed + vehicle.settings.seed - settings.seed
        vehicle.start(bed, number, state, own_seed, radio_channel, vicon)


def align_frames(states: Sequence[State]) -> list[State]:
    """Return the states with the same frame, the latest of all."""
    frame = max(state.frame for state in states)
    return [replace(state, frame=frame) for state in states]


def declare_faults(node: Node, lock: RLock, vehicles: Sequence[VehicleTopics]) -> None:
    """Declare each fault of each vehicle as a parameter of the node."""
    owners = {prefix: v for v in vehicles for prefix in v.fault_classes()}
    classes = {prefix: kind for v in vehicles for prefix, kind in v.fault_classes().items()}

    def on_fault(prefix: str, fault: str, value: float) -> None:
        with lock:
            owner = owners[prefix]
            owner.set_fault(prefix.removeprefix(owner.prefix), fault, value)

    declare_live(node, classes, on_fault)
