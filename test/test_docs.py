"""What is written about the package, held against the package."""

from __future__ import annotations

import ast
import importlib.util
from pathlib import Path
import re

import pytest
from tsmcl_ros.config import build, load_yaml, parameters, refuse_unknown
from tsmcl_ros.methods import METHODS
from tsmcl_ros.nodes.localizer import LocalizerNode
from tsmcl_ros.world import MOBILITY

ROOT = Path(__file__).resolve().parent.parent
PAGES = {str(path.relative_to(ROOT)): path for path in sorted(
    [*ROOT.glob('*.md'), *ROOT.glob('docs/**/*.md'), *ROOT.glob('bags/*.md')])}


def slug(title: str) -> str:
    """Return the anchor that GitHub gives a heading."""
    return re.sub(r'[^\w\- ]', '', title.strip().lower()).replace(' ', '-')


def test_the_parameters_are_written_as_the_sources_have_them() -> None:
    spec = importlib.util.spec_from_file_location('document', ROOT / 'tools' / 'document.py')
    document = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(document)
    assert PAGES['docs/parameters.md'].read_text() == document.document(), \
        'docs/parameters.md is out of date, run python tools/document.py'


@pytest.mark.parametrize('page', PAGES)
def test_links_lead_somewhere(page) -> None:
    path = PAGES[page]
    for link in re.findall(r'\]\(([^)\s]+)\)', path.read_text()):
        if link.startswith(('http://', 'https://')):
            continue
        file, _, anchor = link.partition('#')
        target = path.parent / file if file else path
        assert target.exists(), link
        if anchor:
            titles = re.findall(r'^#+ (.*)$', target.read_text(), re.MULTILINE)
            assert anchor in map(slug, titles), link


@pytest.mark.parametrize('method', METHODS)
def test_every_method_has_a_page_that_names_its_parameters_and_source(method) -> None:
    text = PAGES[f'docs/methods/{method}.md'].read_text()
    common = {item for other, kind in METHODS.items() if other != method
              for item in parameters(kind.Config)}
    for item in set(parameters(METHODS[method].Config)) - common:
        assert f'`{item.name}`' in text or f'`{item.name}:' in text, item.name
    for part in ('Source', 'What it does', 'When', 'Parameters', 'Cost', 'Measured'):
        assert f'**{part}.**' in text


def test_the_index_of_methods_holds_them_all() -> None:
    text = PAGES['docs/methods/README.md'].read_text()
    for method in METHODS:
        assert f'[{method}]({method}.md)' in text


def said() -> list[str]:
    """Return the constant texts of all sources, those of f-strings in their pieces."""
    return [
        node.value
        for path in (ROOT / 'tsmcl_ros').rglob('*.py')
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]


def test_messages_in_the_troubleshooting_are_those_of_the_sources() -> None:
    text = PAGES['docs/troubleshooting.md'].read_text()
    quoted = [line for block in re.findall(r'```text\n(.*?)```', text, re.DOTALL)
              for line in block.splitlines()]
    table = text.partition('| the reason |')[2].partition('\n\n')[0]
    quoted += re.findall(r'^\| `(.*?)` \|', table, re.MULTILINE)
    assert len(quoted) > 25
    sources = said()
    for line in quoted:
        for piece in re.split(r'<.*?>', line):
            assert any(piece in text for text in sources), line


def test_parameters_that_users_of_amcl_are_sent_to_exist() -> None:
    known = {item.name for config in LocalizerNode.configs for item in parameters(config)}
    text = PAGES['docs/amcl.md'].read_text()
    rows = re.findall(r'^\| `.*?` \| (.*?) \|', text.partition('## Topics')[0], re.MULTILINE)
    names = {name for row in rows for name in re.findall('`(.*?)`', row)}
    assert len(rows) > 30
    assert names - {'use_sim_time'} <= known


def test_the_example_for_users_of_amcl_is_one_that_the_localizer_takes(tmp_path) -> None:
    path = tmp_path / 'localizer.yaml'
    example = PAGES['docs/amcl.md'].read_text().rpartition('```yaml\n')[2].partition('```')[0]
    path.write_text(example)
    values = load_yaml(path, 'localizer')
    refuse_unknown(values, LocalizerNode.configs, str(path))
    for config in LocalizerNode.configs:
        build(config, values)


def test_the_table_of_who_imports_what_names_every_part() -> None:
    parts = {path.stem for path in (ROOT / 'tsmcl_ros').iterdir() if path.suffix == '.py'
             or (path / '__init__.py').exists()} - {'__init__'}
    table = PAGES['CONTRIBUTING.md'].read_text().partition('| part |')[2].partition('\n\n')[0]
    named = {name.strip('/') for row in re.findall(r'^\| (.*?) \|', table, re.MULTILINE)
             for name in re.findall('`(.*?)`', row)}
    assert named == parts


def test_every_mobility_stands_on_its_page() -> None:
    text = PAGES['docs/mobility.md'].read_text()
    for name in MOBILITY:
        assert f'| `{name}` |' in text
