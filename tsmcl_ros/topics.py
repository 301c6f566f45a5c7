"""Topics by name and pattern, as parameters and command lines name them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import re
import warnings

from tsmcl_ros.types import ConfigError


def compiled(parameter: str, patterns: Iterable[str]) -> list[re.Pattern[str]]:
    """
    Return the regular expressions that topics are named by.

    Raises
    ------
    ConfigError
        Naming the parameter, if one is none.

    """
    expressions = []
    for pattern in patterns:
        try:
            with warnings.catch_warnings():
                # Of what future versions of Python may take patterns for.
                warnings.simplefilter('ignore', FutureWarning)
                expressions.append(re.compile(pattern))
        except (re.error, OverflowError, RecursionError) as error:
            raise ConfigError(
                f'{parameter}: {pattern!r} is not allowed, must be a topic or a regular '
                f'expression: {error}'
            ) from None
    return expressions


def match_topic(pattern: re.Pattern[str], topic: str, namespace: str) -> re.Match[str] | None:
    """Match a whole topic, or all of it that follows the namespace."""
    home = namespace.rstrip('/') + '/'
    return pattern.fullmatch(topic) or (
        pattern.fullmatch(topic, len(home)) if topic.startswith(home) else None)


def absolute(topic: str, namespace: str) -> str:
    """Return the topic's name from the root."""
    return topic if topic.startswith('/') else f'{namespace.rstrip("/")}/{topic}'


def of_kinds(topics: Mapping[str, str], kinds: Iterable[str]) -> list[str]:
    """Return the topics of some types."""
    return sorted(topic for topic, kind in topics.items() if kind in set(kinds))


def few(names: Sequence[str], most: int = 6) -> str:
    """Name a few, and how many more there are."""
    shown = ', '.join(names[:most]) or 'none'
    return shown if len(names) <= most else f'{shown} and {len(names) - most} more'
