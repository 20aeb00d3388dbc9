from setuptools import find_packages, setup

setup(
    name="fss_arm_calib",
    version="0.2.0",
    packages=find_packages(),
    package_data={"fss_arm_calib": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fss_arm_calib"]),
        ("share/fss_arm_calib", ["package.xml"]),
    ],
    description="Calibration of the arm's parameters, live and from bags.",
    url="https://fss-arm.example.org",
    maintainer="FSS Arm maintainers",
    maintainer_email="fss-arm@example.org",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "kinematic = fss_arm_calib.programs:kinematic",
            "design = fss_arm_calib.experiment.design_command:main",
            "drift = fss_arm_calib.programs:drift",
            "drives = fss_arm_calib.programs:drives",
            "dynamic = fss_arm_calib.programs:dynamic",
            "experiment = fss_arm_calib.programs:experiment",
            "from_bag = fss_arm_calib.from_bag:main",
            "joint = fss_arm_calib.programs:joint",
            "links = fss_arm_calib.links:main",
            "recompute = fss_arm_calib.programs:recompute",
        ],
    },
)
