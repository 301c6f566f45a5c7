"""What a user of this package can cause and mend."""

from __future__ import annotations

# Longest text of an error, of which the ends say what is wrong and what is allowed.
_LONGEST = 2000


class TsmclError(Exception):
    """
    Root of all errors that a user of this package can cause and mend.

    Parameters
    ----------
    text : str
        What is wrong. Files and messages that it quotes may hold anything: it becomes one line of
        bounded length, in which line breaks are spaces and what else cannot be printed is
        escaped, so that it forges no log.

    """

    def __init__(self, text: str) -> None:
        super().__init__(one_line(text))


def one_line(text: str) -> str:
    """Return a text as one short line, with what cannot be printed escaped."""
    text = _shortened(text)
    if text.isprintable():
        return text
    text = ' '.join(text.splitlines())
    return _shortened(''.join(
        letter if letter.isprintable() else letter.encode('unicode_escape').decode()
        for letter in text))


def _shortened(text: str) -> str:
    """Leave the middle out of a text that is too long."""
    if len(text) <= _LONGEST:
        return text
    return f'{text[:_LONGEST * 3 // 4]} [...] {text[-_LONGEST // 5:]}'


class ConfigError(TsmclError):
    """A parameter has a value that is not allowed, or is not known at all."""


class MessageError(TsmclError):
    """A message is malformed, or says something that cannot be true."""


class BagError(TsmclError):
    """A bag is missing, damaged, already there, or holds nothing of use."""


class LogError(TsmclError):
    """A CSV log or a mobility trace has a bad row; the text names file and line."""
