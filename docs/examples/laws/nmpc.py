"""Generate the solver of the NMPC law nmpc.c from a description (pip install casadi).

    python nmpc.py [ARM.yaml]      # writes nmpc_solver.c; by default for the paper's arm

State x: pose of the base, momentum h of base and arm (linear in the world's axes, angular about the
base's origin), joint angles q. Control u: wrench w, joint rates q'. With twist v of the base,

    h = H_b v + H_m q',    h' = (R f, torque - v x h),    w = (f, torque)

where R turns the base's axes into the world's. u is constant over each of STEPS steps. One
Gauss-Newton step a period (Diehl et al. 2005) minimizes errors of pose, twist and angles, wrench
and changes of rates, each divided by its size below, within the bounds of w and q'.
"""

import sys

import casadi as ca
import numpy as np

from fss_arm_model.description import Arm, paper_arm
from fss_arm_model.description_file import load

STEPS, STEP = 10, 0.4  # of the prediction; [s]
MAX_WRENCH, MAX_RATE = (0.3, 0.3, 0.065), 0.3  # [N, N, N m], [rad/s]
POSE_ERROR, TWIST_ERROR = (0.01, 0.01, 0.02), (0.05, 0.05, 0.1)  # [m, m, rad], [m/s, m/s, rad/s]
ANGLE_ERROR, RATE_CHANGE = 0.02, 0.2  # of a joint [rad], [rad/s]
WRENCH = 0.15, 0.15, 0.05  # [N, N, N m]


def momentum_matrix(arm: Arm) -> ca.Function:
    """Return H (3, 3 + n) as a function of pose and angles: momentum per twist and joint rates."""
    pose, q = ca.SX.sym("pose", 3), ca.SX.sym("q", arm.n)
    c, s = ca.cos(pose[2]), ca.sin(pose[2])
    rotation = ca.vertcat(ca.horzcat(c, -s), ca.horzcat(s, c))
    base, angle = arm.base, pose[2] + arm.base.mount[2]
    joint = pose[:2] + rotation @ ca.DM(base.mount[:2])
    bodies = [(base.mass, base.inertia, pose[:2] + rotation @ ca.DM(base.com), pose[2])]
    for i, link in enumerate(arm.links):
        angle += q[i] + link.theta_0
        along = ca.vertcat(ca.cos(angle), ca.sin(angle))
        bodies.append((link.mass, link.inertia, joint + (link.a - link.b) * along, angle))
        joint += link.a * along
    linear, angular, state = 0, 0, ca.vertcat(pose, q)
    for mass, inertia, center, heading in bodies:
        velocity, arm_of = ca.jacobian(center, state), center - pose[:2]
        linear += mass * velocity
        angular += mass * (arm_of[0] * velocity[1, :] - arm_of[1] * velocity[0, :])
        angular += inertia * ca.jacobian(heading, state)
    return ca.Function("momentum", [pose, q], [ca.vertcat(linear, angular)])


def stage(arm: Arm) -> ca.Function:
    """Return one step of the prediction as a function of x and u.

    Its values are the next x, the costed (pose, twist, q) after it, and both derivatives.
    """
    n, momentum = arm.n, momentum_matrix(arm)
    x, u = ca.SX.sym("x", 6 + n), ca.SX.sym("u", 3 + n)

    def twist(x: ca.SX) -> ca.SX:
        matrix = momentum(x[:3], x[6:])
        return ca.solve(matrix[:, :3], x[3:6] - matrix[:, 3:] @ u[3:])

    def rate(x: ca.SX) -> ca.SX:
        v, c, s = twist(x), ca.cos(x[2]), ca.sin(x[2])
        force = c * u[0] - s * u[1], s * u[0] + c * u[1]
        return ca.vertcat(v, *force, u[2] - (v[0] * x[4] - v[1] * x[3]), u[3:])

    after = x + STEP * rate(x + 0.5 * STEP * rate(x))  # midpoint rule
    cost = ca.vertcat(after[:3], twist(after), after[6:])
    both = ca.vertcat(x, u)
    derivatives = ca.jacobian(after, both), ca.jacobian(cost, both)
    return ca.Function("stage", [x, u], [after, cost, *derivatives], {"cse": True})


def solver(arm: Arm) -> ca.Function:
    """Return the controls of all steps (STEPS (3 + n),) as a function of the last ones and more.

    Further arguments: pose and twist of the base, angles and rates of the joints, desired pose and
    twist (6, STEPS), and desired angles (n, STEPS).
    """
    n, step, momentum = arm.n, stage(arm), momentum_matrix(arm)
    size = 3 + n
    last = ca.MX.sym("last", size * STEPS)
    pose, twist = ca.MX.sym("pose", 3), ca.MX.sym("twist", 3)
    desired = ca.MX.sym("desired", 6, STEPS)
    q, rates, angles = ca.MX.sym("q", n), ca.MX.sym("rates", n), ca.MX.sym("angles", n, STEPS)
    x = ca.vertcat(pose, momentum(pose, q) @ ca.vertcat(twist, rates), q)
    sensitivity = ca.DM.zeros(6 + n, size * STEPS)  # of x to all controls
    weights = 1.0 / np.concatenate([POSE_ERROR, TWIST_ERROR, np.full(n, ANGLE_ERROR)])
    residuals, rows, before = [], [], rates
    for k in range(STEPS):
        place = slice(k * size, (k + 1) * size)
        u, select = last[place], ca.DM.zeros(size, size * STEPS)
        select[:, place] = ca.DM.eye(size)
        x, value, by_x, by_cost = step(x, u)
        through = ca.vertcat(sensitivity, select)
        sensitivity, goal = by_x @ through, ca.vertcat(desired[:, k], angles[:, k])
        change = ca.DM(select[3:, :])
        if k:
            change[:, place.start - n : place.start] = -ca.DM.eye(n)
        residuals += [
            weights * (value - goal),
            u[:3] / ca.DM(WRENCH),
            (u[3:] - before) / RATE_CHANGE,
        ]
        rows += [
            ca.diag(weights) @ by_cost @ through,
            ca.diag(1.0 / ca.DM(WRENCH)) @ select[:3, :],
            change / RATE_CHANGE,
        ]
        before = u[3:]
    jacobian, residual = ca.vertcat(*rows), ca.vertcat(*residuals)
    shapes = {"h": ca.Sparsity.dense(size * STEPS, size * STEPS), "a": ca.Sparsity(0, size * STEPS)}
    options = dict.fromkeys(("print_iter", "print_header", "print_info", "error_on_fail"), False)
    qp = ca.conic("qp", "qrqp", shapes, options)
    most = np.tile([*MAX_WRENCH, *np.full(n, MAX_RATE)], STEPS)
    change = qp(h=jacobian.T @ jacobian, g=jacobian.T @ residual, lbx=-most - last, ubx=most - last)
    given = [last, pose, twist, q, rates, desired, angles]
    return ca.Function("nmpc_solver", given, [last + change["x"]])


if __name__ == "__main__":
    solver(load(sys.argv[1]) if sys.argv[1:] else paper_arm()).generate("nmpc_solver.c")
