"""The direction of imports, read from the sources without importing them."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
import subprocess
import sys
from xml.etree import ElementTree

import pytest

PACKAGE = Path(__file__).resolve().parent.parent / 'tsmcl_ros'

# What each part of the package may import from it, besides itself ...
BASE = {'types', 'config'}
MODEL = BASE | {'model'}
WORLD = MODEL | {'traces', 'world'}
LOCALIZER = MODEL | {'methods', 'localizer'}
RECORDS = {'types', 'topics', 'cdr', 'messages', 'gathering', 'bag', 'csv_log', 'repair'}
LOWER = WORLD | LOCALIZER | RECORDS | {'inputs', 'endpoint', 'diagnosis'}
OWN = {
    'types': set(),
    'config': {'types'},
    'topics': {'types'},
    'cdr': {'types'},
    'messages': {'types', 'cdr'},
    'gathering': {'types'},
    'storage': set(),
    'bag_checks': {'types'},
    'bag': {'types', 'storage', 'bag_checks'},
    'repair': {'types', 'storage', 'bag'},
    'csv_log': {'types', 'messages', 'gathering'},
    'model': BASE,
    'methods': MODEL,
    'localizer': LOCALIZER,
    'traces': MODEL,
    'world': WORLD,
    'inputs': LOCALIZER | RECORDS,
    'endpoint': LOCALIZER | RECORDS | {'inputs'},
    'diagnosis': LOCALIZER | RECORDS,
    'evaluation': LOWER,
    'nodes': LOWER | {'evaluation', 'scripts'},
    'scripts': LOWER | {'evaluation', 'nodes'},
}
# ... and from elsewhere, besides the standard library. A longer line precedes its part's.
ROS = {
    'ament_index_python', 'builtin_interfaces', 'diagnostic_msgs', 'geometry_msgs',
    'lifecycle_msgs', 'nav_msgs', 'rcl_interfaces', 'rclpy', 'rosgraph_msgs', 'sensor_msgs',
    'std_msgs', 'std_srvs', 'tf2_ros', 'visualization_msgs',
}
OTHERS = {
    'types': {'numpy'},
    'config': {'yaml'},
    'topics': set(),
    'cdr': {'numpy'},
    'messages': {'numpy'},
    'gathering': {'numpy'},
    'storage': {'rosbags'},
    'bag_checks': {'lz4', 'rosbags', 'yaml'},
    'bag': {'numpy', 'rosbags'},
    'repair': {'rosbags'},
    'csv_log': {'numpy'},
    'model': {'numpy', 'scipy'},
    'methods': {'numpy'},
    'methods.grid': {'numpy', 'scipy'},  # its convolution
    'localizer': {'numpy'},
    'traces': {'numpy'},
    'world': {'numpy', 'scipy'},
    'inputs': {'numpy'},
    'endpoint': {'numpy'},
    'diagnosis': {'numpy'},
    'evaluation': {'numpy', 'scipy', 'yaml'},
    'evaluation.plots': {'numpy', 'matplotlib'},
    'evaluation.pools': {'distributed'},
    'nodes': {'numpy', 'yaml', *ROS},
    'scripts': {'numpy'},
    'scripts.cli': {'tqdm'},
}
MODULES = {
    '.'.join(path.relative_to(PACKAGE).with_suffix('').parts): path
    for path in sorted(PACKAGE.rglob('*.py'))
}


def imports(path: Path) -> Iterator[str]:
    """Yield the dotted name of all that a module imports, in functions and for types as well."""
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f'{path}:{node.lineno}: a relative import'
            yield from (f'{node.module}.{alias.name}' for alias in node.names)


def own_imports(path: Path) -> Iterator[list[str]]:
    """Yield what a module imports from the package, split: ['model', 'radio', 'Channel']."""
    for name in imports(path):
        root, *rest = name.split('.')
        if root == 'tsmcl_ros':
            yield rest


def test_that_every_part_has_its_place() -> None:
    parts = {name.partition('.')[0] for name in MODULES} - {'__init__'}
    assert parts <= OWN.keys() == {name for name in OTHERS if '.' not in name}


@pytest.mark.parametrize('module', MODULES)
def test_that_imports_from_the_package_go_down(module: str) -> None:
    part = module.partition('.')[0]
    used = {name[0] for name in own_imports(MODULES[module])} - {part}
    assert used <= OWN.get(part, set())


@pytest.mark.parametrize('module', MODULES)
def test_that_libraries_are_imported_only_where_they_belong(module: str) -> None:
    lines = [line for line in OTHERS if f'{module}.'.startswith(f'{line}.')]
    allowed = OTHERS[max(lines, key=len)] if lines else set()
    used = {name.partition('.')[0] for name in imports(MODULES[module])}
    assert used - sys.stdlib_module_names - {'tsmcl_ros'} <= allowed


METHODS = [name for name in MODULES if name.startswith('methods.') and '__init__' not in name]


@pytest.mark.parametrize('module', METHODS)
def test_that_methods_do_not_import_each_other(module: str) -> None:
    assert 'methods' not in {name[0] for name in own_imports(MODULES[module])}


def test_that_a_fleet_starts_without_loading_what_its_method_may_never_ask_for() -> None:
    program = ('import sys, tsmcl_ros.nodes.fleet\n'
               'print(*sorted(name for name in sys.modules if name.startswith("scipy.special")))')
    ran = subprocess.run([sys.executable, '-c', program], check=True, capture_output=True)
    assert ran.stdout.split() == []


def test_that_rosdep_or_who_reads_its_manifest_is_told_of_every_library() -> None:
    path = PACKAGE.parent / 'package.xml'
    manifest, text = ElementTree.parse(path), path.read_text(encoding='utf-8')
    keys = {element.text for element in manifest.iter('exec_depend')}
    used = {name.partition('.')[0] for path in MODULES.values() for name in imports(path)}
    for name in used - sys.stdlib_module_names - {'tsmcl_ros'}:
        assert (keys & {name, f'python3-{name}', f'python3-{name}-pip'}
                or f"pip install '{name}" in text), name
