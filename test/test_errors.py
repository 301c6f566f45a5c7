"""That every error of the package is read by a test: part of its own words stands in one."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
import re

ROOT = Path(__file__).parent.parent
ERRORS = {'TsmclError', 'ConfigError', 'MessageError', 'BagError', 'LogError', 'Refused'}
LENGTH = 3  # words of a phrase


def texts(tree: ast.AST) -> Iterator[str]:
    """Yield all literal texts, of f-strings what stands between their values."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def words(text: str) -> list[str]:
    """Return a text's words; a pattern's escapes are none."""
    return re.findall('[a-z_]+', re.sub(r'\\[a-zA-Z]', ' ', text).lower())


def phrases(text: str) -> set[str]:
    """Return all runs of a few words, or the whole of a shorter text."""
    found = words(text)
    length = min(LENGTH, len(found))
    return {' '.join(found[at:at + length]) for at in range(len(found) - length + 1)} - {''}


def errors() -> dict[str, set[str]]:
    """Return the phrases of each place in the sources that makes an error, by file and line."""
    places = {}
    for path in sorted((ROOT / 'tsmcl_ros').rglob('*.py')):
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Call) and getattr(node.func, 'id', '') in ERRORS:
                found = set().union(*map(phrases, texts(node)))
                # Those without words of their own pass on another's.
                if found:
                    places[f'{path.relative_to(ROOT)}:{node.lineno}'] = found
    return places


def quoted() -> str:
    """Return the texts in all tests but this one."""
    return ' | '.join(
        ' '.join(words(text)) for path in (ROOT / 'test').rglob('test_*.py')
        if path != Path(__file__) for text in texts(ast.parse(path.read_text(encoding='utf-8'))))


def test_every_error_is_read_by_a_test() -> None:
    places, known = errors(), f' {quoted()} '
    count = Counter(phrase for found in places.values() for phrase in found)
    unread = []
    for place, found in places.items():
        # By what no other error says, where there is something.
        own = {phrase for phrase in found if count[phrase] == 1} or found
        if not any(f' {phrase} ' in known for phrase in own):
            unread.append(f'{place}: {", ".join(sorted(own))}')
    assert len(places) > 150
    assert not unread, '\n'.join(unread)
