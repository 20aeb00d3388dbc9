"""Form of a control law as an FMU for co-simulation (FMI 2.0 or 3.0).

Its inputs and outputs are members of the contract's structures (law.h), by name: a scalar `x`, the
elements `x[1]` to `x[n]` of an array, or in FMI 3.0 the array `x`. It has those that it needs.
"""

from collections.abc import Iterator
from difflib import get_close_matches
from math import prod
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import fmpy
import numpy as np

from fss_gnc.law.contract import (
    BASE_COMMANDS,
    JOINT_COMMANDS,
    MAX_JOINTS,
    STRUCTURES,
    Floats,
    Inputs,
    LawError,
    Outputs,
    from_record,
    members,
    to_record,
)

COMMANDS = *BASE_COMMANDS, *JOINT_COMMANDS, "gripper_closed"
CAUSALITIES: dict[type[Inputs | Outputs], str] = {Inputs: "input", Outputs: "output"}
TYPES: dict[str, type] = {"Real": float, "Float64": float, "Float32": float, "Boolean": bool}
TYPES |= {"Integer": int, **{f"{u}Int{bits}": int for u in ("", "U") for bits in (8, 16, 32, 64)}}


class FmuLaw:
    """Law that an FMU computes, one step a period.

    Raises:
        LawError: it is not an FMU for co-simulation, or its variables do not fit the contract.
    """

    def __init__(self, path: str, joints: int, period: float) -> None:
        self.path, self._period, self._steps = path, period, 0
        self._folder = TemporaryDirectory(prefix="law_fmu_")
        try:
            description = fmpy.read_model_description(path, validate=False)
            fmpy.extract(path, self._folder.name)
        except Exception as error:
            raise LawError(f"{path} is not an FMU: {error}") from None
        if description.coSimulation is None:
            raise LawError(f"{path} has no co-simulation; export it as an FMU for co-simulation")
        self._inputs, self._outputs = (
            Variables(description, kind, joints) for kind in (Inputs, Outputs)
        )
        if problems := [*self._inputs.problems(), *self._outputs.problems()]:
            raise LawError(f"{path} does not fit the contract: {'; '.join(problems)}")
        self._fmu = fmpy.instantiate_fmu(self._folder.name, description, "CoSimulation")
        if description.fmiVersion == "2.0":
            self._fmu.setupExperiment(startTime=0.0)
        self._fmu.enterInitializationMode()
        self._fmu.exitInitializationMode()

    def step(self, inputs: Inputs) -> Outputs:
        """Return the commands for the next period."""
        self._inputs.set(self._fmu, to_record(inputs, inputs.joints))
        stopped = self._fmu.doStep(self._steps * self._period, self._period)
        if stopped and stopped[1]:
            raise LawError("the FMU has ended its simulation")
        self._steps += 1
        return from_record(Outputs, self._outputs.get(self._fmu), inputs.joints)

    def terminate(self) -> None:
        """End the law."""
        self._fmu.terminate()
        self._fmu.freeInstance()
        self._folder.cleanup()


class Group(NamedTuple):
    """Variables of one type, which are set or read by one call."""

    references: list[int]
    places: list[int]  # of their elements, in the order of the structure's elements


class Variables:
    """Inputs or outputs of an FMU, and their places in the structure of the contract.

    Args:
        description: of the FMU.
        kind: Inputs or Outputs.
        joints: number of joints.
    """

    def __init__(self, description: Any, kind: type[Inputs | Outputs], joints: int) -> None:
        self._members = list(members(kind))
        self._kind, self._joints, self._is_fmi3 = kind, joints, description.fmiVersion != "2.0"
        names = [name for m in self._members for name in elements(m.name, m.size)]
        self._places = {name: place for place, name in enumerate(names)}
        self._unknown: list[str] = []
        self._groups: dict[str, Group] = {}
        for variable in description.modelVariables:
            if variable.causality == CAUSALITIES[kind]:
                self._add(variable)
        used = {names[k] for group in self._groups.values() for k in group.places}
        self._used = used
        self._given = {m.name for m in self._members if used & set(elements(m.name, m.size))}

    def _add(self, variable: Any) -> None:
        name, size = variable.name, prod(variable.shape) if variable.shape else 0
        if not size and name not in self._places:
            name = f"{name}[1]" if f"{name}[1]" in self._places else name
        parts = elements(name, size)
        if unknown := [part for part in parts if part not in self._places]:
            self._unknown += unknown
        elif variable.type not in TYPES:
            self._unknown.append(f"{name} of type {variable.type}")
        else:
            group = self._groups.setdefault(variable.type, Group([], []))
            group.references.append(variable.valueReference)
            group.places.extend(self._places[part] for part in parts)

    def problems(self) -> Iterator[str]:
        """Yield what does not fit the contract; a name of an array only once."""
        causality = CAUSALITIES[self._kind]
        for name in {name.partition("[")[0]: name for name in reversed(self._unknown)}.values():
            (nearest,) = get_close_matches(name, self._places, 1, 0.0)
            yield f"{causality} {name} is unknown, the nearest is {nearest}"
        for m in self._members:
            size = self._joints if m.size == MAX_JOINTS else m.size
            missing = [name for name in elements(m.name, size) if name not in self._used]
            if missing and self._is_needed(m.name):
                yield f"{causality} {missing[0]} is missing"
        if self._kind is Outputs and not self._given.intersection(COMMANDS):
            yield f"it has none of the outputs {', '.join(COMMANDS)}"

    def _is_needed(self, name: str) -> bool:
        """Return True if a part of the member is used, or what is used needs it beside."""
        flag = f"{name}_valid" if self._kind is Outputs else name.removesuffix("_valid")
        return bool(self._given.intersection((name, flag)))

    def set(self, fmu: Any, record: Any) -> None:
        """Set the variables from a structure."""
        values = np.concatenate([np.ravel(record[m.name]) for m in self._members])
        for kind, (references, places) in self._groups.items():
            given = values[places].astype(TYPES[kind]).tolist()
            getattr(fmu, f"set{kind}")(references, given)

    def get(self, fmu: Any) -> Any:
        """Return the variables as a structure; `x_valid` is 1 if only `x` is a variable."""
        values: Floats = np.zeros(len(self._places))
        for kind, (references, places) in self._groups.items():
            sizes = [len(places)] if self._is_fmi3 else []
            values[places] = getattr(fmu, f"get{kind}")(references, *sizes)
        record, start = np.zeros((), STRUCTURES[self._kind]), 0
        for m in self._members:
            size = max(m.size, 1)
            record[m.name] = values[start : start + size] if m.size else values[start]
            start += size
        for name in self._given.intersection(COMMANDS):
            if f"{name}_valid" not in self._given:
                record[f"{name}_valid"] = 1
        return record


def elements(name: str, size: int) -> list[str]:
    """Return the names of an array's elements; those of a scalar, of size 0: its name."""
    return [f"{name}[{i}]" for i in range(1, size + 1)] or [name]
