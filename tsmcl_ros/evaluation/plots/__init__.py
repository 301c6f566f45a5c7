"""
Plots of runs against ground truth, and of experiments; only what is in here imports matplotlib.

The functions draw on the axes they are given. Nothing here touches pyplot or matplotlib's global
settings, so a program that plots things of its own may call them.
"""

from tsmcl_ros.evaluation.plots.canvas import panel, panels, save_png, svg
from tsmcl_ros.evaluation.plots.curves import error_against_epoch, error_cdf, intervals_against
from tsmcl_ros.evaluation.plots.maps import map_view
from tsmcl_ros.evaluation.plots.series import (
    error_over_time,
    median_error_over_time,
    nees_over_time,
)

__all__ = [
    'error_against_epoch', 'error_cdf', 'error_over_time', 'intervals_against', 'map_view',
    'median_error_over_time', 'nees_over_time', 'panel', 'panels', 'save_png', 'svg',
]
