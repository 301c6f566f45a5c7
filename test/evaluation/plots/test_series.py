"""What plots over time show, read back from the axes they were drawn on."""

from fleets import CLOCK, fleet, legend, lines, vehicle
import numpy as np
import pytest
from tsmcl_ros.evaluation import plots
from tsmcl_ros.evaluation.metrics import nees_band
from tsmcl_ros.evaluation.plots.canvas import GAP
from tsmcl_ros.evaluation.plots.series import fleet_series


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


def test_the_nees_is_averaged_over_the_vehicles(ax):
    vehicles = fleet(40)

    plots.nees_over_time(ax, {'a': vehicles})

    expected = np.mean([part.nees for part in vehicles.values()], axis=0)
    np.testing.assert_allclose(lines(ax)['mean over the vehicles'].get_ydata(), expected)


def test_the_nees_band_is_that_of_the_fleets_size(ax):
    plots.nees_over_time(ax, {'a': fleet(40)})

    band = next(patch for patch in ax.patches if patch.get_label() == '95 % band')
    extent = band.get_extents().transformed(ax.transData.inverted())
    assert (extent.y0, extent.y1) == pytest.approx(nees_band(2, 40))


def test_the_nees_of_several_runs_is_a_curve_each(ax):
    plots.nees_over_time(ax, {'a': fleet(40), 'b': fleet(1)})

    assert {'a', 'b'} <= set(legend(ax))


def test_a_covariance_that_is_as_good_as_none_does_not_squeeze_the_nees(ax):
    wrong = vehicle(0)
    wrong.nees[50] = 1e12

    plots.nees_over_time(ax, {'a': {'veh_0': wrong}})

    assert ax.get_ylim()[1] == pytest.approx(1000 * nees_band(2, 1)[1])


def test_a_run_that_dwarfs_the_others_makes_the_scale_logarithmic(ax):
    plots.median_error_over_time(ax, {
        'a': fleet(3), 'b': fleet(3), 'c': {'veh_0': vehicle(0, scale=50.0)}})

    assert ax.get_yscale() == 'log'


def test_fleets_of_different_sizes_have_no_band_in_common(ax):
    plots.nees_over_time(ax, {'a': fleet(40), 'b': fleet(1)})

    assert legend(ax) == ['a', 'b', 'expected: 2']


def test_a_fleets_series_holds_a_value_until_it_is_too_old():
    vehicles = {'a': vehicle(0), 'b': vehicle(1, stamp=[0, 1, 50])}

    stamp, error = fleet_series(vehicles, 'error')

    known = np.flatnonzero(np.isfinite(error[1]))
    assert known.tolist() == [*range(int(GAP) + 2), *range(50, 51 + int(GAP))]
    assert len(stamp) == 101
