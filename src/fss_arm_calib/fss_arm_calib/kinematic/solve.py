"""Solver for the lengths and angles that fit the observations best (Eq. 4)."""

from itertools import compress

import numpy as np
import numpy.typing as npt

from fss_arm_calib.estimation.least_squares import Minimum, minimize
from fss_arm_calib.kinematic import model
from fss_arm_calib.kinematic.problem import KinematicProblem
from fss_arm_calib.kinematic.result import KinematicResult
from fss_arm_model.arrays import Floats
from fss_arm_model.planar import wrap

#: A parameter is reported if its share in the undetermined directions is larger.
MAX_UNDETERMINED_SHARE = 1e-3

MAX_ITERATIONS = 200


class NotIdentifiable(ValueError):  # noqa: N818
    """Error raised if some parameters are not identifiable; the message names them."""

    def __init__(self, parameters: tuple[str, ...], undetermined: int, condition: float) -> None:
        self.parameters, self.undetermined, self.condition = parameters, undetermined, condition
        super().__init__(
            f"{', '.join(parameters)} cannot be separated ({undetermined} "
            f"combination{'s' * (undetermined > 1)} undetermined, condition number {condition:.3g})"
        )


def solve(
    problem: KinematicProblem,
    tolerance: float = 1e-9,
    max_condition: float = 1e3,
    start: npt.ArrayLike | None = None,
) -> KinematicResult:
    """Fit as `fit` does, and require that all parameters are determined.

    Raises:
        NotIdentifiable: the observations are too few or too similar for all parameters.
    """
    result = fit(problem, tolerance, max_condition, start)
    if result.undetermined:
        raise NotIdentifiable(result.undetermined, result.missing, result.condition_number)
    return result


def fit(
    problem: KinematicProblem,
    tolerance: float = 1e-9,
    max_condition: float = 1e3,
    start: npt.ArrayLike | None = None,
) -> KinematicResult:
    """Iterate Eq. 4 (Gauss-Newton) from several starts and return the solution of lowest cost.

    One start is the guess, with lengths and mount solved linearly for the guessed angles. The
    other start is the closed form. Mirrored solutions are folded back. The result names the
    parameters that are not identifiable.

    Args:
        problem: observations and initial guess.
        tolerance: update below which the iteration has converged, in standard deviations.
        max_condition: condition number of the column-scaled regressor above which parameters
            count as inseparable.
        start: (p,) guess in place of the arm's, which cannot have lengths of zero.
    """
    guess = problem.initial if start is None else np.asarray(start, dtype=float)
    starts = [_linear_start(problem, guess), *_closed_form_start(problem)]
    freedom = max(problem.tip.size - len(guess), 1)
    fits: list[Minimum] = []

    def iterate(xi: Floats) -> Minimum:
        fits.append(
            minimize(
                lambda x: model.linearize(problem, x),
                model.unmirror(problem, xi),
                tolerance=tolerance,
                max_iterations=MAX_ITERATIONS,
                max_condition=max_condition,
            )
        )
        return fits[-1]

    for xi in sorted(starts, key=lambda xi: model.cost(problem, xi)):
        fit = iterate(xi)
        if model.is_mirrored(problem, fit.x):
            fit = iterate(fit.x)
        if fit.converged and fit.cost < freedom + 10.0 * np.sqrt(2.0 * freedom):
            break  # any better minimum would be better only by chance
    best = min(fits, key=lambda fit: (not fit.converged, fit.cost))
    missing = len(best.x) - len(best.basis.s)
    lost = best.basis.undetermined() > MAX_UNDETERMINED_SHARE
    angles = np.array(problem.units) == "rad"
    weights, P = model.weights(problem, best.x), best.basis.covariance()
    G = model.influence(problem, best.x, P)
    return KinematicResult(
        problem=problem,
        values=np.where(angles, wrap(best.x), best.x),
        covariance=P
        + model.repeated_error_covariance(problem, best.x, P)
        + G @ problem.fixed_covariance @ G.T,
        weighted=P,
        residuals=model.residuals(problem, best.x),
        weights=weights,
        chi_square=float(weights @ model.squared_distances(problem, best.x)),
        condition_number=best.basis.condition,
        iterations=best.iterations,
        last_update=best.last_update,
        converged=best.converged,
        undetermined=tuple(compress(problem.names, lost)) if missing else (),
        missing=missing,
    )


def _link_phasors(problem: KinematicProblem) -> npt.NDArray[np.complex128]:
    """Return exp(i Q_i) with Q_i = q_1 + .. + q_i, (s, n)."""
    return np.asarray(np.exp(1j * np.cumsum(problem.q, axis=1)))


def _linear_start(problem: KinematicProblem, xi: Floats) -> Floats:
    """Return a start with the angles of xi and the best lengths and mount for them.

    Lengths and mount that the observations do not determine keep their values in xi.
    """
    n = problem.arm.n
    values = model.all_parameters(problem, xi)
    headings = np.cumsum([values[-2], *values[n : 2 * n - 1]])
    ones = np.ones(len(problem.q))
    columns = np.column_stack([_link_phasors(problem) * np.exp(1j * headings), ones, 1j * ones])
    linear = np.flatnonzero(np.array(problem.units) == "m")
    rows = [*range(n), 2 * n - 1, 2 * n]  # of lengths and mount
    by_linear = columns @ problem.basis[np.ix_(rows, linear)]
    off = problem.tip[:, 0] + 1j * problem.tip[:, 1] - columns @ values[rows]
    stacked = np.concatenate([by_linear.real, by_linear.imag])
    xi = xi.copy()
    xi[linear] += np.linalg.lstsq(stacked, np.concatenate([off.real, off.imag]))[0]
    return xi


def _closed_form_start(problem: KinematicProblem) -> list[Floats]:
    """Return a start from the positions, without a guess; none if they do not suffice.

    With complex numbers as vectors in the plane and Q_i = q_1 + .. + q_i, the end effector is at

        x + i y = m + sum_i z_i exp(i Q_i)
        z_i = a_i exp(i (theta_BJ1 + theta_0_2 + .. + theta_0_i))

    which is linear in the mount m and the z_i. Lengths found as |z_i| are never negative, so this
    start also keeps the iteration from the mirrored arms that fit the positions as well.
    """
    n, turns = problem.arm.n, _link_phasors(problem)
    columns = np.column_stack([np.ones(len(turns)), turns])
    positions = problem.tip[:, 0] + 1j * problem.tip[:, 1]
    z, _, rank, _ = np.linalg.lstsq(columns, positions)
    if rank < n + 1 or not np.all(z[1:]):
        return []
    headings = np.angle(z[1:])
    seen = np.exp(1j * (problem.tip[:, 2] - headings[-1])) / turns[:, -1]
    mount = [z[0].real, z[0].imag, headings[0], np.angle(np.mean(seen))]
    return [
        model.estimated_parameters(
            problem, np.concatenate([np.abs(z[1:]), wrap(np.diff(headings)), mount])
        )
    ]
