"""Forms of a control law: a Python class, C functions in a shared library, or an FMU."""

import ctypes
import importlib
import os
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from fss_gnc.law.contract import STRUCTURES, Inputs, LawError, Outputs, from_record, to_record
from fss_gnc.law.header import VERSION

EXPECTED = "MODULE:CLASS, FILE.py:CLASS, LIBRARY.so or FILE.fmu"
C_FUNCTIONS = "law_contract", "law_init", "law_step", "law_terminate"


class Law(Protocol):
    """A loaded law."""

    path: str  # of its file

    def step(self, inputs: Inputs) -> Outputs:
        """Return the commands for the next period."""

    def terminate(self) -> None:
        """End; called once, after the last step."""


def load(law: str, joints: int, period: float) -> Law:
    """Load and start a law.

    Args:
        law: MODULE:CLASS, FILE.py:CLASS, LIBRARY.so or FILE.fmu.
        joints: number of joints.
        period: nominal time between two steps [s].

    Raises:
        LawError: there is no such law, or it does not have the functions of the contract.
        Exception: the law's own, from its module or its constructor.
    """
    if law.endswith(".so"):
        return CLaw(require_file(law), joints, period)
    if law.endswith(".fmu"):
        from fss_gnc.law.fmu import FmuLaw  # only this form needs its library

        return FmuLaw(require_file(law), joints, period)
    place, colon, name = law.rpartition(":")
    if not (place and colon and name):
        raise LawError(f"law is {law!r}, expected {EXPECTED}")
    module = _module_of_file(require_file(place)) if place.endswith(".py") else _module(place)
    if not hasattr(module, name):
        classes = [n for n, kind in vars(module).items() if hasattr(kind, "step")]
        raise LawError(f"{place} has no class {name}; it has {', '.join(classes) or 'none'}")
    return PythonLaw(getattr(module, name)(joints, period), module.__file__)


def require_file(path: str) -> str:
    """Return a path; raise LawError if there is no file."""
    if not Path(path).is_file():
        raise LawError(f"no file {path} in {os.getcwd()}")
    return path


def _module_of_file(path: str) -> Any:
    spec = spec_from_file_location(Path(path).stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name and name.startswith(error.name):
            raise LawError(f"no module {error.name} on the path of Python") from None
        raise


class PythonLaw:
    """Law that an object with a method `step`, and possibly `terminate`, computes.

    Raises:
        LawError: it has no method `step`.
    """

    def __init__(self, law: Any, path: str) -> None:
        if not callable(getattr(law, "step", None)):
            raise LawError(f"{type(law).__name__} has no method step(inputs)")
        self._law, self.path = law, path

    def step(self, inputs: Inputs) -> Outputs:
        """Return the commands for the next period."""
        outputs = self._law.step(inputs)
        if not isinstance(outputs, Outputs):
            raise LawError(f"step returned {type(outputs).__name__}, expected Outputs")
        return outputs

    def terminate(self) -> None:
        """End the law, if it has a method for it."""
        getattr(self._law, "terminate", lambda: None)()


class CLaw:
    """Law of three C functions in a shared library (law.h).

    Raises:
        LawError: the library cannot be loaded, lacks a function, or is of another version.
    """

    def __init__(self, path: str, joints: int, period: float) -> None:
        try:
            library = ctypes.CDLL(str(Path(path).resolve()))
            contract, init, self._step, self._terminate = (
                getattr(library, name) for name in C_FUNCTIONS
            )
        except (OSError, AttributeError) as error:
            raise LawError(f"{path} is not a law: {error}") from None
        contract.restype = ctypes.c_uint32
        if contract() != VERSION:
            raise LawError(
                f"{path} was compiled with another version of law.h; make it again with "
                "`python -m fss_gnc.law.header > law.h` and compile the law"
            )
        for function in (init, self._step, self._terminate):
            function.restype = None
        self.path = path
        self._step.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
        init.argtypes = [ctypes.c_int32, ctypes.c_double]
        init(joints, period)

    def step(self, inputs: Inputs) -> Outputs:
        """Return the commands for the next period."""
        given = to_record(inputs, inputs.joints)
        record = np.zeros((), STRUCTURES[Outputs])
        self._step(given.ctypes.data, record.ctypes.data)
        return from_record(Outputs, record, inputs.joints)

    def terminate(self) -> None:
        """End the law."""
        self._terminate()
