"""The table of experiments."""

import pytest
from tsmcl_ros.evaluation.experiments import EXPERIMENTS


@pytest.mark.parametrize('name', EXPERIMENTS)
def test_the_quick_version_is_of_the_same_kind(name):
    full, quick = EXPERIMENTS[name]

    assert type(full) is type(quick)
