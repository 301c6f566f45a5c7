"""
The localizer node, which tells how much of its processor time goes into the filter.

    python test/benchmark/timed_localizer.py FILE --ros-args ...

FILE holds one double, which the time of `Localizer._epoch` [s] is added to.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.nodes import runtime
from tsmcl_ros.nodes.localizer import LocalizerNode
from tsmcl_ros.types import Estimate, Observation


def main(path: str, arguments: list[str]) -> int:
    """Run the node, its filter timed from outside, and return the exit code."""
    spent = np.memmap(path, float, 'r+', shape=1)
    work = Localizer._epoch

    def timed(localizer: Localizer, observation: Observation) -> Estimate:
        begin = time.thread_time()
        estimate = work(localizer, observation)
        spent[0] += time.thread_time() - begin
        return estimate

    Localizer._epoch = timed
    return runtime.main(LocalizerNode, arguments)


if __name__ == '__main__':
    sys.exit(main(sys.argv[1], [sys.argv[0], *sys.argv[2:]]))
