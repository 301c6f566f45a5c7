"""Beliefs led by azimuths, against a Kalman update by hand and ways whose azimuth is known."""

import math

import numpy as np
import pytest
from tsmcl_ros.model.azimuth import AzimuthLead, farthest, growth
from tsmcl_ros.model.grey import predict_azimuth

EVERYBODY = np.ones(1, bool)
STATION = np.array([[0.0, 0.0]])


def circling(lead, epochs=5, radius=100.0, rate=0.05, variance=4.0):
    """Let a station see a vehicle that goes round it; return the azimuths."""
    azimuths = rate * np.arange(epochs)
    for stamp, azimuth in enumerate(azimuths):
        position = radius * np.array([[np.cos(azimuth), np.sin(azimuth)]])
        lead.observe(float(stamp), position, variance * np.eye(2)[None], STATION, EVERYBODY)
    return azimuths


def belief(azimuth, radius=100.0, variance=50.0):
    mean = np.array([[radius * np.cos(azimuth), radius * np.sin(azimuth), 0.0, 5.0]])
    covariance = np.diag([variance, variance, 1.0, 1.0])[None].copy()
    return mean, covariance


def test_the_mean_is_that_of_a_kalman_update_by_the_grey_azimuth():
    lead = AzimuthLead(1, 2, threshold=10.0)
    azimuths = circling(lead)
    mean, covariance = belief(0.3)
    covariance[0, 0, 2] = covariance[0, 2, 0] = 3.0

    led, _ = lead.lead(6.0, mean, covariance, EVERYBODY)

    measured = predict_azimuth(azimuths, 2)
    x, y = mean[0, :2]
    row = np.array([-y, x, 0.0, 0.0]) / (x * x + y * y)
    noise = 4.0 / 100**2 * growth(np.array(2.0))
    gain = covariance[0] @ row / (row @ covariance[0] @ row + noise)
    np.testing.assert_allclose(led[0], mean[0] + gain * (measured - math.atan2(y, x)))


def test_the_growth_is_the_variance_of_a_line_through_five_values():
    design = np.stack([np.ones(5), np.arange(-4.0, 1.0)], axis=1)
    ahead = np.array([1.0, 7.0])

    variance = 1 + ahead @ np.linalg.inv(design.T @ design) @ ahead

    assert growth(np.array(7.0)) == pytest.approx(variance)


def test_an_azimuth_beyond_the_cut_is_the_near_one():
    lead = AzimuthLead(1, 2, threshold=10.0)
    for stamp in range(5):
        azimuth = math.pi - 0.1 + 0.04 * stamp
        position = 100 * np.array([[np.cos(azimuth), np.sin(azimuth)]])
        lead.observe(float(stamp), position, np.eye(2)[None], STATION, EVERYBODY)
    mean, covariance = belief(math.pi - 0.02)

    led, _ = lead.lead(5.0, mean, covariance, EVERYBODY)

    assert np.linalg.norm(led[0, :2] - mean[0, :2]) < 15


def test_a_surprising_azimuth_is_appended_where_the_filter_is_more_certain():
    ahead = {}
    for threshold in (0.05, 10.0):
        lead = AzimuthLead(1, 2, threshold)
        circling(lead)
        # The filter is sure that the vehicle has stopped.
        for stamp in range(5, 10):
            mean, covariance = belief(0.2, variance=0.01)
            led, _ = lead.lead(float(stamp), mean, covariance, EVERYBODY)
        ahead[threshold], _ = lead.lead(10.0, *belief(0.2, variance=1e4), EVERYBODY)
        assert np.allclose(led[0, :2], mean[0, :2], atol=2.0)

    # A series that went on by the filter does not take it far; one that did not, does.
    def turned(led):
        return math.atan2(led[0, 1], led[0, 0]) - 0.2

    assert abs(turned(ahead[0.05])) < 0.06 < turned(ahead[10.0])


def test_an_uncertain_filter_does_not_change_the_series():
    lead = AzimuthLead(1, 2, threshold=0.0)
    circling(lead, variance=0.01)
    wild = belief(-1.0, variance=1e5)

    first, _ = lead.lead(6.0, *wild, EVERYBODY)
    again, _ = lead.lead(6.0, *wild, EVERYBODY)

    np.testing.assert_array_equal(first, again)


def test_fewer_than_five_positions_lead_nobody():
    lead = AzimuthLead(1, 2, threshold=0.0)
    circling(lead, epochs=4)
    mean, covariance = belief(1.0)

    assert lead.lead(5.0, mean, covariance, EVERYBODY)[0] is mean


def test_those_who_are_heard_are_not_led():
    lead = AzimuthLead(1, 2, threshold=0.0)
    circling(lead)
    mean, covariance = belief(1.0)

    assert lead.lead(5.0, mean, covariance, ~EVERYBODY)[0] is mean


def test_a_vehicle_at_the_station_itself_stays_finite():
    lead = AzimuthLead(1, 2, threshold=0.0)
    for stamp in range(5):
        lead.observe(float(stamp), np.zeros((1, 2)), np.eye(2)[None], STATION, EVERYBODY)

    led, _ = lead.lead(6.0, np.zeros((1, 4)), np.eye(4)[None], EVERYBODY)

    assert np.isfinite(led).all()


def test_the_farthest_reference_is_the_station():
    reference = np.array([[[0.0, 0.0], [90.0, 0.0], [500.0, 0.0]]] * 3)
    used = np.array([[True, True, False], [True, True, True], [False, False, False]])

    station = farthest(np.tile([10.0, 0.0], (3, 1)), reference, used)

    assert station.tolist() == [[90.0, 0.0], [500.0, 0.0], [0.0, 0.0]]


def test_without_references_the_station_is_the_origin():
    assert farthest(np.ones((2, 2)), np.zeros((2, 0, 2)), np.zeros((2, 0), bool)).tolist() == [
        [0, 0], [0, 0]]
