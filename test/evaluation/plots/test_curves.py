"""What curves show, read back from the axes they were drawn on."""

from fleets import lines, vehicle
import numpy as np
from tsmcl_ros.evaluation import plots


def test_the_cdf_is_numpys_share_of_errors_at_most_this_large(ax):
    error = vehicle(0).error

    plots.error_cdf(ax, {'a': error})

    x, share = lines(ax)['a'].get_data()
    assert share.tolist() == [np.mean(error <= level) for level in x]


def test_each_curve_of_many_looks_different(ax):
    plots.error_cdf(ax, {f'bag {index}': np.ones(3) for index in range(24)})

    looks = {(line.get_color(), line.get_linestyle()) for line in ax.get_lines()}
    assert len(looks) == 24
