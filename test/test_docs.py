"""What is written about the package, held against the package."""

from __future__ import annotations

import importlib.util
from pathlib import Path
import re

import pytest

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
