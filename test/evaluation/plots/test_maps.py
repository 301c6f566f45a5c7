"""What the map shows, read back from the axes it was drawn on."""

from fleets import fleet, legend, lines, vehicle
from matplotlib.collections import EllipseCollection
import numpy as np
import pytest
from tsmcl_ros.evaluation import plots
from tsmcl_ros.evaluation.plots import maps


def test_the_map_has_one_scale_for_both_axes(ax):
    plots.map_view(ax, fleet(1))

    assert ax.get_aspect() == 1.0


def test_the_map_shows_the_estimates_where_they_are(ax):
    vehicles = fleet(1)

    plots.map_view(ax, vehicles)

    np.testing.assert_array_equal(
        lines(ax)['estimate'].get_xydata(), vehicles['veh_0'].estimate.position)


def test_the_map_shows_the_truth_also_where_there_are_no_estimates(ax):
    plots.map_view(ax, {'veh_0': vehicle(0, stamp=[1, 2, 3])})

    assert len(lines(ax)['truth'].get_xdata()) == 101


def test_few_vehicles_have_a_name_and_a_colour_each(ax):
    plots.map_view(ax, fleet(3))

    drawn = [lines(ax)[f'veh_{index}'].get_color() for index in range(3)]
    assert len(set(drawn)) == 3


def test_a_large_fleet_has_no_legend_entry_a_vehicle(ax):
    plots.map_view(ax, fleet(40))

    assert legend(ax) == ['truth', 'estimate', 'truth at the end', 'estimate at the end']


def test_radio_disks_have_the_radio_range_as_radius(ax):
    plots.map_view(ax, fleet(1), np.zeros((2, 3)), np.array([30.0, np.nan]))

    disks = next(item for item in ax.collections if isinstance(item, EllipseCollection))
    # An EllipseCollection offers its widths in no other way: it keeps half of them.
    assert 2 * disks._widths == pytest.approx([60.0])


def test_radio_disks_do_not_widen_the_view(ax):
    plots.map_view(ax, fleet(1))
    without = ax.get_xlim()
    _, other = plots.panel()

    plots.map_view(other, fleet(1), fleet(1)['veh_0'].path.position[:1], np.array([1e4]))

    assert other.get_xlim() == pytest.approx(without)


def test_suspects_are_marked_with_their_ids_where_they_stand(ax):
    plots.map_view(ax, fleet(1), suspects={7: np.array([30.0, 40.0, 5.0])})

    assert lines(ax)['suspect'].get_xydata().tolist() == [[30, 40]]
    assert [(text.get_text(), text.xy) for text in ax.texts] == [('7', (30, 40))]


def test_the_map_can_be_seen_from_aside(ax):
    plots.map_view(ax, fleet(1, dimension=3), np.array([[1.0, 2.0, 3.0]]), upright=2)

    assert (ax.get_xlabel(), ax.get_ylabel()) == ('x [m]', 'z [m]')
    assert lines(ax)['anchor'].get_xydata().tolist() == [[1, 3]]
    np.testing.assert_array_equal(
        lines(ax)['estimate'].get_xydata(),
        fleet(1, dimension=3)['veh_0'].estimate.position[:, [0, 2]])


def test_long_tracks_are_drawn_as_an_image(ax, monkeypatch):
    monkeypatch.setattr(maps, 'VECTOR', 100)
    plots.map_view(ax, fleet(1))

    assert '<image' in plots.svg(ax.figure, 'map')
