"""Arms and states to test the model with."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from fss_arm_model.description import Arm, Base, Link, paper_arm
from fss_arm_model.description_file import save


def random_arm(n: int, rng: np.random.Generator) -> Arm:
    """n unlike links with lateral offsets, on a base whose centre of mass is off its origin."""

    def link(theta_0: float) -> Link:
        a, b, lateral = rng.uniform(0.2, 0.6), rng.uniform(-0.1, 0.4), rng.uniform(-0.1, 0.1)
        mass, inertia = rng.uniform(0.5, 5.0), rng.uniform(0.005, 0.1)
        return Link(a=a, theta_0=theta_0, mass=mass, inertia=inertia, b=b, lateral=lateral)

    base = Base(
        mass=rng.uniform(5.0, 20.0),
        inertia=rng.uniform(0.1, 0.5),
        com=tuple(rng.uniform(-0.1, 0.1, 2)),
        mount=(*rng.uniform(-0.3, 0.3, 2), rng.uniform(-math.pi, math.pi)),
    )
    links = (link(0.0), *(link(rng.uniform(-0.3, 0.3)) for _ in range(n - 1)))
    return Arm(name=f"{n} links", base=base, links=links, theta_E=rng.uniform(-0.5, 0.5))


def short_arm(count: int, folder: Path) -> Path:
    """Save the paper's arm with only its first links; return the file."""
    save(replace(paper_arm(), links=paper_arm().links[:count]), folder / "arm.yaml")
    return folder / "arm.yaml"


def random_states(n: int, count: int, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Coordinates, their rates and generalized forces, each (count, 3 + n)."""
    q = rng.uniform(-math.pi, math.pi, (count, 3 + n))
    return q, rng.uniform(-3.0, 3.0, (count, 3 + n)), rng.uniform(-2.0, 2.0, (count, 3 + n))
