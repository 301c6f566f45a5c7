"""The time in which a process uses ROS, and how it ends."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
import os
from pathlib import Path
import re
import signal
import threading
import warnings

import rclpy
from rclpy.signals import SignalHandlerOptions
from tsmcl_ros.types import ConfigError

PATIENCE = 0.1  # s, longest wait before a signal is looked for

# Where Fast DDS looks for its defaults, in Jazzy and later: users' own go before ours.
_PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')

# All that rcl's failure to initialize with security enforced can mean.
_NO_KEYSTORE = ('DDS security is enforced and ROS_SECURITY_KEYSTORE names no folder with the keys '
                'of this enclave, must be a keystore')

# Signals come to a process, and not to one of its objects.
asked_to_stop = threading.Event()


class Stopped(Exception):
    """SIGINT or SIGTERM came while a node was spinning."""


class Misuse(Exception):
    """The command line makes no sense to ROS."""


@contextmanager
def session(arguments: Sequence[str] = ()) -> Iterator[None]:
    """
    Use ROS, with SIGINT and SIGTERM ending in `Stopped` while a node spins.

    However often they come: what follows, such as closing a bag, is not hurried.

    Raises
    ------
    Misuse, ConfigError
        If the arguments make no sense, or a parameter file cannot be read.

    """
    before = {
        number: signal.signal(number, lambda *_: asked_to_stop.set())
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        _init(arguments)
        yield
    finally:
        rclpy.try_shutdown()
        for number, handler in before.items():
            signal.signal(number, handler)
        asked_to_stop.clear()


def _init(arguments: Sequence[str]) -> None:
    if not any(name in os.environ for name in _PROFILES):
        os.environ[_PROFILES[0]] = str(Path(__file__).with_name('fastdds.xml'))
    with plainly(Misuse):
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)


@contextmanager
def plainly(kind: type[Exception]) -> Iterator[None]:
    """Raise what rcl complains of as an error of this kind, or as one of the configuration."""
    try:
        with warnings.catch_warnings():  # of what it could not tidy up after that
            warnings.simplefilter('ignore', RuntimeWarning)
            yield
    except RuntimeError as error:  # rclpy's own types are private
        # What went wrong, without where in its sources.
        text = re.sub(r'^failed to initialize rcl: |,? at /\S+\.c(pp)?:\d+', '',
                      ' '.join(str(error).split()))
        if text == 'error not set' and os.environ.get('ROS_SECURITY_ENABLE') == 'true':
            text, kind = _NO_KEYSTORE, ConfigError
        wrong = any(words in text for words in ('params file', 'SECURITY ERROR'))
        raise (ConfigError if wrong else kind)(text) from None
