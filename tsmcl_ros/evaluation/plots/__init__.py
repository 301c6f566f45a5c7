"""
Plots of runs against ground truth, and of experiments; only what is in here imports matplotlib.

The functions draw on the axes they are given. Nothing here touches pyplot or matplotlib's global
settings, so a program that plots things of its own may call them.
"""

from tsmcl_ros.evaluation.plots.canvas import DISTINCT, panel, panels, save_png, stack, svg
from tsmcl_ros.evaluation.plots.curves import error_against_epoch, error_cdf, intervals_against
from tsmcl_ros.evaluation.plots.health import (
    effective_over_time,
    particles_over_time,
    status_over_time,
)
from tsmcl_ros.evaluation.plots.maps import map_view
from tsmcl_ros.evaluation.plots.series import (
    error_over_time,
    median_error_over_time,
    nees_over_time,
    time_origin,
)

__all__ = [
    'DISTINCT', 'effective_over_time', 'error_against_epoch', 'error_cdf', 'error_over_time',
    'intervals_against', 'map_view', 'median_error_over_time', 'nees_over_time', 'panel', 'panels',
    'particles_over_time', 'save_png', 'stack', 'status_over_time', 'svg', 'time_origin',
]
