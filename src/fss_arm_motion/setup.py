from setuptools import find_packages, setup

setup(
    name="fss_arm_motion",
    version="0.2.0",
    packages=find_packages(),
    package_data={"fss_arm_motion": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fss_arm_motion"]),
        ("share/fss_arm_motion", ["package.xml"]),
    ],
    description="Planned motion of the arm on a floating base, and the guard that keeps it clear.",
    url="https://fss-arm.example.org",
    maintainer="FSS Arm maintainers",
    maintainer_email="fss-arm@example.org",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "motion = fss_arm_motion.programs:motion",
            "plan = fss_arm_motion.plan_command:main",
        ],
    },
)
