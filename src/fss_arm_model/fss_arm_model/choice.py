"""Choice of some parameters of an arm, written as words.

A word is a name of fss_arm_model.parameters; `b_i` for the parameter b of each link; `I` for one
value that all links share; `com_0` and `mount` for the base's centre of mass and for the first
joint's pose.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .arrays import Floats
from .parameters import parameter_names

GROUPS = {
    "com_0": ("x_com", "y_com"),
    "mount": ("x_BJ1", "y_BJ1", "theta_BJ1"),
}


@dataclass(frozen=True)
class Choice:
    """Choice of p parameters to estimate; the chosen parameters of the arm are basis @ x."""

    names: tuple[str, ...]
    basis: Floats  # (5 n + 6, p) matrix of 0 and 1

    @classmethod
    def of(cls, words: str, n: int, setting: str = "estimate") -> "Choice":
        """Parse the words of a setting; ValueError: one names nothing, or a parameter twice."""
        every = parameter_names(n)
        names: list[str] = []
        columns: list[Floats] = []
        for word in words.split():
            for name, members in _named_parameters(word, n):
                column = np.isin(every, members).astype(float)
                if not column.any():
                    raise ValueError(
                        f"{setting} has {word!r}, expected words such as b_i I_0, or a name"
                    )
                names.append(name)
                columns.append(column)
        basis = np.array(columns).reshape(-1, len(every)).T
        if not names or (twice := basis.sum(axis=1) > 1.0).any():
            what = ", ".join(np.array(every)[twice]) + " twice" if names else "no parameter"
            raise ValueError(f"{setting} {words!r} names {what}, expected each once")
        return cls(tuple(names), basis)

    def mean(self, every: Floats) -> Floats:
        """Return values of all parameters (5 n + 6,) averaged over those that share one, (p,)."""
        return np.asarray(self.basis.T @ every / self.basis.sum(axis=0))

    @property
    def indices(self) -> npt.NDArray[np.intp]:
        """Indices of the chosen parameters among all parameters."""
        return np.flatnonzero(self.basis.any(axis=1))


def _named_parameters(word: str, n: int) -> list[tuple[str, list[str]]]:
    """Return the values that a word of a choice means: name, and the parameters that share it."""
    every = parameter_names(n)
    if word in GROUPS:
        return [(name, [name]) for name in GROUPS[word]]
    stem = word.removesuffix("_i")
    own = [name for name in every if name.rpartition("_")[0] == stem and name[-2:] != "_0"]
    if word != stem:
        return [(name, [name]) for name in own] or [(word, [])]
    return [(word, [word] if word in every else own)]
