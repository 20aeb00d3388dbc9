from setuptools import find_packages, setup

setup(
    name="fss_arm_model",
    version="0.2.0",
    packages=find_packages(),
    package_data={"fss_arm_model": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fss_arm_model"]),
        ("share/fss_arm_model", ["package.xml"]),
        ("share/fss_arm_model/config", ["config/arm.yaml", "config/cad.yaml", "config/truth.yaml"]),
    ],
    description="The arm and its floating base as mathematics: kinematics, dynamics, momentum.",
    url="https://fss-arm.example.org",
    maintainer="FSS Arm maintainers",
    maintainer_email="fss-arm@example.org",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
)
