"""Complete analysis of Section 5 of the paper for one arm, used by `map` and `workspace`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Complexes, Floats
from fss_arm_model.description import Arm
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.settings import at_least, setting
from fss_arm_ros.calibrated import Calibrated
from fss_arm_workspace.manipulability.climb import climb
from fss_arm_workspace.manipulability.map import Map, manipulability_map
from fss_arm_workspace.manipulability.measure import FIXED, FLOATING, jacobian
from fss_arm_workspace.manipulability.search import Best
from fss_arm_workspace.regions.arcs import Region
from fss_arm_workspace.regions.fixed import fixed_workspace, joint_limits
from fss_arm_workspace.regions.virtual import VirtualManipulator
from fss_arm_workspace.straight_path.paths import (
    Paths,
    PathSettings,
    Rules,
    arch,
    straight_paths,
    straight_workspace,
)
from fss_arm_workspace.straight_path.redundancy import BASES
from fss_arm_workspace.uncertainty import boundary_deviation, measure_deviation, radius_deviation

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Analysis:
    """Workspace and manipulability of an arm. Points are complex numbers [m]."""

    arm: Arm
    limits: Floats  # (n, 2) lowest and highest joint readings [rad]
    region: Region  # fixed vehicle workspace, in the base's frame
    boundary: list[tuple[Complexes, Floats]]  # points of its loops, deviations along the normal
    radius: float  # R of Eq. 13 [m]
    radius_deviation: float  # [m]
    reach: tuple[float, float]  # least and greatest distance from the center of mass [m]
    maps: Mapping[str, Map]  # by "fixed" and "floating"; empty for a single link, whose w is 0
    largest_w: Mapping[str, tuple[float, float]]  # w of each map, and its deviation [m^2]


@dataclass(frozen=True)
class AnalysisSettings(PathSettings):
    """Settings of an analysis: what is computed, and with which resolution."""

    cell: float = setting(0.01, "size of the maps' cells", unit="m", check=at_least(0.001))
    directions: int = setting(
        360, "number of straight paths; more are added between unequal ones", check=at_least(8)
    )
    of_true_angle: bool = setting(
        False, "true: joint limits hold for the true angle q + theta_0; false: for the reading q"
    )
    workers: int = setting(1, "number of threads that compute the maps", check=at_least(1))

    def rules(self, base: str) -> Rules:
        """Return the rules of straight paths on one of BASES."""
        return Rules(**{f.name: getattr(self, f.name) for f in fields(PathSettings)}, base=base)


def analyze(
    calibrated: Calibrated,
    settings: AnalysisSettings | None = None,
    progress: Progress = lambda what, share: None,
) -> Analysis:
    """Compute all results that depend on the arm alone.

    Args:
        calibrated: the arm and its covariance.
        settings: settings of the analysis.
        progress: called with the current task and the share done; its exceptions stop the work.

    Raises:
        ValueError: no cell center can be reached.
    """
    s, arm = settings or AnalysisSettings(), calibrated.arm
    limits = joint_limits(arm, of_true_angle=s.of_true_angle)
    progress("boundary", 0.0)
    region, virtual = fixed_workspace(arm, limits), VirtualManipulator(arm)
    maps, kinds = {}, {"fixed": FIXED, "floating": FLOATING}
    for name, kind in kinds.items() if arm.n > 1 else ():

        def report(share: float, name: str = name) -> None:
            progress(f"manipulability, {name} base", share)

        maps[name] = manipulability_map(
            arm, kind, limits, cell=s.cell, workers=s.workers, progress=report
        )
    return Analysis(
        arm=arm,
        limits=limits,
        region=region,
        boundary=boundary_deviation(
            arm, region, calibrated.covariance, of_true_angle=s.of_true_angle
        ),
        radius=virtual.radius,
        radius_deviation=radius_deviation(arm, calibrated.covariance),
        reach=virtual.reach(limits),
        maps=maps,
        largest_w={name: _largest_w(calibrated, s, limits, found) for name, found in maps.items()},
    )


def _largest_w(
    calibrated: Calibrated, settings: AnalysisSettings, limits: Floats, found: Map
) -> tuple[float, float]:
    """Return the largest w of a map, and its standard deviation [m^2]."""
    index = np.unravel_index([np.nanargmax(found.w)], found.w.shape)
    center, best = found.grid.centers[index], Best(found.w[index], found.q[index])
    deviation = measure_deviation(
        calibrated.arm,
        best,
        np.stack([center.real, center.imag], axis=-1),
        limits,
        found.kind,
        calibrated.covariance,
        of_true_angle=settings.of_true_angle,
    )
    return float(best.w[0]), float(deviation[0])


def straight_workspaces(
    arm: Arm,
    start: npt.ArrayLike,
    settings: AnalysisSettings | None = None,
    progress: Progress = lambda what, share: None,
) -> dict[str, Paths]:
    """Compute the straight-path workspaces from a state (3 + n,), by the names of BASES.

    Raises:
        ValueError: the start is invalid.
    """
    s = settings or AnalysisSettings()
    limits = joint_limits(arm, of_true_angle=s.of_true_angle)
    found = {}
    for k, base in enumerate(BASES):
        progress(f"straight paths, {base}", k / len(BASES))
        found[base] = straight_workspace(arm, start, s.rules(base), limits, count=s.directions)
    return found


def load_kernels(arm: Arm) -> None:
    """Load the kernels used above: the first call of a kernel blocks all threads."""
    start = arch(arm)
    limits = start[3:, None] + [-1.0, 1.0]  # these limits and the table below suit any arm
    straight_paths(arm, start, 0.0, Rules(table_corners=(-1e6, -1e6, 1e6, 1e6)), limits)
    tip = tip_in_base(arm.vector(), start[3:])[:2]
    climb(arm.vector(), start[3:], tip, limits, FLOATING, steps=0)
    for kind in (FIXED, FLOATING):
        jacobian(arm, start[3:], kind)
