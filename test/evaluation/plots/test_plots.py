"""What holds for every plot."""

import subprocess
import sys
import xml.etree.ElementTree as ElementTree

from fleets import CLOCK, conditions, fleet, vehicle
import numpy as np
import pytest
from tsmcl_ros.evaluation import plots

DRAWINGS = {
    'map': lambda ax, vehicles: plots.map_view(ax, vehicles, np.zeros((3, 3)), np.full(3, 9.0)),
    'error': lambda ax, vehicles: plots.error_over_time(ax, vehicles, [(CLOCK + 5, CLOCK + 9)]),
    'medians': lambda ax, vehicles: plots.median_error_over_time(ax, {'a': vehicles}),
    'cdf': lambda ax, vehicles: plots.error_cdf(
        ax, {name: part.error for name, part in vehicles.items()}),
    'nees': lambda ax, vehicles: plots.nees_over_time(ax, {'a': vehicles}),
    'status': lambda ax, vehicles: plots.status_over_time(ax, conditions(len(vehicles)), CLOCK),
    'particles': lambda ax, vehicles: plots.particles_over_time(
        ax, conditions(len(vehicles)), CLOCK),
    'ess': lambda ax, vehicles: plots.effective_over_time(ax, conditions(len(vehicles)), CLOCK),
}


@pytest.mark.parametrize('name', DRAWINGS)
@pytest.mark.parametrize('count', [1, 40])
def test_every_plot_of_any_fleet_is_well_formed_svg(ax, name, count):
    DRAWINGS[name](ax, fleet(count))

    ElementTree.fromstring(plots.svg(ax.figure, name))


@pytest.mark.parametrize('name', DRAWINGS)
def test_a_vehicle_that_was_never_localized_does_not_disturb(ax, name):
    DRAWINGS[name](ax, {'veh_0': vehicle(0), 'veh_1': vehicle(1, stamp=[])})

    ElementTree.fromstring(plots.svg(ax.figure, name))


@pytest.mark.parametrize(('name', 'x', 'y'), [
    ('map', 'x [m]', 'y [m]'),
    ('error', 'time [s]', 'position error [m]'),
    ('medians', 'time [s]', 'position error [m]'),
    ('cdf', 'position error [m]', 'share of epochs'),
    ('nees', 'time [s]', 'NEES'),
    ('particles', 'time [s]', 'particles'),
    ('ess', 'time [s]', 'effective [%]'),
])
def test_axes_are_labelled_with_units(ax, name, x, y):
    DRAWINGS[name](ax, fleet(1))

    assert (ax.get_xlabel(), ax.get_ylabel()) == (x, y)


def test_drawing_leaves_pyplot_and_the_global_settings_alone():
    code = ('import matplotlib, sys; before = matplotlib.rcParams.copy()\n'
            'import numpy as np\n'
            'from tsmcl_ros.evaluation import plots\n'
            'figure, ax = plots.panel()\n'
            'plots.error_cdf(ax, {"a": np.ones(2), "b": np.ones(2)})\n'
            'plots.svg(figure, "a")\n'
            'assert "matplotlib.pyplot" not in sys.modules\n'
            'assert dict.__eq__(matplotlib.rcParams, before)\n')

    subprocess.run([sys.executable, '-c', code], check=True)
