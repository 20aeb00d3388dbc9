from setuptools import find_packages, setup

setup(
    name="fss_arm_view",
    version="0.2.0",
    packages=find_packages(),
    package_data={"fss_arm_view": ["py.typed", "web/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fss_arm_view"]),
        ("share/fss_arm_view", ["package.xml"]),
    ],
    description="The reaction of the base to the arm, computed and shown live.",
    url="https://fss-arm.example.org",
    maintainer="FSS Arm maintainers",
    maintainer_email="fss-arm@example.org",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "base_reaction = fss_arm_view.programs:base_reaction",
            "view = fss_arm_view.programs:view",
        ],
    },
)
