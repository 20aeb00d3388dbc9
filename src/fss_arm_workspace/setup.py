from setuptools import find_packages, setup

setup(
    name="fss_arm_workspace",
    version="0.2.0",
    packages=find_packages(),
    package_data={"fss_arm_workspace": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fss_arm_workspace"]),
        ("share/fss_arm_workspace", ["package.xml"]),
    ],
    description="Workspace and manipulability of the arm on a fixed and on a floating base.",
    url="https://fss-arm.example.org",
    maintainer="FSS Arm maintainers",
    maintainer_email="fss-arm@example.org",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "workspace = fss_arm_workspace.programs:workspace",
            "map = fss_arm_workspace.programs:workspace_map",
        ],
    },
)
