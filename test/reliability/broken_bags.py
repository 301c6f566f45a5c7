"""Bags whose writers are killed, or run out of disk."""

from __future__ import annotations

from pathlib import Path
import subprocess
import sys
import time
from typing import NamedTuple

from tsmcl_ros import messages
from tsmcl_ros.bag import Reader
from tsmcl_ros.repair import repair


class Kill(NamedTuple):
    """What a killed recorder lost: the time before the end [s], and whether all else is there."""

    lost: float
    is_whole: bool


def kill_recorder(folder: Path, storage: str, rate: float = 100.0, seconds: float = 3.0) -> Kill:
    """Kill a process that writes as a recorder does, amid its writing, and repair its bag."""
    script = (
        'import sys, time; from tsmcl_ros.bag import Writer; from tsmcl_ros import messages\n'
        'bag = Writer(sys.argv[1], sys.argv[2]); bag.topic("/clock", messages.CLOCK)\n'
        'begin = saved = time.time(); print("begun", flush=True); n = 0\n'
        'while True:\n'
        '    n += 1; bag.write("/clock", float(n), messages.encode_clock(time.time()))\n'
        '    if time.time() - saved > 0.5: bag.save(); saved = time.time()\n'
        f'    time.sleep({1 / rate})\n')
    path = folder / 'bag'
    process = subprocess.Popen([sys.executable, '-c', script, str(path), storage],
                               stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    time.sleep(seconds)
    process.kill()
    killed = time.time()
    process.communicate()
    repair(path)
    with Reader(path) as bag:
        found = [(message.stamp, messages.decode_clock(message.data))
                 for message in bag.messages()]
    numbers = [int(number) for number, _ in found]
    return Kill(killed - found[-1][1], numbers == list(range(1, len(numbers) + 1)))


def fill_disk(folder: Path, storage: str, size: int) -> tuple[bool, str]:
    """Fill a disk of a size [kB] with a bag; return if that is valid, and what was said."""
    script = (
        'import sys; from tsmcl_ros.bag import Writer; from tsmcl_ros.types import BagError\n'
        'bag = Writer("disk/bag", sys.argv[1]); bag.topic("/image", "sensor_msgs/msg/Image")\n'
        'try:\n'
        '    for n in range(10**6):\n'
        '        bag.write("/image", 1.0 + n, n.to_bytes(4, "little") * 500)\n'
        '        if n % 50 == 0: bag.save()\n'
        'except BagError as error: print(error)\n')
    done = subprocess.run(
        ['unshare', '--mount', '--user', '--map-root-user', 'sh', '-c',
         f'mkdir disk && mount -t tmpfs -o size={size}k tmpfs disk && "$0" -c "$1" {storage} && '
         'cp -r disk/bag bag', sys.executable, script],
        cwd=folder, capture_output=True, text=True)
    if done.returncode:
        return False, done.stderr
    with Reader(folder / 'bag') as bag:
        numbers = [int.from_bytes(message.data[:4], 'little') for message in bag.messages()]
    said = f'complete are the {len(numbers)} messages before' in done.stdout
    return said and numbers == list(range(len(numbers))), done.stdout
