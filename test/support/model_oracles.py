"""The floating arm in Pinocchio and in MuJoCo."""

import mujoco
import numpy as np
import pinocchio as pin

from fss_arm_model.description import Arm
from fss_sim.plant.joints import Joints


def pinocchio_model(arm: Arm) -> pin.Model:
    model = pin.Model()
    model.gravity.setZero()
    joint = 0
    for slide in (pin.JointModelPX(), pin.JointModelPY()):
        joint = model.addJoint(joint, slide, pin.SE3.Identity(), "")
    place, body = pin.SE3.Identity(), (arm.base.mass, arm.base.inertia, *arm.base.com)
    x, y, turn = arm.base.mount
    for link in arm.links:
        joint = add_body(model, joint, place, body)
        place = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, turn + link.theta_0), np.array([x, y, 0.0]))
        body = (link.mass, link.inertia, link.g, link.lateral)
        x, y, turn = link.a, 0.0, 0.0
    joint = add_body(model, joint, place, body)
    tip = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, arm.theta_E), np.array([x, 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", joint, 0, tip, pin.FrameType.OP_FRAME))
    return model


def add_body(model, parent, place, body):
    mass, inertia, x, y = body
    joint = model.addJoint(parent, pin.JointModelRZ(), place, "")
    about_com = pin.Inertia(mass, np.array([x, y, 0.0]), np.eye(3) * inertia)
    model.appendBodyToJoint(joint, about_com, pin.SE3.Identity())
    return joint


def pinocchio_inertia(model: pin.Model, data: pin.Data, q: np.ndarray) -> np.ndarray:
    """Inertia matrix, of which Pinocchio computes the upper triangle."""
    upper = np.triu(pin.crba(model, data, q))
    return upper + np.triu(upper, 1).T


def pinocchio_tip_jacobian(arm: Arm, q: np.ndarray, floating: bool) -> np.ndarray:
    """Jacobian (3, n) from joint rates to the tip's twist, of a base that is held or floats."""
    model, state = pinocchio_model(arm), np.concatenate([np.zeros(3), q])
    data, tip = model.createData(), model.getFrameId("tip")
    J = pin.computeFrameJacobian(model, data, state, tip, pin.LOCAL_WORLD_ALIGNED)[[0, 1, 5]]
    if not floating:
        return J[:, 3:]
    H = pinocchio_inertia(model, data, state)
    return J[:, 3:] - J[:, :3] @ np.linalg.solve(H[:3, :3], H[:3, 3:])


def mujoco_model(arm: Arm, joints: Joints | None = None) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(mujoco_xml(arm, joints))


def mujoco_xml(arm: Arm, joints: Joints | None = None) -> str:
    """The arm; with joints that give, motors turn their ratio as fast, each a body of its own.

    A motor m_i is tied to its joint q_i by a tendon, which is the gear's spring and damper. What
    the arm's description has of a rotor's inertia, as part of the body that carries it, is the
    rotor's then.
    """
    rotor = joints.rotor_inertia / joints.gear_ratio**2 if joints else 0.0

    def body(name, place, joint, mass, inertia, x, y, inner):
        return (
            f'<body name="{name}" {place}>{joint}<inertial pos="{x!r} {y!r} 0" mass="{mass!r}" '
            f'diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>{inner}</body>'
        )

    def hinge(name):
        return f'<joint name="{name}" type="hinge" axis="0 0 1"/>'

    inner, tendons = "", ""
    for i in reversed(range(arm.n)):
        link, name = arm.links[i], f"q_{i + 1}"
        x, y, turn = arm.base.mount if i == 0 else (arm.links[i - 1].a, 0.0, 0.0)
        place = f'pos="{x!r} {y!r} 0" euler="0 0 {turn + link.theta_0!r}"'
        inertia = link.inertia - (rotor if i < arm.n - 1 else 0.0)
        shape = link.mass, inertia, link.g, link.lateral
        inner = body(f"link_{i + 1}", place, hinge(name), *shape, inner)
        if joints:
            motor, half = f"m_{i + 1}", 0.5 * joints.dead_band
            place = f'pos="{x!r} {y!r} 0"'
            inner += body(f"motor_{i + 1}", place, hinge(motor), 1e-9, rotor, 0.0, 0.0, "")
            tendons += (
                f'<fixed stiffness="{joints.stiffness!r}" damping="{joints.damping!r}" '
                f'springlength="{-half!r} {half!r}"><joint joint="{name}" coef="1"/>'
                f'<joint joint="{motor}" coef="{-1.0 / joints.gear_ratio!r}"/></fixed>'
            )
    slides = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
    own = arm.base.mass, arm.base.inertia - rotor, *arm.base.com
    base = body("base", "", slides + hinge("theta"), *own, inner)
    return (
        '<mujoco><compiler angle="radian"/><option gravity="0 0 0"/>'
        f"<worldbody>{base}</worldbody><tendon>{tendons}</tendon></mujoco>"
    )


def mujoco_index(model: mujoco.MjModel, letter: str, n: int) -> list[int]:
    """Where the angles of joints ("q") or motors ("m") stand."""
    return [model.joint(f"{letter}_{i}").id for i in range(1, n + 1)]
