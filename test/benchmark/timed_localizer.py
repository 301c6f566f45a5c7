"""
The localizer node, which tells how much of its processor time goes into the filter.

    python test/benchmark/timed_localizer.py FILE --ros-args ...

FILE holds one double, which the time of `Core.epoch` [s] is added to.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from tsmcl_ros.localizer.core import Core
from tsmcl_ros.nodes import runtime
from tsmcl_ros.nodes.localizer import LocalizerNode
from tsmcl_ros.types import Estimate, Observation


def main(path: str, arguments: list[str]) -> int:
    """Run the node, its filter timed from outside, and return the exit code."""
    spent = np.memmap(path, float, 'r+', shape=1)
    work = Core.epoch

    def timed(core: Core, observation: Observation) -> Estimate:
        begin = time.thread_time()
        estimate = work(core, observation)
        spent[0] += time.thread_time() - begin
        return estimate

    Core.epoch = timed
    return runtime.main(LocalizerNode, arguments)


if __name__ == '__main__':
    sys.exit(main(sys.argv[1], [sys.argv[0], *sys.argv[2:]]))
