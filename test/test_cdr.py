"""Little-endian CDR against rclpy's serialization, and against damage."""

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Float64, Header, UInt8MultiArray
from tsmcl_ros import cdr
from tsmcl_ros.types import MessageError

TEXTS = st.text(st.characters(exclude_characters='\0', exclude_categories=['Cs']), max_size=20)


def header(seconds, nanoseconds, text):
    writer = cdr.Writer()
    writer.values('iI', seconds, nanoseconds)
    writer.string(text)
    return writer.finish()


@given(st.integers(0, 2**31 - 1), st.integers(0, 10**9 - 1), TEXTS)
def test_what_is_written_is_what_rclpy_reads(seconds, nanoseconds, text):
    found = deserialize_message(header(seconds, nanoseconds, text), Header)
    assert (found.stamp.sec, found.stamp.nanosec, found.frame_id) == (seconds, nanoseconds, text)


@given(st.integers(0, 2**31 - 1), st.integers(0, 10**9 - 1), TEXTS)
def test_what_rclpy_writes_is_read(seconds, nanoseconds, text):
    message = Header(frame_id=text)
    message.stamp.sec, message.stamp.nanosec = seconds, nanoseconds
    reader = cdr.Reader(serialize_message(message))
    assert (*reader.values('iI'), reader.string()) == (seconds, nanoseconds, text)
    reader.finish()


def test_doubles_lie_at_multiples_of_eight_within_the_body():
    assert cdr.Reader(serialize_message(Float64(data=1.5))).values('d') == (1.5,)
    writer = cdr.Writer()
    writer.values('B', 7)
    writer.values('d', 1.5)
    data = writer.finish()
    assert len(data) == len(cdr.HEADER) + 16
    reader = cdr.Reader(data)
    assert (reader.values('B'), reader.values('d')) == ((7,), (1.5,))
    assert reader.padding == list(range(5, 12))


def test_bytes_can_be_passed_over():
    reader = cdr.Reader(serialize_message(UInt8MultiArray(data=[1, 2, 3])))
    assert reader.values('II') == (0, 0)
    size, = reader.values('I')
    start = reader.skip(size)
    reader.finish()
    assert reader.data[start:] == b'\1\2\3'


def test_big_endian_is_refused_by_name():
    with pytest.raises(MessageError, match='big-endian CDR is not supported'):
        cdr.Reader(b'\x00\x00\x00\x00' + bytes(8))


@pytest.mark.parametrize('data', [b'', b'\0', b'\0\1\0', b'\x00\x07\0\0abcd', b'\x02\1\0\0abcd'])
def test_another_encapsulation_is_refused(data):
    with pytest.raises(MessageError, match='not little-endian CDR'):
        cdr.Reader(data)


def test_an_end_too_early_says_how_many_bytes_are_needed():
    whole = header(1, 2, 'map')
    for size in range(len(cdr.HEADER), len(whole)):
        reader = cdr.Reader(whole[:size])
        with pytest.raises(MessageError, match=f'truncated: {size} bytes, must be at least'):
            reader.values('iI')
            reader.string()


def test_a_text_longer_than_the_message_is_truncated():
    writer = cdr.Writer()
    writer.values('I', 2**32 - 1)
    with pytest.raises(MessageError, match='must be at least 4294967303'):
        cdr.Reader(writer.finish()).string()


def test_a_text_that_is_not_utf_8_is_refused():
    reader = cdr.Reader(header(1, 2, 'ab').replace(b'ab', b'\xff\xfe'))
    reader.values('iI')
    with pytest.raises(MessageError, match='text at byte 16 is not UTF-8'):
        reader.string()


@pytest.mark.parametrize('extra', [0, 1, 2, 3])
def test_padding_may_follow_the_last_field(extra):
    reader = cdr.Reader(cdr.HEADER + np.float64(1).tobytes() + bytes(extra))
    reader.values('d')
    reader.finish()


def test_more_than_padding_may_not_follow_the_last_field():
    reader = cdr.Reader(cdr.HEADER + bytes(12))
    reader.values('d')
    with pytest.raises(MessageError, match='4 bytes follow the last field at byte 12'):
        reader.finish()
