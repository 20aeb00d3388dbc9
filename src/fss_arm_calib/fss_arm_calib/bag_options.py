"""Command-line options shared by the commands that estimate from bags."""

import argparse
from argparse import BooleanOptionalAction
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from fss_arm_model.settings import default_in, default_text, meaning

EPILOG = "Exit codes: 0 pass, 1 the command cannot be carried out, 2 fail, 3 not evaluated."


def default_settings(kind: type[Any], namespace: str) -> dict[str, Any]:
    """Return the default settings of a vehicle in a namespace."""
    return {f.name: default_in(f, namespace) for f in fields(kind)}


def add_output_options(p: argparse.ArgumentParser, output_name: str) -> None:
    """Add the options that every estimate from bags has: the output files and the namespace."""
    p.add_argument(
        "--output", metavar="FILE", help=f"write the {output_name} if the calibration passes"
    )
    p.add_argument(
        "--result", metavar="JSON", help="write the result as JSON and CSV, whatever the verdict"
    )
    p.add_argument("--report", metavar="DIR", help="write an HTML page, and its figures as PNG")
    p.add_argument("--details", action="store_true", help="print all tables and checks")
    p.add_argument("--truth", metavar="YAML", help="true description to compare with in the report")
    p.add_argument("--namespace", default="", help="namespace of the vehicle, e.g. fss2")


def add_settings(
    p: argparse.ArgumentParser, kind: type[Any], names: Sequence[str] | None = None
) -> None:
    """Add an option for each setting of a dataclass, or only for those in `names`."""
    for f in (f for f in fields(kind) if names is None or f.name in names):
        flag, about = f"--{f.name.replace('_', '-')}", meaning(f)
        if isinstance(f.default, bool):
            p.add_argument(flag, action=BooleanOptionalAction, default=f.default, help=about)
            continue
        several = f.default if isinstance(f.default, tuple) else ()
        p.add_argument(
            flag,
            type=type(several[0] if several else f.default),
            nargs=len(several) or None,
            default=f.default,
            metavar=f.name.split("_")[-1].upper() if isinstance(f.default, str) else "N",
            help=f"{about}{_default(f.default)}".replace("%", "%%"),
        )


def _default(value: Any) -> str:
    """Return a default as help shows it after the meaning, which names the effect of ''."""
    words = " ".join(map(default_text, value)) if isinstance(value, tuple) else default_text(value)
    return words and f" (default {words})"
