"""Diagnostics against rclpy's serialization."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray
from hypothesis import given
from hypothesis import strategies as st
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from tsmcl_ros import messages
from tsmcl_ros.types import MessageError

TEXT = st.text(st.characters(blacklist_characters='\0', blacklist_categories=['Cs']), max_size=20)
DIAGNOSIS = st.builds(
    messages.Diagnosis, st.integers(0, 3), TEXT, TEXT, TEXT,
    st.dictionaries(TEXT, TEXT, max_size=4))


@given(st.lists(DIAGNOSIS, max_size=4))
def test_diagnostics_are_what_rclpy_reads(diagnoses):
    found = deserialize_message(messages.encode_diagnostics(12.5, diagnoses), DiagnosticArray)
    assert (found.header.stamp.sec, found.header.stamp.nanosec) == (12, 500_000_000)
    assert [(ord(item.level), item.name, item.message, item.hardware_id,
             {pair.key: pair.value for pair in item.values}) for item in found.status] == [
        (item.level, item.name, item.message, item.hardware_id, item.values)
        for item in diagnoses]


@given(st.lists(DIAGNOSIS, max_size=4))
def test_what_rclpy_writes_is_read(diagnoses):
    data = messages.encode_diagnostics(12.5, diagnoses)
    again = serialize_message(deserialize_message(data, DiagnosticArray))
    assert messages.decode_diagnostics(again) == (12.5, diagnoses)


def test_diagnostics_that_end_early_are_refused():
    data = messages.encode_diagnostics(1.0, [messages.Diagnosis(0, 'a', 'b', 'c', {'d': 'e'})])
    for size in range(len(data)):
        with pytest.raises(MessageError):
            messages.decode_diagnostics(data[:size])
