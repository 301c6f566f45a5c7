"""Diagnostics: how components of a system say that they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tsmcl_ros import cdr
from tsmcl_ros.messages.stamps import read_header, write_header

DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'
FINE, WARNING, FAILURE = 0, 1, 2


@dataclass(frozen=True)
class Diagnosis:
    """
    How one component is.

    Attributes
    ----------
    level : int
        FINE, WARNING or FAILURE; others may also say 3, stale.
    name, message, hardware_id : str
        Who says it, what it is in words, and of which piece of hardware.
    values : mapping of str to str
        The numbers behind it.

    """

    level: int
    name: str
    message: str
    hardware_id: str
    values: Mapping[str, str]


def encode_diagnostics(stamp: float, diagnoses: Sequence[Diagnosis]) -> bytes:
    """Return a message with the diagnoses of one moment [s]."""
    writer = cdr.Writer()
    write_header(writer, stamp, '')
    writer.values('I', len(diagnoses))
    for diagnosis in diagnoses:
        writer.values('B', diagnosis.level)
        for text in (diagnosis.name, diagnosis.message, diagnosis.hardware_id):
            writer.string(text)
        writer.values('I', len(diagnosis.values))
        for pair in diagnosis.values.items():
            for text in pair:
                writer.string(text)
    return writer.finish()


def decode_diagnostics(data: bytes) -> tuple[float, list[Diagnosis]]:
    """
    Return the moment [s] and the diagnoses of a message.

    Raises
    ------
    MessageError
        If the bytes are no diagnostics.

    """
    reader = cdr.Reader(data)
    stamp, _ = read_header(reader)
    (count,) = reader.values('I')
    diagnoses = []
    for _ in range(count):
        (level,) = reader.values('B')
        name, message, hardware_id = reader.string(), reader.string(), reader.string()
        (pairs,) = reader.values('I')
        values = {reader.string(): reader.string() for _ in range(pairs)}
        diagnoses.append(Diagnosis(level, name, message, hardware_id, values))
    reader.finish()
    return stamp, diagnoses
