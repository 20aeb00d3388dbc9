"""The floating arm in Pinocchio and in MuJoCo."""

import mujoco
import numpy as np
import pinocchio as pin

from fss_arm_model.description import Arm


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


def mujoco_model(arm: Arm, link_radius: float = 0.0, others: str = "") -> mujoco.MjModel:
    """The arm, its links as capsules if they have a radius, and other bodies."""

    def body(name, place, joints, mass, inertia, x, y, inner):
        return (
            f'<body name="{name}" {place}>{joints}<inertial pos="{x!r} {y!r} 0" mass="{mass!r}" '
            f'diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>{inner}</body>'
        )

    hinge = '<joint type="hinge" axis="0 0 1"/>'
    inner = ""
    for i in reversed(range(arm.n)):
        link = arm.links[i]
        x, y, turn = arm.base.mount if i == 0 else (arm.links[i - 1].a, 0.0, 0.0)
        place = f'pos="{x!r} {y!r} 0" euler="0 0 {turn + link.theta_0!r}"'
        if link_radius:
            inner += (
                f'<geom type="capsule" fromto="0 0 0 {link.a!r} 0 0" size="{link_radius!r}" '
                'contype="1" conaffinity="2"/>'
            )
        inner = body(
            f"link_{i + 1}", place, hinge, link.mass, link.inertia, link.g, link.lateral, inner
        )
    slides = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
    base = body("base", "", slides + hinge, arm.base.mass, arm.base.inertia, *arm.base.com, inner)
    return mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian"/><option gravity="0 0 0"/>'
        f"<worldbody>{base}{others}</worldbody></mujoco>"
    )
