"""Axes to draw on, and the folder on the path for what the tests share."""

from pathlib import Path
import sys

import pytest
from tsmcl_ros.evaluation import plots

sys.path.append(str(Path(__file__).parent))


@pytest.fixture
def ax():
    return plots.panel()[1]
