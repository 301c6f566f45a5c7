"""A localizer's wire side, with messages that are encoded and decoded for real."""

from dataclasses import replace

import numpy as np
import pytest
from tsmcl_ros import messages
from tsmcl_ros.endpoint import Endpoint
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.types import Links, MessageError, Observation, Odometry, VEHICLE

CORNERS = np.array([[0, 0, 2], [100, 0, 2], [0, 100, 2], [100, 100, 2]], np.float32)
SETTINGS = {'min_particles': 200, 'range_std': 1.0, 'max_speed': 5.0}


def endpoint(*names, **settings):
    return Endpoint(Localizer({**SETTINGS, **settings}, len(names)), names)


def scan(stamp, place=None):
    """Return all corners, with their ranges if a place (2,) [m] is given."""
    heard = replace(Observation.empty(1, 4, 3, stamp), sender=np.array([[1, 2, 3, 4]]))
    heard.position[0] = CORNERS
    if place is not None:
        heard.range[0] = np.linalg.norm(CORNERS[:, :2] - place, axis=1)
    return heard


def encoded(observation, frame_id='map'):
    return messages.encode_beacons(observation, frame_id)[0]


def give(target, topic, data):
    """Hand a message over as a subscription does."""
    _, handler = target.inputs[topic]
    handler(data)


def poses(target):
    return [pose for estimate in target.localizer.finish() for pose in target.poses(estimate)]


def test_a_fleets_topics_are_those_in_its_namespaces():
    target = endpoint('/veh_0', '/veh_7')
    assert {topic: kind for topic, (kind, _) in target.inputs.items()} == {
        '/anchor_map': messages.POINT_CLOUD, '/anchor_links': messages.POINT_CLOUD,
        **{f'/veh_{i}/{name}': kind for i in (0, 7) for name, kind in (
            ('beacons', messages.POINT_CLOUD), ('odom', messages.ODOMETRY),
            ('initialpose', messages.POSE))}}
    assert target.outputs == ['/veh_0/pose', '/veh_7/pose']


def test_a_single_vehicles_topics_are_relative():
    target = endpoint('')
    assert set(target.inputs) == {
        '/anchor_map', '/anchor_links', 'beacons', 'odom', 'initialpose'}
    assert target.outputs == ['pose']


def test_a_wanted_beacon_period_is_told_when_it_changes():
    target = endpoint('/a', '/b', method='ekf', beacon_period='adaptive', motion_model='velocity',
                      range_calibration='off')
    assert target.period_outputs == ['/a/beacon_period', '/b/beacon_period']
    told = []
    for step in range(6):
        for name in ('a', 'b'):
            # The second one's ranges contradict where it has been.
            off = 6.0 if (step, name) == (4, 'b') else 0.0
            give(target, f'/{name}/beacons', encoded(scan(step, np.array([50.0 + off, 40.0]))))
        told.append([(vehicle, messages.decode_period(data))
                     for estimate in target.localizer.finish()
                     for vehicle, data in target.periods(estimate)])
    assert told[0] == [(0, 1), (1, 1)]
    assert told[1] == [(0, 15), (1, 15)]
    assert told[2] == told[3] == []
    [(vehicle, factor)] = told[4]
    assert vehicle == 1
    assert factor < 15


def test_a_method_that_wants_no_period_has_no_topic_for_it():
    assert endpoint('/a', method='ekf').period_outputs == []
    assert endpoint('/a', method='ts_mcl').period_outputs == []


def test_each_topic_is_that_of_its_vehicle():
    target = endpoint('/a', '/b')
    give(target, '/a/beacons', encoded(scan(5.0, (20, 30))))
    give(target, '/b/beacons', encoded(scan(5.0, (70, 60))))
    found = {vehicle: messages.decode_pose(data) for vehicle, data in poses(target)}
    np.testing.assert_allclose(found[0].position[:2], (20, 30), atol=1)
    np.testing.assert_allclose(found[1].position[:2], (70, 60), atol=1)


def test_a_pose_is_stamped_with_the_measurement_in_the_maps_frame():
    target = endpoint('/a')
    give(target, '/a/beacons', encoded(scan(1234567890.25, (20, 30))))
    [(_, data)] = poses(target)
    pose = messages.decode_pose(data)
    assert (pose.stamp, pose.frame_id) == (1234567890.25, 'map')


def test_what_is_not_estimated_has_a_large_variance():
    target = endpoint('/a')
    give(target, '/a/beacons', encoded(scan(5.0, (20, 30))))
    [(_, data)] = poses(target)
    covariance = messages.decode_pose(data).covariance
    assert (np.diag(covariance)[:2] < 10).all()
    assert (np.diag(covariance)[2:] == messages.UNMEASURED).all()


def test_the_pose_has_the_yaw_where_odometry_tells_it():
    target = endpoint('/a', odom_heading='known')
    for stamp in (4.9, 5.1):
        give(target, '/a/odom', messages.encode_odometry(
            Odometry(stamp, np.zeros(3), 0.7), 'odom', 'base_link'))
    give(target, '/a/beacons', encoded(scan(5.0, (20, 30))))
    [(_, data)] = poses(target)
    pose = messages.decode_pose(data)
    assert pose.yaw == pytest.approx(0.7)
    assert pose.covariance[5, 5] == 0


def test_a_vehicle_that_is_nowhere_yet_has_no_pose():
    target = endpoint('/a', '/b')
    give(target, '/a/beacons', encoded(scan(5.0, (20, 30))))
    assert [vehicle for vehicle, _ in poses(target)] == [0]


def test_no_published_pose_ever_holds_nan():
    target = endpoint('/a', '/b', range_calibration='online')
    rng = np.random.default_rng(1)
    published = []
    for stamp in np.arange(1.0, 60.0):
        heard = scan(stamp, rng.uniform(-300, 300, 2))  # ranges that contradict each other
        heard.range[0] *= rng.uniform(0, 5, 4)
        heard.range[0, rng.random(4) < 0.3] = np.nan
        give(target, '/a/beacons', encoded(heard))
        give(target, '/b/beacons', encoded(scan(stamp) if rng.random() < 0.5
                                           else Observation.empty(1, 0, 3, stamp)))
        published += [data for estimate in target.localizer.due()
                      for _, data in target.poses(estimate)]
    found = [messages.decode_pose(data) for data in published]  # which refuses NaN
    assert len(found) > 50  # who is placed anew has no pose until ranges tell one


@pytest.mark.parametrize(('topic', 'what', 'data'), [
    ('/anchor_map', 'anchor map', encoded(scan(1.0), 'odom')),
    ('/a/beacons', 'beacons', encoded(scan(1.0), 'odom')),
    ('/a/initialpose', 'initial pose', messages.encode_pose(
        1.0, 'odom', np.zeros(2), np.eye(2), 0.0, 1.0))],
    ids=['anchor map', 'beacons', 'initial pose'])  # padding differs between processes
def test_another_frame_is_refused(topic, what, data):
    with pytest.raises(MessageError,
                       match=f"{what}: frame_id 'odom' is not allowed, must be 'map'"):
        give(endpoint('/a'), topic, data)


def test_the_maps_frame_can_have_another_name():
    target = Endpoint(Localizer(SETTINGS), ['/a'], 'world')
    give(target, '/a/beacons', encoded(scan(1.0, (20, 30)), 'world'))
    [(_, data)] = poses(target)
    assert messages.decode_pose(data).frame_id == 'world'


def test_damaged_data_are_refused():
    target = endpoint('/a')
    for topic, (_, handler) in target.inputs.items():
        with pytest.raises(MessageError):
            handler(b'\0\1\0\0' + topic.encode())


def neighbour(**fields):
    """Return a scan whose last row is a vehicle's, at (50, 50) with a variance of 4 m^2."""
    heard = scan(1.0, (20, 30))
    row = replace(Observation.empty(1, 1, 3, 1.0), sender=np.array([[900]]))
    row.kind[:], row.position[:], row.covariance[:] = VEHICLE, 50, 4 * np.eye(3)
    for name, value in fields.items():
        getattr(row, name)[:] = value
    return Observation.join([heard, row])


LINE = np.full((3, 3), 4.0)  # variance along one direction only


@pytest.mark.parametrize(('fields', 'complaint'), [
    ({'covariance': LINE}, 'vehicle 900 claims a singular covariance'),
    ({'covariance': 0}, 'vehicle 900 claims a singular covariance'),
    ({'covariance': LINE - 2 * np.eye(3)}, 'cov_xx to cov_zz are not allowed'),
    ({'covariance': np.diag([1, -1, 1])}, 'cov_yy -1 of id 900 is not allowed'),
    ({'covariance': np.nan}, 'vehicle 900 claims a singular covariance'),
    ({'position': np.nan}, 'x nan of id 900 is not allowed, must be a number'),
    ({'position': 2e5}, 'x 200000 of id 900 is not allowed, must be within 100 km'),
    ({'kind': 7}, 'kind 7 is not allowed'), ({'hops': 0}, 'hops 0 is not allowed'),
    ({'max_range': np.inf}, 'max_range inf of id 900 is not allowed'),
    ({'rssi': np.inf}, 'rssi inf of id 900 is not allowed'),
    ({'range': -1}, 'range -1 of id 900 is not allowed')])
def test_who_says_what_cannot_be_true_is_left_out_and_counted_and_the_others_are_heard(
        fields, complaint):
    target, without = endpoint('/a'), endpoint('/a')
    for stamp in (1.0, 2.0):
        give(target, '/a/beacons', encoded(replace(neighbour(**fields), stamp=stamp)))
        give(without, '/a/beacons', encoded(scan(stamp, (20, 30))))
    given = messages.decode_poses([data for _, data in poses(target)])
    expected = messages.decode_poses([data for _, data in poses(without)])
    np.testing.assert_allclose(given.position, expected.position, atol=1)
    tally = target.localizer.untrue
    assert (tally.ignored.tolist(), tally.senders) == ([2], {900: 2})
    assert complaint in tally.reason


def test_who_goes_on_saying_what_cannot_be_true_is_a_suspect():
    target = endpoint('/a')
    for stamp in range(1, 8):
        give(target, '/a/beacons', encoded(replace(neighbour(range=-1), stamp=float(stamp))))
    assert len(poses(target)) == 7
    assert target.localizer.health.suspects == [[900]]


def test_an_anchor_that_says_what_cannot_be_true_is_heard_and_so_not_missed():
    target = endpoint('/a', radio_range=200.0, silence='map')
    give(target, '/anchor_map', encoded(scan(0.0)))
    for stamp in range(1, 8):
        broken = scan(float(stamp), (20, 30))
        broken.range[0, 2] = -1
        give(target, '/a/beacons', encoded(broken))
    assert len(poses(target)) == 7
    assert target.localizer.health.suspects == [[3]]
    assert target.localizer.health.lost[0] < 0.01


def test_a_message_is_rejected_if_nothing_in_it_can_be_true():
    target = endpoint('/a')
    broken = scan(1.0, (20, 30))
    broken.position[:] = 4e6
    with pytest.raises(MessageError, match='within 100 km of the origin: use a local origin'):
        give(target, '/a/beacons', encoded(broken))


@pytest.mark.parametrize('field', ['position', 'range'])
def test_a_map_is_rejected_for_one_anchor_that_cannot_be_true(field):
    target, map_ = endpoint('/a'), scan(0.0, (20, 30))
    getattr(map_, field)[0, 1] = -np.inf
    with pytest.raises(MessageError, match='-inf of id 2 is not allowed'):
        give(target, '/anchor_map', encoded(map_))


def test_a_vehicle_whose_range_was_not_measured_is_a_reference_all_the_same():
    target = endpoint('/a')
    give(target, '/a/beacons', encoded(neighbour(range=np.nan, max_range=60)))
    assert len(poses(target)) == 1


def test_an_anchor_may_be_exactly_known_along_one_axis():
    target = endpoint('/a')
    surveyed = scan(1.0, (20, 30))
    surveyed.covariance[:] = LINE
    give(target, '/a/beacons', encoded(surveyed))
    assert len(poses(target)) == 1


def test_the_map_of_anchors_is_heeded():
    target = endpoint('/a')
    give(target, '/anchor_map', encoded(scan(0.0)))
    for stamp in range(1, 8):
        lying = scan(float(stamp), (20, 30))
        lying.position[0, 1] += 5
        give(target, '/a/beacons', encoded(lying))
    assert len(poses(target)) == 7
    assert target.localizer.health.suspects == [[2]]


def initial_pose(x, y, yaw, yaw_variance=0.01):
    return messages.encode_pose(
        0.0, 'map', np.array([x, y]), 0.01 * np.eye(2), yaw, yaw_variance)


def test_an_initial_pose_places_the_vehicle_before_any_beacon():
    target = endpoint('/a', '/b')
    give(target, '/b/initialpose', initial_pose(-40.0, 250.0, 0.0))
    give(target, '/b/beacons', encoded(Observation.empty(1, 0, 3, 1.0)))
    [(vehicle, data)] = poses(target)
    assert vehicle == 1
    np.testing.assert_allclose(messages.decode_pose(data).position[:2], (-40, 250), atol=0.1)


@pytest.mark.parametrize(('yaw', 'known'), [(1.2, True), (np.nan, False)])
def test_an_initial_yaw_counts_if_it_is_known(yaw, known):
    target = endpoint('/a', motion_model='odometry')
    give(target, '/a/initialpose', initial_pose(0.0, 0.0, yaw, 1e-4))
    for stamp in (0.9, 1.1):
        give(target, '/a/odom', messages.encode_odometry(
            Odometry(stamp, np.zeros(3), -2.0), 'odom', 'base_link'))
    give(target, '/a/beacons', encoded(Observation.empty(1, 0, 3, 1.0)))
    [(_, data)] = poses(target)
    pose = messages.decode_pose(data)
    assert (pose.covariance[5, 5] < 1e-3) == known
    if known:
        assert pose.yaw == pytest.approx(1.2, abs=0.01)


def links(position=CORNERS, rssi=-60.0, frame_id='map'):
    """Return how the first corner and the others hear each other."""
    ends = np.array([[1, 1, 1, 2, 3, 4], [2, 3, 4, 1, 1, 1]])
    return messages.encode_links(0.0, Links(
        *ends, *(position[row - 1] for row in ends), np.full(6, rssi, np.float32)), frame_id)


def test_links_of_anchors_calibrate_the_radio():
    target = endpoint('', measure_rssi=True, radio_range=200.0)
    before = target.localizer.channel.path_loss(np.array([1])).mean(np.array([100.0]))
    give(target, '/anchor_links', links(rssi=-60.0))
    after = target.localizer.channel.path_loss(np.array([1])).mean(np.array([100.0]))
    assert before == pytest.approx(-80)
    assert after == pytest.approx(-60, abs=1)


def test_links_outlive_a_new_start():
    target = endpoint('', measure_rssi=True)
    give(target, '/anchor_links', links())
    calibrated = target.localizer.channel.path_loss(np.array([1])).reference
    target.localizer.reset()
    assert target.localizer.channel.path_loss(np.array([1])).reference == calibrated


@pytest.mark.parametrize(('data', 'complaint'), [
    (links(frame_id='odom'), "anchor links: frame_id 'odom' is not allowed, must be 'map'"),
    (links(CORNERS + 5), 'anchor links: anchor 1 claims'),
    (links(rssi=np.nan), 'rssi nan'),
    (b'', 'starts with the bytes'),
])
def test_links_that_contradict_what_is_known_are_refused_and_change_nothing(data, complaint):
    target = endpoint('', measure_rssi=True)
    give(target, '/anchor_map', encoded(scan(0.0)))
    with pytest.raises(MessageError, match=complaint):
        give(target, '/anchor_links', data)
    assert target.localizer.channel.path_loss(np.array([1])).reference == -40
