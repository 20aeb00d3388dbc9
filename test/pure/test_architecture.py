"""Who may import whom, read from the syntax trees."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

SOURCES = Path(__file__).parents[2] / "src"
MESSAGES = {
    "action_msgs", "builtin_interfaces", "diagnostic_msgs", "fss_arm_msgs", "geometry_msgs",
    "nav_msgs", "rcl_interfaces", "rosgraph_msgs", "sensor_msgs", "std_msgs", "std_srvs",
    "tf2_msgs", "visualization_msgs",
}  # fmt: skip
ROS = MESSAGES | {"rclpy", "ament_index_python"}
MODEL = {"numpy", "scipy", "numba", "yaml"}

# Beside itself and the standard library, a package may import these; a module's name in full
# allows that module alone.
ALLOWED = {
    "fss_arm_model": MODEL,
    "fss_arm_ros": ROS | {"fss_arm_model", "numpy"},
    "fss_arm_bags": ROS
    | {"fss_arm_model.settings", "fss_arm_ros", "numpy", "rosbags", "mcap", "rich"},
    "fss_arm_driver": ROS
    | {"fss_arm_model.description", "fss_arm_model.settings", "fss_arm_ros", "serial"},
    "fss_sim": ROS | {"fss_arm_model", "fss_arm_ros", "fss_arm_driver.protocol", "numpy", "yaml"},
    "fss_arm_calib": ROS
    | {"fss_arm_model", "fss_arm_ros", "fss_arm_bags"}
    | {"numpy", "scipy", "yaml", "rich", "matplotlib"},
    "fss_arm_workspace": ROS
    | {"fss_arm_model", "fss_arm_ros", "fss_arm_bags", "numpy", "scipy", "rich", "matplotlib"},
    "fss_arm_view": ROS | {"fss_arm_model", "fss_arm_ros", "numpy", "rerun", "rerun_cli"},
}

# Where the mathematics of a package meets ROS: its nodes, and these.
EDGES = {
    "settings", "messages", "kind", "kinds", "from_bag", "design_command", "recompute",
}  # fmt: skip
MATHEMATICS = {
    "fss_arm_model", "fss_arm_driver", "fss_sim", "fss_arm_calib", "fss_arm_workspace",
    "fss_arm_view",
}  # fmt: skip


# Within fss_arm_calib, a room may import itself and these; the three wings know nothing of each
# other.
_SHARED = {
    "estimation", "segments", "acceptance", "calibration", "messages", "outcome", "report",
    "report_figures", "report_tables", "settings",
}  # fmt: skip
ROOMS: dict[str, set[str]] = {
    "estimation": set(),
    "segments": {"estimation"},
    "kinematic": _SHARED,
    "dynamic": _SHARED,
    "drift": _SHARED,
}


def find_modules() -> dict[str, Path]:
    """The file of each module of the workspace."""
    found = {}
    for package in ALLOWED:
        for path in sorted((SOURCES / package / package).rglob("*.py")):
            parts = path.relative_to(SOURCES / package).with_suffix("").parts
            found[".".join(parts).removesuffix(".__init__")] = path
    return found


MODULES = find_modules()


@cache
def imports(module: str) -> frozenset[str]:
    """The modules that `module` imports, be it within functions, by their full names."""
    path = MODULES[module]
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    names = set()
    for statement in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
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


def tops(modules: set[str]) -> set[str]:
    return {module.partition(".")[0] for module in modules}


def is_allowed(name: str, package: str) -> bool:
    top = name.partition(".")[0]
    return top in sys.stdlib_module_names or bool({package, *ALLOWED[package]} & {top, name})


def mathematics() -> Iterator[str]:
    for module in MODULES:
        package, name = module.partition(".")[0], module.rpartition(".")[2]
        if package in MATHEMATICS and name not in EDGES and not name.endswith("_node"):
            yield module


def test_every_package_has_its_row() -> None:
    packages = {path.parent.name for path in SOURCES.glob("*/setup.py")}
    assert packages == ALLOWED.keys()
    assert ALLOWED.keys() == {module for module in MODULES if "." not in module}


@pytest.mark.parametrize("package", ALLOWED)
def test_a_package_imports_what_its_row_allows(package: str) -> None:
    strangers = {
        f"{module} imports {name}"
        for module in MODULES
        if module.partition(".")[0] == package
        for name in imports(module)
        if not is_allowed(name, package)
    }
    assert not strangers


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_what_its_row_allows(room: str) -> None:
    allowed = [f"fss_arm_calib.{name}" for name in (room, *ROOMS[room])]
    strangers = {
        f"{module} imports {name}"
        for module in MODULES
        if f"{module}.".startswith(f"fss_arm_calib.{room}.")
        for name in imports(module)
        if name.startswith("fss_arm_calib")
        and not any(f"{name}.".startswith(f"{one}.") for one in allowed)
    }
    assert not strangers


@pytest.mark.parametrize("module", list(mathematics()))
def test_mathematics_is_free_of_ros(module: str) -> None:
    assert not tops(reached(module)) & ROS


@pytest.mark.parametrize("package", ["fss_arm_driver", "fss_arm_ros", "fss_arm_bags"])
def test_driver_and_recorder_load_no_kernels(package: str) -> None:
    loading = {m for m in MODULES if m.startswith(package) and "numba" in tops(reached(m))}
    assert not loading


def test_the_plot_library_is_imported_only_where_it_is_used() -> None:
    at_the_top = {
        module
        for module, path in MODULES.items()
        for statement in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(statement, (ast.Import, ast.ImportFrom))
        and "matplotlib" in ast.unparse(statement)
    }
    assert not at_the_top


@pytest.mark.parametrize(
    "module", ["fss_arm_model.description", "fss_arm_driver.protocol", "fss_arm_driver.link"]
)
def test_importing_it_loads_neither_kernels_nor_ros(module: str) -> None:
    program = f"import sys, {module}; print({{'numba', 'rclpy', 'scipy'}} & sys.modules.keys())"
    run = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == "set()"
