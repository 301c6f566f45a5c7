"""What all scripts share: how they end, show their progress, and what their tables look like."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
import math
import shlex
import signal
import sys
import threading
from types import FrameType
from typing import Any

from tqdm import tqdm
from tsmcl_ros.types import Progress, T, TsmclError

AGAIN = 0.01  # s until an interrupt is raised anew that Python has dropped


class Interrupted(KeyboardInterrupt):
    """
    SIGINT or SIGTERM has come.

    A KeyboardInterrupt itself that passes an `exec` of text, which libraries make code with, has
    Python end by SIGINT even where it is caught.
    """


def run_script(
    script: Callable[[Sequence[str] | None], int | None], arguments: Sequence[str] | None,
) -> int:
    """
    Run a script and return its exit code.

    The code is what the script returns, or 0; 0 also when SIGINT or SIGTERM stop it, which reach
    the script as KeyboardInterrupt so that it closes what it has open; and 1 for an error that
    its user can mend, which goes to standard error as one line. Wrong usage is argparse's matter:
    it raises SystemExit with code 2.

    Parameters
    ----------
    script
        Takes the command line's arguments, None for the process's own.
    arguments
        What to hand it.

    """
    try:
        with _interruptible():
            try:
                return script(arguments) or 0
            except KeyboardInterrupt:
                return 0
    except (TsmclError, OSError) as error:
        reason = str(error)
        if isinstance(error, OSError) and error.strerror:
            reason = f'{error.filename}: {error.strerror}' if error.filename else error.strerror
        print(f'error: {" ".join(reason.splitlines())}', file=sys.stderr)
        return 1


def command_line(script: str, arguments: Sequence[str] | None) -> str:
    """Return the command line of a script that was called so, None as in `run_script`."""
    return shlex.join([script, *(sys.argv[1:] if arguments is None else arguments)])


def add_quiet(parser: argparse.ArgumentParser) -> None:
    """Give the parser `--quiet`."""
    parser.add_argument('--quiet', action='store_true', help='show no progress')


def a_number(least: float | None = None, above: float | None = None, unit: str = ''
             ) -> Callable[[str], float]:
    """Return what reads a finite number of an option, at least or above another, in a unit."""
    bound = 'of' * bool(unit)
    if least is not None:
        bound = f'at least {least:g}'
    elif above is not None:
        bound = f'above {above:g}'
    allowed = ' '.join(part for part in ('a number', bound, unit) if part)

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or (least is not None and value < least) or (
                above is not None and value <= above):
            raise argparse.ArgumentTypeError(f'{text} is not allowed, must be {allowed}')
        return value

    return read


def a_whole_number(least: int, most: int | None = None) -> Callable[[str], int]:
    """Return what reads a whole number of an option, from one to another."""
    allowed = f'a whole number from {least}{"" if most is None else f" to {most}"}'

    def read(text: str) -> int:
        # More digits than that Python does not read.
        value = int(text) if text.isdecimal() and len(text) < 1000 else -1
        if value < least or (most is not None and value > most):
            raise argparse.ArgumentTypeError(f'{text} is not allowed, must be {allowed}')
        return value

    return read


def progress_bar(quiet: bool, **options: Any) -> tqdm[Any]:
    """
    Return a bar on standard error, shown if that is a terminal, and nobody wants it quiet.

    Parameters
    ----------
    quiet : bool
        Show it in no case.
    **options
        As tqdm takes them.

    """
    return tqdm(disable=True if quiet else None, **{'leave': False, **options})


def progress(quiet: bool, task: str = '') -> Progress:
    """Return what shows a loop's progress by a `progress_bar`, named by its task by default."""
    def show(items: Iterable[T], total: int | None, unit: str, name: str = '') -> Iterable[T]:
        bar: Iterable[T] = progress_bar(
            quiet, iterable=items, total=total, unit=unit, desc=name or task or None)
        return bar

    return show


def align(rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Return rows of cells as lines of text, the first columns flush left, the others right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return '\n'.join(
        '  '.join(cell.ljust(width) if index < left else cell.rjust(width)
                  for index, (cell, width) in enumerate(zip(row, widths, strict=True))).rstrip()
        for row in rows)


@contextmanager
def _interruptible() -> Iterator[None]:
    """
    Have SIGINT and SIGTERM raise KeyboardInterrupt, once: what it cleans up is to be done.

    Finalizers and the calls of weak references run in between of anything, and Python drops what
    is raised in them; it is raised anew then. What was just being made cannot always be finalized,
    which is nobody's fault and not told.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        for number in asked:
            # Not SIG_IGN: Python complains where one has come already.
            signal.signal(number, lambda *_: None)
        stopping.set()
        raise Interrupted

    def raise_again(dropped: sys.UnraisableHookArgs) -> None:
        if isinstance(dropped.exc_value, Interrupted):
            signal.signal(signal.SIGALRM, interrupt)
            signal.setitimer(signal.ITIMER_REAL, AGAIN)
        elif not stopping.is_set():
            previous_hook(dropped)

    stopping = threading.Event()
    previous_hook = sys.unraisablehook
    asked = signal.SIGINT, signal.SIGTERM
    previous = {number: signal.getsignal(number) for number in (*asked, signal.SIGALRM)}
    try:
        sys.unraisablehook = raise_again
        for number in asked:
            signal.signal(number, interrupt)
        yield
    finally:
        if signal.getsignal(signal.SIGALRM) is interrupt:
            signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in previous.items():
            signal.signal(number, handler)
        sys.unraisablehook = previous_hook
