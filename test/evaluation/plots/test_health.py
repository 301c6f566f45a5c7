"""What plots of the vehicles' condition show, read back from the axes they were drawn on."""

from fleets import CLOCK, condition, conditions, legend, lines
import numpy as np
import pytest
from tsmcl_ros.evaluation import plots
from tsmcl_ros.evaluation.plots.canvas import GAP


def bars(ax):
    """Return (from, to, row) of the bars of each status, without those that are for the legend."""
    found = [[] for _ in range(3)]
    for index, collection in enumerate(item for item in ax.collections if not item.get_label()
                                       or item.get_label().startswith('_')):
        for path in collection.get_paths():
            (begin, low), (end, high) = path.vertices.min(axis=0), path.vertices.max(axis=0)
            found[index % 3].append((begin, end, (low + high) / 2))
    return found


def test_each_status_is_drawn_over_its_time(ax):
    plots.status_over_time(ax, {'veh_0': condition([0, 0, 1, 1, 2, 0])}, CLOCK)

    assert bars(ax) == [[(0, 2, 0), (5, 5, 0)], [(2, 4, 0)], [(4, 5, 0)]]


def test_each_of_few_vehicles_has_a_row_with_its_name(ax):
    plots.status_over_time(ax, conditions(3), CLOCK)

    assert [text.get_text() for text in ax.get_yticklabels()] == ['veh_0', 'veh_1', 'veh_2']


def test_a_status_is_unknown_once_it_is_too_old(ax):
    plots.status_over_time(ax, {'veh_0': condition([0] * 12, [*range(11), 100])}, CLOCK)

    assert bars(ax)[0] == [(0, 10 + GAP, 0), (100, 100, 0)]


def test_a_fleets_statuses_are_shares_that_add_up(ax):
    fleet = {f'veh_{index}': condition([0, index % 4 == 0, 0]) for index in range(20)}
    plots.status_over_time(ax, fleet, CLOCK)

    lost, stale, fine = (item.get_paths()[0].vertices for item in ax.collections)
    assert legend(ax) == ['LOST', 'STALE', 'OK']
    assert lost[:, 1].max() == 0
    assert stale[:, 1].max() == pytest.approx(25)
    assert fine[:, 1].max() == pytest.approx(100)


def test_a_vehicle_that_says_nothing_is_in_no_share(ax):
    silent = condition([0] * 20, np.arange(20))
    fleet = {f'veh_{index}': condition([2], [0]) for index in range(9)} | {'veh_9': silent}
    plots.status_over_time(ax, fleet, CLOCK)

    lost = ax.collections[0].get_paths()[0].vertices
    assert lost[lost[:, 0] > GAP + 1, 1].max() == 0


def test_the_ess_is_a_share_of_the_particles(ax):
    plots.effective_over_time(ax, {'veh_0': condition([0, 0, 0])}, CLOCK)

    assert lines(ax)['veh_0'].get_ydata().tolist() == [50, 50, 50]


def test_a_fleets_ess_is_drawn_as_its_median(ax):
    plots.effective_over_time(ax, conditions(40), CLOCK)

    assert legend(ax) == ['5 to 95 % of the vehicles', 'median']
    assert lines(ax)['median'].get_ydata() == pytest.approx(50)


def test_an_estimator_without_particles_has_no_ess():
    assert np.isnan(condition([0, 0], particles=1.0).effective).all()
