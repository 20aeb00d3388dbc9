"""Sphinx settings of the documentation site, which scripts/docs.sh builds."""

import re
import subprocess
import sys
from pathlib import Path

from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "src"
sys.path += map(str, SOURCES.glob("fss_*"))
#: Packages with a page, without the modules whose names end so: those need ROS or are executables,
#: and the reference describes their topics, parameters and messages.
PACKAGES = (
    *("fss_arm_model", "fss_arm_motion", "fss_arm_calib", "fss_arm_workspace"),
    *("fss_gnc", "fss_sim", "fss_arm_bags"),
)
LEFT_OUT = (
    *("_node", "_topics", "_action", "_options", "command", "programs", "node_settings"),
    *("messages", "codec", "kind", "kinds", "from_bag", "from_bags", "recompute", "map"),
)


def repository_version() -> str:
    """Return the version of CITATION.cff, and the commit if there is a repository."""
    (version,) = re.findall(r"^version: (.*)", (ROOT / "CITATION.cff").read_text(), re.M)
    command = ["git", "-C", str(SOURCES), "describe", "--always", "--dirty", "--exclude", "*"]
    found = subprocess.run(command, capture_output=True, text=True)
    return f"{version} ({found.stdout.strip()})" if found.returncode == 0 else version


project = "FSS Arm"
author = "FSS Arm maintainers"
release = version = repository_version()
html_title = f"{project} {release}"

root_doc = "README"
include_patterns = ["*.md", "docs/*.md", "docs/**/*.md", "test/TRIALS.md", "api/**"]
exclude_patterns = ["api/*/modules.rst"]
extensions = [
    *("myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.apidoc"),
    "sphinx-mathjax-offline",
]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
highlight_language = "text"

html_theme = "furo"
html_copy_source = False

# ROS, its messages and the compiled libraries need not be installed.
autodoc_mock_imports = [
    *("rclpy", "ament_index_python", "numba", "scipy", "serial", "rerun", "rich", "matplotlib"),
    *("dask", "pyarrow", "action_msgs", "builtin_interfaces", "control_msgs", "diagnostic_msgs"),
    *("fss_arm_msgs", "geometry_msgs", "nav_msgs", "rcl_interfaces", "rosgraph_msgs"),
    *("sensor_msgs", "std_msgs", "std_srvs", "tf2_msgs", "trajectory_msgs"),
    *("unique_identifier_msgs", "visualization_msgs"),
]
autodoc_member_order = "bysource"
suppress_warnings = ["ref.python"]  # names of errors that several modules define
autodoc_typehints = "none"  # the docstrings give shapes and units
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
apidoc_modules = [
    {
        "path": str(SOURCES / package / package),
        "destination": f"api/{package}",
        "separate_modules": False,
        "module_first": True,
        "max_depth": 1,
        "include_private": False,
        "exclude_patterns": [str(SOURCES / f"*{name}.py") for name in LEFT_OUT],
    }
    for package in PACKAGES
]

SECTIONS = ("Start", "How to", "Explanation", "Reference")  # of docs/README.md
DOCSTRING_SECTIONS = ("Args", "Returns", "Raises", "Yields", "Attributes")


def add_navigation(app: Sphinx, docname: str, source: list[str]) -> None:
    """Append a table of contents to the front page for each section of the index, and the API."""
    if docname != root_doc:
        return
    index = (ROOT / "docs/README.md").read_text()
    for section in SECTIONS:
        text = index.partition(f"\n## {section}\n")[2].partition("\n## ")[0]
        pages = dict.fromkeys(re.findall(r"\]\((?!\.\.)([\w/-]+\.md)(?:#[\w-]+)?\)", text))
        source[0] += toctree(section, [f"docs/{page}" for page in pages])
    source[0] += toctree("Python API", [f"api/{package}/{package}" for package in PACKAGES])
    others = ["docs/README", "CONTRIBUTING", "test/TRIALS", "CHANGELOG"]
    source[0] += toctree("Project", others)


def toctree(caption: str, pages: list[str]) -> str:
    """Return a hidden table of contents in Markdown."""
    entries = "\n".join(page.removesuffix(".md") for page in pages)
    return f"\n```{{toctree}}\n:hidden:\n:caption: {caption}\n\n{entries}\n```\n"


def to_rst(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Turn a plain docstring into reStructuredText: code, equations, symbols such as J* and |x|."""
    converted: list[str] = []
    equation = False
    for line in lines:
        after_blank = bool(converted) and not converted[-1].strip()
        if not line.startswith("    "):
            equation = False
        elif after_blank and not equation and not in_section(converted):
            equation = True
            converted += ["::", ""]
        converted.append(line if equation else escaped(line))
    lines[:] = converted


def in_section(lines: list[str]) -> bool:
    """Return True if the last unindented line heads a section such as Args."""
    heads = [line for line in lines if line.strip() and not line.startswith(" ")]
    return bool(heads) and heads[-1] in {f"{section}:" for section in DOCSTRING_SECTIONS}


def escaped(line: str) -> str:
    """Return a line of text with code marked and the special characters of RST escaped."""
    parts = line.split("`")
    if len(parts) % 2 == 0:
        return re.sub(r"([*|`]|_\b)", r"\\\1", line)
    plain = [re.sub(r"([*|]|(?<=\w)_(?!\w))", r"\\\1", part) for part in parts[::2]]
    coded = [f"``{part}``" for part in parts[1::2]]
    return "".join(a + b for a, b in zip(plain, [*coded, ""], strict=True))


def setup(app: Sphinx) -> None:
    """Connect the functions above."""
    app.connect("source-read", add_navigation)
    app.connect("autodoc-process-docstring", to_rst, priority=400)
