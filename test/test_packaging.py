"""What setup.py and package.xml say of the package, held against the package."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parent.parent
SETUP = ast.parse((ROOT / 'setup.py').read_text(encoding='utf-8'))
MANIFEST = ElementTree.parse(ROOT / 'package.xml').getroot()


def constant(name: str) -> Any:
    """Return the value that setup.py assigns to a name."""
    for node in SETUP.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name:
            return ast.literal_eval(node.value)
    raise AssertionError(f'setup.py assigns no {name}')


def argument(name: str) -> Any:
    """Return what setup.py passes to setup() by that name."""
    call = SETUP.body[-1]
    assert isinstance(call, ast.Expr)
    assert isinstance(call.value, ast.Call)
    return next(ast.literal_eval(item.value) for item in call.value.keywords if item.arg == name)


def with_main(folder: str) -> set[str]:
    """Return the modules of a folder of the package whose main() needs no argument."""
    return {
        path.stem
        for path in (ROOT / 'tsmcl_ros' / folder).glob('*.py')
        for node in ast.parse(path.read_text(encoding='utf-8')).body
        if isinstance(node, ast.FunctionDef) and node.name == 'main'
        and len(node.args.args) == len(node.args.defaults)
    }


@pytest.mark.parametrize(('name', 'folder'), [('NODES', 'nodes'), ('SCRIPTS', 'scripts')])
def test_that_every_main_is_an_executable_and_every_executable_has_one(
    name: str, folder: str,
) -> None:
    assert set(constant(name)) == with_main(folder)


def test_that_setup_and_manifest_agree() -> None:
    assert argument('version') == MANIFEST.findtext('version')
    assert argument('license') == MANIFEST.findtext('license')
    assert argument('maintainer') == MANIFEST.findtext('maintainer')
