"""All nodes that go on by themselves, as `ros2 run` starts them."""

from pathlib import Path

LAWS = Path(__file__).parents[2] / "docs/examples/laws"
NODES = {
    "link_1": ("fss_arm_driver", "link", {"url": "udp://127.0.0.1:9"}),
    "arm": ("fss_arm_driver", "arm", {}),
    "motion": ("fss_arm_motion", "motion", {}),
    "base_reaction": ("fss_arm_view", "base_reaction", {}),
    "workspace": ("fss_arm_workspace", "workspace", {}),
    "kinematic": ("fss_arm_calib", "kinematic", {}),
    "dynamic": ("fss_arm_calib", "dynamic", {}),
    "drift": ("fss_arm_calib", "drift", {}),
    "drives": ("fss_arm_calib", "drives", {}),
    "joint": ("fss_arm_calib", "joint", {}),
    "base": ("fss_base_driver", "base", {"url": "udp://127.0.0.1:9"}),
    "navigation": ("fss_gnc", "navigation", {}),
    "control": ("fss_gnc", "control", {}),
    "controller": ("fss_gnc", "controller", {"law": f"{LAWS}/pd_hold.py:PdHold"}),
    "guidance": ("fss_gnc", "guidance", {}),
    "testbed": ("fss_sim", "testbed", {"ports": [0, 0, 0, 0]}),
}
