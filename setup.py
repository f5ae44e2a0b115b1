"""Build of the ament_python package; the version stands in flatsat_ros/_version.py."""

from pathlib import Path

from setuptools import find_packages, setup

from flatsat_ros._version import __version__

PACKAGE = "flatsat_ros"
SHARE = Path("share", PACKAGE)


def configuration() -> list[tuple[str, list[str]]]:
    """Every folder under config/ with its YAML and RViz files, as setuptools wants data_files."""
    files = sorted(file for kind in ("yaml", "rviz") for file in Path("config").rglob(f"*.{kind}"))
    folders = sorted({file.parent for file in files})
    return [(str(SHARE / folder), [str(file) for file in files if file.parent == folder]) for folder in folders]


setup(
    name=PACKAGE,
    version=__version__,
    description="Certified saturated control of quadcopters in the flat output space, over ROS 2",
    maintainer="flatsat_ros developers",
    maintainer_email="developers@flatsat-ros.example.org",
    license="Apache-2.0",
    packages=find_packages(exclude=["test", "test.*"]),
    package_data={PACKAGE: ["py.typed", "viewing/page/*", "viewing/page/vendor/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (str(SHARE), ["package.xml"]),
        *configuration(),
        (str(SHARE / "launch"), sorted(map(str, Path("launch").glob("*.launch.py")))),
    ],
    python_requires=">=3.10",
    # rclpy and the messages come from a sourced ROS 2 or from requirements/requirements.txt.
    install_requires=["numpy", "pyyaml", "scipy", "cvxpy", "clarabel", "matplotlib", "tqdm", "rosbags"],
    extras_require={
        "crazyflie": ["cflib>=0.1.34,<0.2"],  # GPL: only cflib_bridge imports it
        "test": ["hypothesis", "pytest", "pytest-timeout", "pytest-xdist"],
    },
    zip_safe=False,  # the configuration is found beside the package, as files
    entry_points={
        "console_scripts": [
            "controller = flatsat_ros.nodes.programs:controller",
            "cflib_bridge = flatsat_ros.nodes.programs:cflib_bridge",
            "console = flatsat_ros.nodes.programs:console",
            "sim_drone = flatsat_ros.nodes.programs:sim_drone",
            "sim_server = flatsat_ros.nodes.programs:sim_server",
            "mocap_player = flatsat_ros.nodes.programs:mocap_player",
            "record = flatsat_ros.nodes.programs:record",
            "plan = flatsat_ros.cli.plan:main",
            "synthesize = flatsat_ros.cli.synthesize:main",
            "demo = flatsat_ros.cli.demo:main",
            "excitation = flatsat_ros.cli.excitation:main",
            "identify = flatsat_ros.cli.identify:main",
            "reproduce = flatsat_ros.cli.reproduce:main",
            "falsify = flatsat_ros.cli.falsify:main",
            "faults = flatsat_ros.cli.faults:main",
            "soak = flatsat_ros.cli.soak:main",
            "report = flatsat_ros.cli.report:main",
            "validate = flatsat_ros.cli.validate:main",
        ],
    },
)
