"""What the plots show, read back from the axes they drew on."""

from functools import cache
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

from matplotlib.collections import EllipseCollection
import numpy as np
import pytest
from tsmcl_ros.evaluation import plots
from tsmcl_ros.evaluation.metrics import compare, nees_band
from tsmcl_ros.types import Trajectory

CLOCK = 1.77e9


def vehicle(seed, stamp=None, scale=1.0):
    """Return one vehicle's comparison with random errors, by default of 100 s on a real clock."""
    rng = np.random.default_rng(seed)
    truth_stamp = CLOCK + np.arange(101.0)
    stamp = truth_stamp if stamp is None else CLOCK + np.asarray(stamp, float)
    path = np.cumsum(rng.normal(0, 5, (101, 2)), axis=0)
    found = np.column_stack([np.interp(stamp, truth_stamp, column) for column in path.T])
    found += rng.normal(0, scale, found.shape)
    covariance = np.tile(scale**2 * np.eye(2), (len(stamp), 1, 1))
    return compare(
        Trajectory(stamp, found, np.full(len(stamp), np.nan), covariance),
        Trajectory(truth_stamp, path, np.zeros(101)))


@cache
def fleet(count):
    return {f'veh_{index}': vehicle(index) for index in range(count)}


@pytest.fixture
def ax():
    return plots.panel()[1]


def legend(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def lines(ax):
    return {line.get_label(): line for line in ax.get_lines()}


DRAWINGS = {
    'map': lambda ax, vehicles: plots.map_view(ax, vehicles, np.zeros((3, 3)), np.full(3, 9.0)),
    'error': lambda ax, vehicles: plots.error_over_time(ax, vehicles, [(CLOCK + 5, CLOCK + 9)]),
    'medians': lambda ax, vehicles: plots.median_error_over_time(ax, {'a': vehicles}),
    'cdf': lambda ax, vehicles: plots.error_cdf(
        ax, {name: part.error for name, part in vehicles.items()}),
    'nees': plots.nees_over_time,
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
])
def test_axes_are_labelled_with_units(ax, name, x, y):
    DRAWINGS[name](ax, fleet(1))

    assert (ax.get_xlabel(), ax.get_ylabel()) == (x, y)


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


def test_time_counts_from_the_truths_start(ax):
    plots.error_over_time(ax, {'veh_0': vehicle(0, stamp=[10, 11, 12])})

    assert lines(ax)['error'].get_xdata().tolist() == [10, 11, 12]


def test_the_error_is_drawn_beside_what_the_covariance_claims(ax):
    plots.error_over_time(ax, {'veh_0': vehicle(0, scale=3.0)})

    claimed = lines(ax)['claimed by the covariance'].get_ydata()
    assert claimed == pytest.approx(np.sqrt(18.0))


def test_a_line_breaks_where_there_are_no_estimates(ax):
    stamp = np.r_[0:30, 60:100]

    plots.error_over_time(ax, {'veh_0': vehicle(0, stamp=stamp)})

    drawn = lines(ax)['error'].get_ydata()
    assert np.flatnonzero(np.isnan(drawn)).tolist() == [29]


def test_outages_are_shaded_over_their_time(ax):
    plots.error_over_time(ax, fleet(1), [(CLOCK + 20, CLOCK + 50)])

    shade = next(patch for patch in ax.patches if patch.get_label() == 'no beacons')
    extent = shade.get_extents().transformed(ax.transData.inverted())
    assert (extent.x0, extent.x1) == pytest.approx((20, 50))


def test_a_fleets_error_is_drawn_as_its_median(ax):
    vehicles = fleet(40)

    plots.error_over_time(ax, vehicles)

    expected = np.median([part.error for part in vehicles.values()], axis=0)
    np.testing.assert_allclose(lines(ax)['median'].get_ydata(), expected)


def test_errors_of_one_magnitude_are_drawn_on_a_linear_scale_from_zero(ax):
    plots.error_over_time(ax, fleet(1))

    assert (ax.get_yscale(), ax.get_ylim()[0]) == ('linear', 0)


def test_errors_that_dwarf_all_others_are_drawn_on_a_logarithmic_scale(ax):
    lost = {'veh_0': vehicle(0, stamp=[0, 1, 2], scale=1e4), 'veh_1': vehicle(1)}

    plots.error_over_time(ax, lost)

    assert ax.get_yscale() == 'log'


def test_the_cdf_is_numpys_share_of_errors_at_most_this_large(ax):
    error = vehicle(0).error

    plots.error_cdf(ax, {'a': error})

    x, share = lines(ax)['a'].get_data()
    assert share.tolist() == [np.mean(error <= level) for level in x]


def test_each_curve_of_many_looks_different(ax):
    plots.error_cdf(ax, {f'bag {index}': np.ones(3) for index in range(24)})

    looks = {(line.get_color(), line.get_linestyle()) for line in ax.get_lines()}
    assert len(looks) == 24


def test_the_nees_is_averaged_over_the_vehicles(ax):
    vehicles = fleet(40)

    plots.nees_over_time(ax, vehicles)

    expected = np.mean([part.nees for part in vehicles.values()], axis=0)
    np.testing.assert_allclose(lines(ax)['mean over the vehicles'].get_ydata(), expected)


def test_the_nees_band_is_that_of_the_fleets_size(ax):
    plots.nees_over_time(ax, fleet(40))

    band = next(patch for patch in ax.patches if patch.get_label() == '95 % band')
    extent = band.get_extents().transformed(ax.transData.inverted())
    assert (extent.y0, extent.y1) == pytest.approx(nees_band(2, 40))


def test_a_fleets_series_holds_a_value_until_it_is_too_old():
    vehicles = {'a': vehicle(0), 'b': vehicle(1, stamp=[0, 1, 50])}

    stamp, error = plots.fleet_series(vehicles, 'error')

    known = np.flatnonzero(np.isfinite(error[1]))
    assert known.tolist() == [*range(int(plots.GAP) + 2), *range(50, 51 + int(plots.GAP))]
    assert len(stamp) == 101


def test_dollars_in_a_name_are_no_mathematics(ax):
    plots.error_cdf(ax, {r'$\nonsense$': np.ones(2), 'b': np.ones(2)})

    ElementTree.fromstring(plots.svg(ax.figure, 'cdf'))


def test_a_name_that_starts_with_an_underscore_is_in_the_legend(ax):
    plots.error_cdf(ax, {'_a': np.ones(2), 'b': np.ones(2)})

    assert [text.strip() for text in legend(ax)] == ['_a', 'b']


def test_svg_takes_its_ink_from_the_text_around_it(ax):
    plots.map_view(ax, fleet(1))

    text = plots.svg(ax.figure, 'map')

    assert 'currentColor' in text
    assert plots.INK not in text


def test_ids_of_two_figures_do_not_meet_in_one_page(ax):
    plots.error_cdf(ax, {'a': np.ones(2), 'b': np.ones(2)})

    first, second = (set(re.findall(r'\bid="([^"]+)"', plots.svg(ax.figure, name)))
                     for name in ('one', 'two'))

    assert first and not first & second


def test_every_reference_in_a_figure_has_its_target(ax):
    plots.map_view(ax, fleet(3), np.zeros((3, 3)), np.full(3, 9.0))
    text = plots.svg(ax.figure, 'map')

    used = set(re.findall(r'(?:"|url\()#([^")]+)', text))

    assert used and used <= set(re.findall(r'\bid="([^"]+)"', text))


def test_the_same_plot_gives_the_same_text():
    texts = []
    for _ in range(2):
        figure, ax = plots.panel()
        plots.map_view(ax, fleet(40), np.zeros((3, 3)), np.full(3, 9.0))
        texts.append(plots.svg(figure, 'map'))

    assert texts[0] == texts[1]


def test_long_tracks_are_drawn_as_an_image(ax, monkeypatch):
    monkeypatch.setattr(plots, 'VECTOR', 100)
    plots.map_view(ax, fleet(1))

    assert '<image' in plots.svg(ax.figure, 'map')


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
