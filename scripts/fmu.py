"""Exports the simulated plant of a description, or a control law in C, as an FMU for co-simulation.

The FMU is fmi/fmi.c over a block of memory, with fmi/plant.c or fmi/law.c. Its variables are
members of the contract's structures.
"""

import argparse
import os
import re
import shlex
import subprocess
import sys
import uuid
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np

from fss_arm_model.description import Arm
from fss_arm_model.description_file import described
from fss_arm_ros.libraries import required_libraries
from fss_gnc.law.contract import MAX_JOINTS, STRUCTURES, Inputs, Outputs, members
from fss_gnc.law.header import header
from fss_rehearsal import law_plant

SOURCES = Path(__file__).resolve().parent / "fmi"
FLAGS = ["-O2", "-ffp-contract=off", "-fPIC", "-shared"]  # rounds as Python does
LAW_BLOCK = np.dtype(
    [("time", "f8"), ("in", STRUCTURES[Inputs]), ("out", STRUCTURES[Outputs])], align=True
)
TIMES = "time", "period"  # inputs of a law that an FMU has from its simulation
STATES = "base_pose", "base_twist", "joint_angles", "joint_rates", "propellant"  # of the plant
TYPES = {2: {"f": "Real", "i": "Integer"}, 3: {"f": "Float64", "i": "Int32"}}
PLANT_SCRIPT = """\
# Started by the FMU in its process; a simulation tool's libraries are not Python's.
unset LD_LIBRARY_PATH
export PYTHONPATH={path}
exec {python} -m fss_rehearsal.law_plant "${{0%/*}}/arm.yaml" 3
"""


@dataclass(frozen=True)
class Variable:
    """Variable of an FMU: a scalar, or in FMI 3.0 an array."""

    name: str
    causality: str
    about: str
    dtype: np.dtype[Any]
    offset: int  # in the block [bytes]
    size: int = 0  # 0: a scalar
    start: tuple[float, ...] = (0.0,)

    def elements(self) -> Iterator["Variable"]:
        """Yield the elements as scalars."""
        if not self.size:
            yield self
        for i in range(self.size):
            at, start = self.offset + i * self.dtype.itemsize, self.start[i : i + 1]
            name = f"{self.name}[{i + 1}]"
            yield Variable(name, self.causality, self.about, self.dtype, at, start=start)


@dataclass(frozen=True)
class Model:
    """Model for an FMU."""

    name: str
    block: np.dtype[Any]
    variables: list[Variable]
    sources: list[Path]
    resources: dict[str, str] = field(default_factory=dict)  # texts by name


def structure_variables(
    kind: type, causality: str, offset: int, joints: int, **starts: float
) -> Iterator[Variable]:
    """Yield the variables of a structure of the contract.

    Args:
        kind: Inputs or Outputs.
        causality: input or output of the FMU.
        offset: of the structure in the block [bytes].
        joints: number of elements of an array over joints.
        starts: initial values by name; 0 by default.
    """
    places = STRUCTURES[kind].fields
    assert places is not None
    for m in members(kind):
        size = joints if m.size == MAX_JOINTS else m.size
        start = (starts.get(m.name, 0.0),) * max(size, 1)
        at = offset + places[m.name][1]
        yield Variable(m.name, causality, m.comment, m.dtype, at, size, start)


def law_model(source: Path) -> Model:
    """Return the model of a law in C."""
    offsets = LAW_BLOCK.fields
    assert offsets is not None
    given = structure_variables(Inputs, "input", offsets["in"][1], MAX_JOINTS)
    commands = structure_variables(Outputs, "output", offsets["out"][1], MAX_JOINTS)
    variables = [*(v for v in given if v.name not in TIMES), *commands]
    return Model(source.stem, LAW_BLOCK, variables, [SOURCES / "law.c", source])


def plant_model(description: Path, arm: Arm) -> Model:
    """Return the model of the plant of a description."""
    block, n = law_plant.BLOCK, arm.n
    offsets = block.fields
    assert offsets is not None
    variables = [
        *structure_variables(
            Outputs, "input", offsets["commands"][1], n, wrench_valid=1, joint_velocities_valid=1
        ),
        *(
            v
            for v in structure_variables(Inputs, "output", offsets["states"][1], n)
            if v.name in STATES
        ),
    ]
    variables = [v for v in variables if not v.name.startswith("gripper")]
    for name, size, about in (
        ("start_pose", 3, "initial x, y, heading of the base [m, m, rad]"),
        ("start_joint_angles", n, "initial angles of the joints [rad]"),
    ):
        zero, at = (0.0,) * size, offsets[name][1]
        variables.append(Variable(name, "parameter", about, np.dtype("f8"), at, size, zero))
    path = shlex.quote(os.environ.get("PYTHONPATH", ""))
    script = PLANT_SCRIPT.format(path=path, python=shlex.quote(sys.executable))
    texts = {"arm.yaml": description.read_text(), "plant.sh": script}
    return Model(description.stem, block, variables, [SOURCES / "plant.c"], texts)


def export(model: Model, fmi: int, output: Path) -> None:
    """Compile a model and write its FMU.

    Args:
        model: what to export.
        fmi: 2 or 3.
        output: file of the FMU.

    Raises:
        subprocess.CalledProcessError: the compiler has failed.
    """
    import fmpy

    name = re.sub(r"\W", "_", model.name)
    variables = [Variable("time", "independent", "time of the FMU [s]", np.dtype("f8"), 0)]
    variables += model.variables
    if fmi == 2:
        variables = [element for v in variables for element in v.elements()]
    token = f"{{{uuid.uuid4()}}}"
    headers = Path(fmpy.__file__).parent / "c-code"
    platform = fmpy.platform if fmi == 2 else fmpy.platform_tuple
    with TemporaryDirectory() as folder:
        build, library = Path(folder), Path(folder) / f"{name}.so"
        (build / "law.h").write_text(header())
        (build / "block.h").write_text(block_header(model.block, variables, token))
        (build / "stubs.c").write_text(stubs((headers / f"fmi{fmi}Functions.h").read_text()))
        sources = [SOURCES / "fmi.c", build / "stubs.c", *model.sources]
        includes = [f"-DFMI={fmi}", f"-I{build}", f"-I{headers}"]
        command = ["cc", *FLAGS, *includes, "-o", library, *sources, "-lm"]
        subprocess.run(command, check=True)
        with zipfile.ZipFile(output, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(
                "modelDescription.xml", description_xml(name, token, variables, fmi, model)
            )
            archive.write(library, f"binaries/{platform}/{name}.so")
            for file, text in model.resources.items():
                archive.writestr(f"resources/{file}", text)


def block_header(block: np.dtype[Any], variables: list[Variable], token: str) -> str:
    """Return block.h: size and initial values of the block, and the place of each variable."""
    start = np.zeros(block.itemsize, "u1")
    rows = []
    for v in variables:
        count = max(v.size, 1)
        values = np.array(v.start, v.dtype).view("u1")
        start[v.offset : v.offset + len(values)] = values
        rows.append(f"{{{v.offset}, {count}}}")
    return (
        f'#define TOKEN "{token}"\n#define VARIABLE_COUNT {len(rows)}\n'
        f"static const unsigned char START[] = {{{', '.join(map(str, start))}}};\n"
        f"static const struct {{ unsigned offset, size; }} VARIABLES[] = {{{', '.join(rows)}}};\n"
    )


def stubs(functions: str) -> str:
    """Return C functions that fail, for those in a header of FMI that fmi.c does not define."""
    names = re.findall(r"^\s*FMI\d_Export\s+\w+\s+(\w+);", functions, re.M)
    return "".join(f"__attribute__((weak)) int {name}() {{ return 3; }}\n" for name in names)


def description_xml(
    name: str, token: str, variables: list[Variable], fmi: int, model: Model
) -> bytes:
    """Return modelDescription.xml."""
    key = "guid" if fmi == 2 else "instantiationToken"
    root = Xml.Element(
        "fmiModelDescription",
        {"fmiVersion": f"{fmi}.0", "modelName": name, key: token, "generationTool": "FSS Arm",
         "variableNamingConvention": "structured"},
    )  # fmt: skip
    Xml.SubElement(
        root,
        "CoSimulation",
        {"modelIdentifier": name, "canHandleVariableCommunicationStepSize": "true",
         "canBeInstantiatedOnlyOncePerProcess": "true",
         "needsExecutionTool": "true" if model.resources else "false"},
    )  # fmt: skip
    listed = Xml.SubElement(root, "ModelVariables")
    for k, v in enumerate(variables):
        kind = v.dtype.kind
        attributes = {"name": v.name, "valueReference": str(k), "causality": v.causality,
                      "description": v.about}  # fmt: skip
        if v.causality == "parameter":
            attributes |= {"variability": "fixed", "initial": "exact"}
        elif v.causality == "output" or kind == "i":
            attributes["variability"] = "continuous" if kind == "f" else "discrete"
        elif v.causality == "independent":
            attributes["variability"] = "continuous"
        convert = int if kind == "i" else float
        has_start = v.causality in {"input", "parameter"}
        start = {"start": " ".join(str(convert(x)) for x in v.start)} if has_start else {}
        if fmi == 2:
            scalar = Xml.SubElement(listed, "ScalarVariable", attributes)
            Xml.SubElement(scalar, TYPES[2][kind], start)
        else:
            array = Xml.SubElement(listed, TYPES[3][kind], attributes | start)
            if v.size:
                Xml.SubElement(array, "Dimension", {"start": str(v.size)})
    structure = Xml.SubElement(root, "ModelStructure")
    outputs = [k for k, v in enumerate(variables) if v.causality == "output"]
    if fmi == 2:
        for part in ("Outputs", "InitialUnknowns"):
            unknowns = Xml.SubElement(structure, part)
            for k in outputs:
                Xml.SubElement(unknowns, "Unknown", {"index": str(k + 1)})
    else:
        for part in ("Output", "InitialUnknown"):
            for k in outputs:
                Xml.SubElement(structure, part, {"valueReference": str(k)})
    Xml.indent(root)
    return Xml.tostring(root, encoding="UTF-8", xml_declaration=True)


def main() -> int:
    """Export an FMU; return the exit code."""
    parser = argparse.ArgumentParser(prog="fmu.sh", description=__doc__.partition("\n")[0])
    parser.add_argument("source", type=Path, help="ARM.yaml: its plant; LAW.c: the law")
    parser.add_argument("--fmi", type=int, choices=[2, 3], default=2, help="version (default 2)")
    parser.add_argument("--output", type=Path, help="file of the FMU (default: NAME.fmu)")
    options = parser.parse_args()
    source, output = options.source, options.output or Path(f"{options.source.stem}.fmu")
    try:
        if source.suffix == ".c":
            model = law_model(source.resolve(strict=True))
        elif source.suffix not in {".yaml", ".yml"}:
            raise ValueError(
                f"{source}: only a law in C (.c) or a description (.yaml) can be exported"
            )
        else:
            model = plant_model(source, described(str(source)))
        with required_libraries("fmu.sh"):
            export(model, options.fmi, output)
    except OSError as error:
        print(f"fmu.sh: {error.filename}: {error.strerror}", file=sys.stderr)
        return 1
    except ValueError as error:
        print(f"fmu.sh: {error}", file=sys.stderr)
        return 1
    except subprocess.CalledProcessError:
        return 1  # the compiler has reported why
    print(f"FMU for co-simulation, FMI {options.fmi}.0: {output}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
