from setuptools import setup

setup(
    name="fss_arm_model",
    version="0.1.0",
    packages=["fss_arm_model"],
    package_data={"fss_arm_model": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fss_arm_model"]),
        ("share/fss_arm_model", ["package.xml"]),
    ],
    description="The arm and its floating base as mathematics.",
    license="Apache-2.0",
)
