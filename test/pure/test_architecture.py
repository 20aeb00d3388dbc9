"""Who may import whom, read from the syntax trees."""

import ast
import re
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from xml.etree import ElementTree

import pytest

from fss_arm_ros.libraries import LIBRARIES

SOURCES = Path(__file__).parents[2] / "src"
MESSAGES = {
    *("action_msgs", "builtin_interfaces", "control_msgs", "diagnostic_msgs", "fss_arm_msgs"),
    *("geometry_msgs", "trajectory_msgs"),
    *("nav_msgs", "rcl_interfaces", "rosgraph_msgs", "sensor_msgs", "std_msgs", "std_srvs"),
    *("tf2_msgs", "unique_identifier_msgs", "visualization_msgs"),
}
ROS = MESSAGES | {"rclpy", "ament_index_python"}
ARRAYS, UNITS = "fss_arm_model.arrays", "fss_arm_model.units"
PROTOCOL, BOARD = "fss_arm_driver.protocol", "fss_base_driver.protocol"
SHARED_PROTOCOL = "fss_link.protocol"

#: What a package may import beside itself and the standard library, as in DESIGN.md, section 2.
ALLOWED = {
    "fss_arm_msgs": "common_interfaces",
    "fss_arm_model": "numpy, scipy, numba, yaml",
    "fss_arm_ros": "rclpy; model, msgs",
    "fss_arm_bags": "rosbags, mcap; model, ros, msgs",
    "fss_link": "pyserial; model, ros, msgs",
    "fss_arm_driver": "link, model, ros, msgs",
    "fss_base_driver": "motioncapture; link, model, ros, msgs",
    "fss_arm_motion": "model, ros, msgs",
    "fss_gnc": "model, motion, ros, msgs",
    "fss_sim": "model, ros, msgs, wire protocols of link and drivers",
    "fss_arm_calib": "scipy; model, ros, bags, msgs",
    "fss_arm_workspace": "model, ros, bags, msgs",
    "fss_arm_view": "rerun; model, gnc's navigation, ros, msgs",
    "fss_rehearsal": "all",
}
PACKAGES = sorted(ALLOWED.keys() - {"fss_arm_msgs"})

# The table's words as names of packages, and of single modules. The model's interface is arrays,
# and every node is rclpy's: their libraries come with them.
IMPORTS_BY_WORD = {
    "pyserial": {"serial"},
    "rerun": {"rerun", "rerun_cli"},
    "msgs": MESSAGES,
    "model": {"fss_arm_model", "numpy"},
    "ros": {"fss_arm_ros", "rclpy"},
    "link": {"fss_link"},
    "bags": {"fss_arm_bags"},
    "motion": {"fss_arm_motion"},
    "gnc's navigation": {"fss_gnc.navigation", "fss_gnc.navigation.messages"},
    "wire protocols of link and drivers": {SHARED_PROTOCOL, PROTOCOL, BOARD},
    "all": {*PACKAGES, *ROS, *LIBRARIES},
}

# Libraries that a package needs beyond its row.
FURTHER_LIBRARIES = {
    "fss_arm_ros": {"rich"},
    "fss_arm_bags": {"backports", "rich"},
    "fss_arm_driver": {"serial"},
    "fss_base_driver": {"scipy", "rich"},
    "fss_arm_motion": {"scipy", "yaml", "matplotlib"},
    "fss_gnc": {"fmpy", "scipy"},
    "fss_sim": {"gymnasium"},
    "fss_arm_calib": {"yaml", "rich", "matplotlib"},
    "fss_arm_workspace": {"scipy", "rich", "matplotlib"},
}

# What of the workspace a folder of a package, or a whole one, may import beside itself.
REGIONS = "fss_arm_workspace.regions"
WINGS = [f"fss_arm_calib.{kind}" for kind in ("kinematic", "dynamic", "drift", "drives")]


def within(package: str, names: str) -> set[str]:
    """Modules of a package by their names, which spaces separate."""
    return {f"{package}.{name}" for name in names.split()}


SHARED = within(
    "fss_arm_calib",
    "segments acceptance calibration checks codec messages noise outcome precision "
    "report_parts settings",
)
ROOMS = {
    "fss_arm_bags": {
        *(ARRAYS, UNITS, "fss_arm_ros"),
        *within("fss_arm_model", "files planar settings"),
    },
    "fss_arm_driver": {
        *("fss_link", "fss_arm_ros", "fss_arm_msgs", ARRAYS, UNITS),
        *within("fss_arm_model", "description description_file files settings straight_moves"),
        *within("fss_arm_model", "urdf vehicle"),
        *within("fss_arm_model.guard", "guard settings"),
    },
    SHARED_PROTOCOL: set(),
    "fss_link.session": {UNITS, SHARED_PROTOCOL, "fss_arm_ros.log_line"},
    "fss_link.transport": {SHARED_PROTOCOL},
    PROTOCOL: {SHARED_PROTOCOL},
    "fss_arm_driver.session": {
        *(UNITS, "fss_arm_model.description", SHARED_PROTOCOL, "fss_link.session", PROTOCOL),
        *within("fss_arm_driver", "scale knots faults"),
    },
    "fss_arm_driver.copley": {
        *(SHARED_PROTOCOL, "fss_link.transport", PROTOCOL, "fss_arm_driver.faults"),
    },
    BOARD: {SHARED_PROTOCOL},
    "fss_sim.plant": {"fss_arm_model"},
    "fss_sim.link": {
        *("fss_arm_model", SHARED_PROTOCOL, PROTOCOL),
        *within("fss_sim", "plant faults noise"),
    },
    "fss_sim.board": {
        *("fss_arm_model", SHARED_PROTOCOL, BOARD),
        *within("fss_sim", "plant faults noise link.channel link.power link.radio"),
    },
    "fss_arm_model.estimation": {ARRAYS},
    "fss_arm_calib.segments": {"fss_arm_model", "fss_arm_bags.recorded", "fss_arm_ros.dates"},
    **{wing: {"fss_arm_model", "fss_arm_msgs", "fss_arm_ros", *SHARED} for wing in WINGS},
    "fss_arm_calib.joint": {
        *("fss_arm_model", "fss_arm_bags", "fss_arm_msgs", "fss_arm_ros", *SHARED),
        *within("fss_arm_calib", "bag_data kinds"),
        *within("fss_arm_calib.dynamic", "knowledge settings"),
    },
    "fss_gnc.navigation": {
        *("fss_arm_model", "fss_arm_msgs.msg", "fss_arm_ros.convert", "fss_arm_ros.stamps"),
    },
    "fss_gnc.control": {"fss_arm_model", "fss_gnc.latest", "fss_gnc.reference"},
    "fss_gnc.law": {
        *("fss_arm_model", "fss_gnc.latest", "fss_gnc.reference"),
        *("fss_arm_msgs.msg", "fss_arm_ros.convert", "fss_arm_ros.realtime"),
    },
    "fss_gnc.guidance": {
        *("fss_arm_model", "fss_arm_motion", "fss_arm_msgs.action", "fss_arm_ros.log_line"),
        *within("fss_gnc", "bounds latest reference"),
    },
    REGIONS: {ARRAYS, "fss_arm_model.description", "fss_arm_model.layout"},
    "fss_arm_workspace.manipulability": {"fss_arm_model", REGIONS},
    "fss_arm_workspace.straight_path": {
        *("fss_arm_model", REGIONS, "fss_arm_workspace.manipulability.measure"),
    },
}

# Where the mathematics of a package meets ROS: its nodes, their actions and topics, and these.
EDGES = {
    *("settings", "codec", "messages", "health", "kind", "kinds", "from_bag", "from_bag_options"),
    *("check_command", "design_command", "plan_command", "recompute", "programs", "from_bags"),
    "bag_data",
}
AT_THE_EDGE = ("_node", "_action", "_topic", "_topics")
MATHEMATICS = {*PACKAGES} - {"fss_arm_ros", "fss_arm_bags", "fss_rehearsal"}


def top_package(module: str) -> str:
    return module.partition(".")[0]


def tops(modules: Iterable[str]) -> set[str]:
    return set(map(top_package, modules))


def module_name(path: Path) -> str:
    parts = path.relative_to(SOURCES).with_suffix("").parts[1:]
    return ".".join(parts).removesuffix(".__init__")


#: The file of each module of the workspace.
MODULES = {
    module_name(path): path
    for package in PACKAGES
    for path in sorted((SOURCES / package / package).rglob("*.py"))
}


def text(module: str) -> str:
    return MODULES[module].read_text(encoding="utf-8")


@cache
def tree(module: str) -> ast.Module:
    return ast.parse(text(module))


@cache
def imports(module: str) -> frozenset[str]:
    """The modules that `module` imports, be it within functions, by their full names."""
    path = MODULES[module]
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    names = set()
    for statement in ast.walk(tree(module)):
        if isinstance(statement, ast.Import):
            names |= {alias.name for alias in statement.names}
        elif isinstance(statement, ast.ImportFrom):
            base = ".".join(package.split(".")[: len(package.split(".")) + 1 - statement.level])
            source = ".".join(filter(None, [base if statement.level else "", statement.module]))
            inner = {f"{source}.{alias.name}" for alias in statement.names} & MODULES.keys()
            names |= inner or {source}
    return frozenset(names)


def reached(module: str) -> set[str]:
    """All that importing `module` may load, through the modules of the workspace."""
    seen: set[str] = set()
    rest = [module]
    while rest:
        name = rest.pop()
        if name not in seen:
            seen.add(name)
            rest.extend(imports(name) if name in MODULES else ())
    return seen


def allowed(package: str) -> set[str]:
    """Packages and single modules that a package may import."""
    words = re.split("[,;] ", ALLOWED[package])
    found = {name for word in words for name in IMPORTS_BY_WORD.get(word, {word})}
    return {package} | found | FURTHER_LIBRARIES.get(package, set())


def is_allowed(name: str, package: str) -> bool:
    return top_package(name) in sys.stdlib_module_names or bool(
        allowed(package) & {name, top_package(name)}
    )


def mathematics() -> Iterator[str]:
    for module in MODULES:
        package, name = top_package(module), module.rpartition(".")[2]
        if package in MATHEMATICS and name not in EDGES and not name.endswith(AT_THE_EDGE):
            yield module


def test_every_package_has_its_row() -> None:
    packages = {path.parent.name for path in SOURCES.glob("*/setup.py")}
    assert packages == set(PACKAGES)
    assert packages == {module for module in MODULES if "." not in module}


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_imports_what_its_row_allows(package: str) -> None:
    modules = [module for module in MODULES if top_package(module) == package]
    foreigners = {
        f"{module} imports {name}"
        for module in modules
        for name in imports(module)
        if not is_allowed(name, package)
    }
    assert not foreigners
    assert FURTHER_LIBRARIES.get(package, set()) <= tops(set().union(*map(imports, modules)))


def test_packages_and_modules_import_each_other_in_one_direction() -> None:
    """Also imports within functions and those for type checking count."""
    packages = {package: foreign(package) & set(PACKAGES) for package in PACKAGES}
    modules = {module: imports(module) & MODULES.keys() - {module} for module in MODULES}
    for graph in (packages, modules):
        tuple(TopologicalSorter(graph).static_order())  # raises CycleError, which names the cycle


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_what_its_row_allows(room: str) -> None:
    inside = [module for module in MODULES if module.startswith(f"{room}.")]
    given = tuple(f"{name}." for name in {room, *ROOMS[room]})
    ours = {n for m in inside for n in imports(m) if n.startswith("fss_")}
    assert inside
    assert not {name for name in ours if not f"{name}.".startswith(given)}


def test_private_names_are_used_in_their_own_module_only() -> None:
    """Ruff's PLC2701 finds those of other packages only."""
    found = {
        f"{module}: {alias.name}"
        for module in MODULES
        for statement in ast.walk(tree(module))
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
        if re.match("_[^_]", alias.name)
    }
    assert not found


#: Names that rclpy keeps private, as far as this workspace has ever used them.
PRIVATE_RCLPY = re.compile(r"_rclpy_pybind11|\b_parameter_overrides\b|_callback_type|\._tasks\b")


def test_private_names_of_rclpy_are_in_one_module() -> None:
    users = {module for module in MODULES if PRIVATE_RCLPY.search(text(module))}
    assert users == {"fss_arm_ros.rclpy_compat"}


def test_the_session_reads_no_clock_and_does_no_io() -> None:
    rooms = ("fss_link.session.", "fss_arm_driver.session.")
    session = {n for m in MODULES if m.startswith(rooms) for n in imports(m)}
    pure = {
        *("abc", "bisect", "collections", "collections.abc", "dataclasses", "enum", "math"),
        *("statistics", "typing"),
        "secrets",  # for the times in commands, which no recording may repeat
    }
    assert {name for name in session if not name.startswith("fss_")} <= pure


def test_only_the_layout_knows_where_what_stands_in_the_parameter_vector() -> None:
    by_hand = re.compile(r"\bp\[(\.\.\., )?(-?\d|\d \*)")
    packages = ("fss_arm_model.", "fss_arm_workspace.", "fss_sim.")
    found = {m for m in MODULES if m.startswith(packages) and by_hand.search(text(m))}
    assert not found


@pytest.mark.parametrize("module", list(mathematics()))
def test_mathematics_is_free_of_ros(module: str) -> None:
    assert not tops(reached(module)) & ROS


@pytest.mark.parametrize("package", ["fss_link", "fss_arm_driver", "fss_arm_ros", "fss_arm_bags"])
def test_drivers_of_links_and_recorder_load_no_kernels(package: str) -> None:
    """But what is the arm's, for the guard."""
    of_the_arm = ("fss_arm_driver.arm", "fss_arm_driver.driver_node")
    loading = {m for m in MODULES if m.startswith(package) and "numba" in tops(reached(m))}
    assert not {m for m in loading if not m.startswith(of_the_arm)}


def foreign(package: str) -> set[str]:
    """What a package imports that is neither its own nor Python's."""
    names = {name for m in MODULES if m.split(".")[0] == package for name in tops(imports(m))}
    return names - {package} - sys.stdlib_module_names


def manifest(package: str) -> ElementTree.Element:
    return ElementTree.parse(SOURCES / package / "package.xml").getroot()


@pytest.mark.parametrize("package", PACKAGES)
def test_package_xml_depends_on_what_is_imported(package: str) -> None:
    names = foreign(package)
    libraries = {LIBRARIES[name] for name in names & LIBRARIES.keys()}
    keys = names - LIBRARIES.keys() | {library.rosdep for library in libraries} - {""}
    depends = [tag.text for tag in manifest(package).iter("exec_depend")]
    assert sorted(depends) == sorted(keys)
    text = (SOURCES / package / "package.xml").read_text()
    comments = re.findall(r"<!-- (\S+): pip installs it, not rosdep", text)
    assert sorted(comments) == sorted(one.pip for one in libraries if not one.rosdep)


def test_the_messages_package_xml_depends_on_the_types_of_fields() -> None:
    fields = "\n".join(path.read_text() for path in (SOURCES / "fss_arm_msgs").glob("*/*.*"))
    used = set(re.findall(r"^(\w+)/[A-Z]", fields, re.M)) | {"action_msgs"}
    assert {tag.text for tag in manifest("fss_arm_msgs").iter("depend")} == used


@pytest.mark.parametrize("package", PACKAGES)
def test_setup_py_and_package_xml_say_the_same(package: str) -> None:
    call = next(
        node.value
        for node in ast.parse((SOURCES / package / "setup.py").read_text()).body
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    )
    given = {k.arg: k.value for k in call.keywords}
    root = manifest(package)
    for field in ("name", "version", "description", "maintainer", "license", "url"):
        assert ast.literal_eval(given[field]) == root.findtext(field), field
    maintainer = root.find("maintainer")
    assert maintainer is not None
    assert ast.literal_eval(given["maintainer_email"]) == maintainer.get("email")


def test_all_packages_agree_on_version_maintainer_licence_and_address() -> None:
    roots = [ElementTree.parse(path).getroot() for path in SOURCES.glob("*/package.xml")]
    for tag in ("version", "maintainer", "license", "url"):
        assert len({root.findtext(tag) for root in roots}) == 1, tag
    for path in SOURCES.glob("*/*/__init__.py"):  # as results name what computed them
        told = re.findall(r'^__version__ = "(.*)"', path.read_text(), re.M)
        assert told in ([], [roots[0].findtext("version")]), path
    citation = (SOURCES.parent / "CITATION.cff").read_text()
    assert f"\nversion: {roots[0].findtext('version')}\n" in citation
    assert len(roots) == len(PACKAGES) + 1  # and the messages


def test_the_smoke_tests_of_all_packages_are_one() -> None:
    texts = {(SOURCES / package / "test/test_smoke.py").read_text() for package in PACKAGES}
    assert len(texts) == 1
