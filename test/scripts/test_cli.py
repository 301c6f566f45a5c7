"""How scripts end."""

import argparse
import signal
import subprocess
import sys
import time

import pytest
from tsmcl_ros.bag import Reader
from tsmcl_ros.scripts.cli import a_number, a_whole_number, run_script
from tsmcl_ros.types import BagError, ConfigError

RECORDING = """
import sys, time
from tsmcl_ros import messages
from tsmcl_ros.bag import Writer
from tsmcl_ros.scripts.cli import a_number, a_whole_number, run_script

def record(arguments):
    with Writer(arguments[0]) as bag:
        bag.topic('/clock', messages.CLOCK)
        for stamp in range(10**9):
            bag.write('/clock', stamp, messages.encode_clock(stamp))
            if stamp == 1000:
                print('recording', flush=True)

sys.exit(run_script(record, sys.argv[1:]))
"""


def test_numbers_of_options_are_read():
    assert a_number(0, unit='s')('0') == 0
    assert a_number()('-2.5') == -2.5
    assert a_whole_number(1, 1000)('1000') == 1000


@pytest.mark.parametrize(('read', 'text', 'allowed'), [
    (a_number(0, unit='s'), '-1', 'a number at least 0 s'),
    (a_number(above=0), '0', 'a number above 0'),
    (a_number(above=0), 'x', 'a number above 0'),
    (a_number(unit='dBm'), 'inf', 'a number of dBm'),
    (a_whole_number(1), '0', 'a whole number from 1'),
    (a_whole_number(0), '-1', 'a whole number from 0'),
    (a_whole_number(1, 1000), '1001', 'a whole number from 1 to 1000'),
    (a_whole_number(0), '2.5', 'a whole number from 0')])
def test_other_numbers_are_refused(read, text, allowed):
    with pytest.raises(argparse.ArgumentTypeError, match=f'{text} is not allowed, .* {allowed}$'):
        read(text)


def test_a_script_that_ends_well_ends_with_0():
    assert run_script(lambda arguments: None, []) == 0


def test_a_script_may_say_its_exit_code():
    assert run_script(lambda arguments: len(arguments or ()), ['a', 'b', 'c']) == 3


@pytest.mark.parametrize(('error', 'line'), [
    (BagError('x: there is no such bag'), 'error: x: there is no such bag\n'),
    (ConfigError('two\nlines'), 'error: two lines\n'),
    (PermissionError(13, 'Permission denied', 'report.html'),
     'error: report.html: Permission denied\n'),
    (OSError(28, 'No space left on device'), 'error: No space left on device\n'),
])
def test_an_error_of_the_user_is_one_line_and_ends_with_1(error, line, capsys):
    def fail(arguments):
        raise error

    assert run_script(fail, []) == 1
    assert capsys.readouterr().err == line


def test_an_error_of_the_program_is_not_hidden():
    def fail(arguments):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run_script(fail, [])


def test_signal_handlers_are_put_back():
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    run_script(lambda arguments: None, [])
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


def test_a_signal_that_comes_in_a_finalizer_stops_the_script(capsys):
    class Finalized:
        def __del__(self):
            signal.raise_signal(signal.SIGTERM)

    def script(arguments):
        Finalized()
        time.sleep(60)
        return 3

    assert run_script(script, []) == 0
    assert capsys.readouterr().err == ''


def test_signals_that_come_at_once_stop_a_script_once_and_without_a_word(monkeypatch):
    both = {signal.SIGINT, signal.SIGTERM}
    told = []

    def script(arguments):
        signal.pthread_sigmask(signal.SIG_BLOCK, both)
        for number in both:
            signal.raise_signal(number)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, both)
        return 3

    monkeypatch.setattr(sys, 'unraisablehook', lambda dropped: told.append(dropped.exc_value))
    assert run_script(script, []) == 0
    assert told == []


def test_a_callers_alarm_still_rings():
    before = signal.setitimer(signal.ITIMER_REAL, 600)
    try:
        run_script(lambda arguments: None, [])
        assert signal.getitimer(signal.ITIMER_REAL)[0] > 0
    finally:
        signal.setitimer(signal.ITIMER_REAL, *before)


def test_what_a_signal_left_half_made_fails_to_be_finalized_without_a_word(monkeypatch):
    class HalfMade:
        def __init__(self):
            signal.raise_signal(signal.SIGTERM)
            self.name = 'whole'

        def __del__(self):
            assert self.name == 'whole'

    told = []
    monkeypatch.setattr(sys, 'unraisablehook', lambda dropped: told.append(dropped.exc_type))
    assert run_script(lambda arguments: HalfMade() and None, []) == 0
    assert told == []


def test_other_errors_of_finalizers_are_told_as_ever(monkeypatch):
    class Finalized:
        def __del__(self):
            raise ZeroDivisionError

    told = []
    monkeypatch.setattr(sys, 'unraisablehook', lambda dropped: told.append(dropped.exc_type))
    run_script(lambda arguments: Finalized() and None, [])
    assert told == [ZeroDivisionError]


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_script_with_0_and_its_bag_is_complete(tmp_path, number):
    process = subprocess.Popen(
        [sys.executable, '-c', RECORDING, str(tmp_path / 'bag')],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout.readline() == 'recording\n'
    process.send_signal(number)
    process.send_signal(number)
    output, error = process.communicate(timeout=60)
    assert (process.returncode, error) == (0, '')
    with Reader(tmp_path / 'bag') as reader:
        stamps = [one.stamp for one in reader.messages()]
    assert len(stamps) > 1000
    assert stamps == list(range(len(stamps)))
