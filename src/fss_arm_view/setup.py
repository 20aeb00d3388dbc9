from setuptools import setup

setup(
    name="fss_arm_view",
    version="0.1.0",
    packages=["fss_arm_view"],
    package_data={"fss_arm_view": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fss_arm_view"]),
        ("share/fss_arm_view", ["package.xml"]),
    ],
    description="The reaction of the base to the arm, computed and shown live.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "base_reaction = fss_arm_view.base_reaction_node:main",
            "view = fss_arm_view.view_node:main",
        ],
    },
)
