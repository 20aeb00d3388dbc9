"""The report of a dynamic calibration, from its published message alone.

A DynamicCalibration passes as well, by attribute.
"""

from typing import Any

import numpy as np

from fss_arm_model.description import Arm, from_yaml, paper_arm

from .dynamic_parameters import parameter_names, values
from .kinematic_report import correlation
from .least_squares import Floats
from .report import Figure, Report, Table

PAPER_HEADING_RESIDUAL = float(np.radians(1.54))  # section 4.2, of the turn of a maneuver


def dynamic_report(calibration: Any, truth: Arm | None = None) -> Report:
    """Tell a DynamicCalibration.

    Args:
        calibration: the message.
        truth: the simulated arm, to compare with.
    """
    c = calibration
    solved = bool(len(c.residuals))
    figures = (
        Figure("dynamic_motion", "Predicted and measured motion of the base", lambda: motion(c)),
        Figure("dynamic_correlation", "Correlation of the parameters", lambda: correlation(c)),
    )
    origin = f"by {c.provenance.software} from {c.provenance.source}"
    return Report(
        title=f"Dynamic calibration of {c.arm}",
        verdict=c.verdict,
        reason=c.reason,
        tables=(_parameters(c, truth), *((_combinations(c), _residuals(c)) if solved else ())),
        origin=f"{origin}; SHA-256 of the maneuvers {c.provenance.data_hash}",
        figures=figures if solved else (),
        details=(_stages(c), *((_directions(c), _bias(c), _maneuvers(c)) if solved else ())),
        texts={"Settings": c.provenance.parameters, "Description it began from": c.guess},
    )


def _parameters(c: Any, truth: Arm | None) -> Table:
    """Beside the paper's Table 4 and, if known, the truth."""
    arm = from_yaml(c.guess)
    paper = _named(paper_arm(), c.names) if arm.n == paper_arm().n else {}
    true = _named(truth, c.names) if truth else {}
    random = np.sqrt(np.diag(_square(c.random_covariance, len(c.names))))
    rows = []
    for k, (name, unit) in enumerate(zip(c.names, c.units, strict=True)):
        row = [name, _unit(unit), _number(paper.get(name, np.nan), unit)]
        row += [_number(c.initial[k], unit)]
        if truth:
            row.append(_number(true.get(name, np.nan), unit))
        row += [_number(c.values[k], unit), _number(c.deviations[k], unit)]
        row += [_number(random[k], unit)]
        row.append(f"{100.0 * c.prior_share[k]:.0f} %" if len(c.prior_share) else "-")
        if truth:
            error = (c.values[k] - true.get(name, np.nan)) / c.deviations[k]
            row.append(_text(error, "+.2f"))
        rows.append(row)
    head = [
        "parameter", "unit", "Table 4", "guess", *["truth"] * bool(truth), "estimate",
        "± 1 sigma", "random part", "from prior", *["error / sigma"] * bool(truth),
    ]  # fmt: skip
    note = "`random part`: without the uncertainty of what is assumed."
    return Table("Parameters", head, rows, words=2, note=note)


def _combinations(c: Any) -> Table:
    rows = [
        [name, unit, f"{value:.4f}", _text(before, ".4f"), _text(now, ".4f")]
        for name, unit, value, before, now in zip(
            c.combinations, c.combination_units, c.combination_values, c.combination_before,
            c.combination_deviations, strict=True,
        )
    ]  # fmt: skip
    note = "m = sum m_k, S_j = m_j g_j + a_j sum m_k (k > j), K_j = I_j + m_j g_j² + a_j² sum m_k."
    head = ["combination", "unit", "value", "± known before", "± 1 sigma"]
    return Table("All that motion depends on", head, rows, words=2, note=note)


def _residuals(c: Any) -> Table:
    rows = [
        ["heading", "deg", f"{np.degrees(c.heading_residual):.3f}"],
        ["position", "mm", _text(1e3 * c.position_residual, ".2f")],
        ["maneuver predicted from the others", "deviations",
         f"{np.sqrt(np.mean(np.square(c.prediction_errors))):.2f}"],
    ]  # fmt: skip
    return Table("Root mean square of the residuals", ["of", "unit", "here"], rows, words=2)


def _directions(c: Any) -> Table:
    rows = [
        [text, kind, f"{gain:.3g}"]
        for text, kind, gain in zip(c.directions, c.direction_kinds, c.direction_gains, strict=True)
    ]
    note = "Each parameter in units of what was known of it; the gain is by the data alone."
    return Table("What the data told", ["direction", "", "gain"], rows, words=2, note=note)


def _bias(c: Any) -> Table:
    bias = _wide(c.bias, len(c.assumed))
    rows = [
        [name, *(_number(bias[k, j], unit) for k, unit in enumerate(c.units))]
        for j, name in enumerate(c.assumed)
    ]
    note = "Shift of each estimate if the true value of an assumed parameter is 1 sigma higher."
    return Table("What a wrong assumption would do", ["assumed", *c.names], rows, note=note)


def _maneuvers(c: Any) -> Table:
    momenta = _wide(c.momenta, 3)
    rows = [
        [str(k + 1), *(f"{x:+.3f}" for x in momenta[k]), f"{c.leverage[k]:.2f}",
         f"{c.prediction_errors[k]:.2f}", f"{c.weights[k]:.2f}", c.reasons[k]]
        for k in range(len(c.marks))
    ]  # fmt: skip
    head = ["", "p_x [N s]", "p_y [N s]", "L [N m s]", "leverage", "error", "weight", ""]
    note = "Momentum at the start; error predicted from the other maneuvers, in its deviations."
    return Table("Maneuvers", head, rows, note=note)


def _stages(c: Any) -> Table:
    rows = [
        [s.name, s.verdict.replace("_", " "), s.reason, _text(s.value, ".4g"), f"{s.threshold:.4g}"]
        for s in c.stages
    ]
    head = ["stage", "verdict", "reason", "value", "threshold"]
    return Table("What the verdict is made of", head, rows, words=3)


def motion(c: Any) -> Any:
    """Residuals of every averaged pose, maneuver by maneuver."""
    from matplotlib.figure import Figure as Drawing  # takes long to import

    residuals = _wide(c.residuals, 3)
    edges = np.cumsum([0, *c.marks])
    figure = Drawing(figsize=(12, 6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    number = np.arange(len(residuals))
    upper.plot(number, np.degrees(residuals[:, 2]), "o", color="tab:green", markersize=3)
    upper.set_ylabel("heading residual [deg]")
    for k, (name, color) in enumerate((("x", "tab:blue"), ("y", "tab:orange"))):
        lower.plot(number, 1e3 * residuals[:, k], "o", color=color, markersize=3, label=name)
    lower.set_ylabel("position residual [mm]")
    lower.legend(loc="upper right")
    for axes in (upper, lower):
        axes.axhline(0.0, color="0.3", linewidth=0.8)
        for edge in edges[1:-1]:
            axes.axvline(edge - 0.5, color="0.85", linewidth=0.8)
        axes.grid(axis="y", alpha=0.25)
    lower.set_xticks((edges[:-1] + edges[1:] - 1) / 2.0, range(1, len(edges)))
    lower.set_xlabel("maneuver")
    figure.suptitle("Observed minus predicted poses of the base", fontsize=13)
    return figure


def _named(arm: Arm, names: Any) -> dict[str, float]:
    """An arm's values of the named parameters; one for all links is their mean."""
    every = dict(zip(parameter_names(arm.n), values(arm).tolist(), strict=True))
    for stem in "mbI":
        every[stem] = float(np.mean([every[f"{stem}_{i}"] for i in range(1, arm.n + 1)]))
    return {name: every[name] for name in names if name in every}


def _wide(numbers: Any, columns: int) -> Floats:
    return np.reshape(np.asarray(numbers, dtype=float), (-1, columns) if columns else (0, 0))


def _square(numbers: Any, size: int) -> Floats:
    return _wide(numbers, size) if np.size(numbers) else np.full((size, size), np.nan)


def _unit(unit: str) -> str:
    return "deg" if unit == "rad" else unit


def _number(value: float, unit: str) -> str:
    if unit == "rad":
        return _text(np.degrees(value), ".3f")
    return _text(value, ".5f" if unit in ("kg m^2", "m/s^2") else ".4f")


def _text(value: float, form: str) -> str:
    return f"{value:{form}}" if np.isfinite(value) else "-"
