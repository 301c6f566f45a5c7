"""Packaging of tsmcl_ros, for pip as for colcon (ament_python)."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = 'tsmcl_ros'

NODES = ('anchor', 'fleet', 'localizer', 'recorder', 'replay', 'simulator')
SCRIPTS = ('demo', 'evaluate', 'experiment', 'fit_path_loss', 'import_csv', 'localize_bag')

# The lower bounds are what Jazzy's own platform, Ubuntu 24.04, ships or what came out in its time;
# test/oldest.txt pins them and `make test-oldest` runs the suite there.
REQUIRED = [
    'PyYAML>=6.0.1,<7',
    'lz4>=4.0.2,<5',
    'numpy>=1.26,<3',
    'rosbags>=0.11.7,<0.12',
    # What rosbags reads and writes YAML by; without it to open a bag of a fleet takes seconds.
    'ruamel.yaml.clib>=0.2.8,<0.3',
    'scipy>=1.11,<2',
    'tqdm>=4.66,<5',
]
# Dask numbers its versions by date.
DASK = ['distributed>=2024.2.1,<2027']
EXTRAS = {
    # Not for where a ROS installation is sourced: that one is used.
    'ros': [
        'ros-common-interfaces>=5.3.6,<5.4',
        'ros-rclpy[fastrtps]>=7.1.6,<7.2',
        'ros-std-srvs>=5.3.6,<5.4',
    ],
    'dask': DASK,
    'plot': ['matplotlib>=3.6,<4'],
    'test': [
        *DASK,
        'evo>=1.30,<2',
        'hypothesis>=6.98,<7',
        'mcap>=1.1,<2',
        'mcap-ros2-support>=0.5.3,<0.7',
        'pytest>=7.4',
        'pytest-timeout>=2.2',
        'pytest-xdist>=3.5',
    ],
    # What `make bench` holds the filters against.
    # `particles` itself comes without its dependencies: it wants numpy < 2, and runs with 2.
    'bench': [
        'filterpy>=1.4.5,<3',
        'joblib>=1.3',
        'numba>=0.61',
        'pfilter>=0.2.5,<0.3',
        'scikit-learn>=1.4',
        'stonesoup>=1.4,<2',
    ],
    'check': [
        'coverage>=7.10',  # the first that follows subprocesses by itself
        'mypy>=1.18',
        'pytest-cov>=7',
        'ruff>=0.13',
    ],
}


def share(folder: str, pattern: str = '*') -> list[tuple[str, list[str]]]:
    """Return the data_files that put a folder's files, at any depth, below share/tsmcl_ros."""
    placed: dict[str, list[str]] = {}
    for path in sorted(Path(folder).rglob(pattern)):
        if path.is_file():
            placed.setdefault(f'share/{NAME}/{path.parent.as_posix()}', []).append(str(path))
    return list(placed.items())


setup(
    name=NAME,
    version='0.1.0',
    description='Tabu-search Monte Carlo localization of vehicles from radio beacons, on ROS 2',
    license='Apache-2.0',
    maintainer='The tsmcl_ros developers',
    maintainer_email='tsmcl_ros@example.org',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={NAME: ['py.typed', 'nodes/fastdds.xml']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        *share('bags'),
        *share('config', '*.yaml'),
        *share('examples', '*.py'),
    ],
    zip_safe=False,
    python_requires='>=3.11',
    install_requires=REQUIRED,
    extras_require=EXTRAS,
    entry_points={
        'console_scripts': [
            *(f'{name} = {NAME}.nodes.{name}:main' for name in NODES),
            *(f'{name} = {NAME}.scripts.{name}:main' for name in SCRIPTS),
        ],
    },
)
