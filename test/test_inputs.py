"""Topics of ranges and references: which they are, whom they name, and what cannot be."""

import math
import re

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from tsmcl_ros import messages
from tsmcl_ros.endpoint import Endpoint
from tsmcl_ros.inputs import InputConfig
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.types import ConfigError, MessageError, Observation, VEHICLE
from tsmcl_ros.types import Odometry as Pose

PAIR = r'/uwb/n_7/n_(\d+)'
ANCHORS = ('5 3 0', '6 0 4 0.5')


def listen(*topics, kinds=(), names=('',), namespace='/', settings=(), **inputs):
    """Return an endpoint that has discovered topics, those handlers, and what it gathers."""
    localizer = Localizer(dict(settings), len(names))
    endpoint = Endpoint(localizer, names, 'map', InputConfig(**inputs))
    scans = []
    endpoint.ranges.heed_epoch = lambda vehicle, scan: scans.append((vehicle, scan))
    found = endpoint.ranges.discover(
        dict.fromkeys(topics, messages.RANGE) | dict(kinds), namespace)
    return endpoint, {topic: handler for topic, (_, handler) in found.items()}, scans


def measured(stamp, distance=2.0, frame_id='', variance=math.nan):
    return messages.encode_range(
        messages.RangeReading(stamp, frame_id, distance, 0.0, math.nan, variance))


def senders(endpoint, scans):
    endpoint.ranges.gather(math.inf)
    return [scan.sender[0].tolist() for _, scan in scans]


# --- who may speak ---------------------------------------------------------------------------

def test_ranges_to_strangers_are_left_out_and_counted():
    endpoint, handlers, scans = listen(
        '/uwb/n_7/n_5', '/uwb/n_7/n_6', ranges=(PAIR,), anchors=ANCHORS,
        settings={'anchor_allowlist': ('6',)})
    for topic in ('/uwb/n_7/n_5', '/uwb/n_7/n_6'):
        handlers[topic](measured(1.0))
    assert senders(endpoint, scans) == [[6]]
    assert endpoint.localizer.speakers.senders == {5: 1}


def test_references_are_held_against_the_list_of_vehicles():
    endpoint, handlers, scans = listen(
        '/uwb/n_7/n_5', kinds={'/robot/pose': 'geometry_msgs/msg/PoseStamped'}, ranges=(PAIR,),
        references=('5 /robot/pose',), settings={'vehicle_allowlist': ('6',)})
    handlers['/uwb/n_7/n_5'](measured(1.0))
    assert senders(endpoint, scans) == []
    assert endpoint.localizer.speakers.senders == {5: 1}
    assert endpoint.ranges.unplaced == {}


# --- which topics ----------------------------------------------------------------------------

def test_relative_ranges_are_those_of_each_vehicle():
    endpoint, handlers, scans = listen(
        '/veh_0/uwb/5', '/veh_1/uwb/6', names=('/veh_0', '/veh_1'), ranges=(r'uwb/(\d)',),
        anchors=ANCHORS)
    handlers['/veh_0/uwb/5'](measured(1.0))
    handlers['/veh_1/uwb/6'](measured(1.0))
    endpoint.ranges.gather(math.inf)
    assert [(vehicle, scan.sender.tolist()) for vehicle, scan in scans] == [
        (0, [[5]]), (1, [[6]])]


def test_topics_of_other_types_are_not_listened_to():
    _, handlers, _ = listen('/a', kinds={'/b': messages.CLOCK}, ranges=('.*',))
    assert handlers.keys() == {'/a'}


def test_topics_are_discovered_once():
    endpoint, _, _ = listen('/a', ranges=('.*',))
    there = dict.fromkeys(['/a', '/b'], messages.RANGE)
    assert endpoint.ranges.discover(there).keys() == {'/b'}


def test_who_is_not_asked_for_a_range_is_not_taken_for_far():
    estimates = []
    for radio_range in (0.0, 2.0):
        endpoint, handlers, _ = listen(
            '/n_5', ranges=(r'/n_(\d)',), anchors=ANCHORS,
            settings={'radio_range': radio_range, 'use_heard': False})
        endpoint.ranges.heed_epoch = endpoint.localizer.beacons
        for stamp in range(3):
            handlers['/n_5'](measured(float(stamp), 4.0))
        endpoint.ranges.gather(math.inf)
        estimates.append(endpoint.localizer.finish()[-1])
    assert np.array_equal(estimates[0].mean, estimates[1].mean)


# --- whom they name --------------------------------------------------------------------------

def test_a_group_names_the_sender_wherever_the_own_node_stands():
    endpoint, handlers, scans = listen(
        '/uwb/n_7/n_5', '/uwb/n_6/n_7', anchors=ANCHORS,
        ranges=(r'/uwb/(?:n_7/n_(\d+)|n_(\d+)/n_7)',))
    for topic in handlers:
        handlers[topic](measured(1.0, frame_id='99'))
    assert senders(endpoint, scans) == [[5, 6]]


@pytest.mark.parametrize('frame_id', ['5', 'anchor_5', 'uwb1/anchor5', 'n' + '0' * 5000 + '5'])
def test_without_a_group_the_last_number_of_the_frame_names_it(frame_id):
    endpoint, handlers, scans = listen('/uwb', ranges=('/uwb',), anchors=ANCHORS)
    handlers['/uwb'](measured(1.0, frame_id=frame_id))
    assert senders(endpoint, scans) == [[5]]


@pytest.mark.parametrize(('pattern', 'error'), [
    ('/uwb', "frame_id 'tag' names no sender, must hold a number; or let a group in ranges"),
    ('/(uwb)', "'uwb' in the name of the topic names no sender, must hold a number")])
def test_a_sender_without_a_number_is_refused(pattern, error):
    _, handlers, _ = listen('/uwb', ranges=(pattern,))
    with pytest.raises(MessageError, match=re.escape(error)):
        handlers['/uwb'](measured(1.0, frame_id='tag'))


def test_a_sender_of_thousands_of_digits_is_refused():
    _, handlers, _ = listen('/uwb', ranges=('/uwb',))
    with pytest.raises(MessageError, match="frame_id '9+.*' names no sender, must hold a number"):
        handlers['/uwb'](measured(1.0, frame_id='9' * 5000))


def test_an_anchor_map_places_senders_too():
    endpoint, handlers, scans = listen('/uwb/n_7/n_8', ranges=(PAIR,), anchors=ANCHORS)
    anchors = Observation.empty(1, 1, 3, 0.0)
    anchors.sender[:], anchors.position[:] = 8, [[1.0, 2.0, 3.0]]
    endpoint.inputs['/anchor_map'][1](messages.encode_beacons(anchors, 'map')[0])
    handlers['/uwb/n_7/n_8'](measured(1.0))
    endpoint.ranges.gather(math.inf)
    assert scans[0][1].position[0].tolist() == [[1.0, 2.0, 3.0]]


def test_a_range_has_the_std_that_its_driver_tells():
    endpoint, handlers, scans = listen('/uwb/n_7/n_5', '/uwb/n_7/n_6', ranges=(PAIR,),
                                       anchors=ANCHORS)
    handlers['/uwb/n_7/n_5'](measured(1.0, variance=0.0625))
    handlers['/uwb/n_7/n_6'](measured(1.0))
    endpoint.ranges.gather(math.inf)
    np.testing.assert_array_equal(scans[0][1].range_std, [[0.25, np.nan]])


# --- references ------------------------------------------------------------------------------

def stamped(kind, x=2.0, frame_id='map', variance=0.0):
    message = {messages.POSE: PoseWithCovarianceStamped, messages.POSE_STAMPED: PoseStamped,
               messages.ODOMETRY: Odometry}[kind]()
    message.header.frame_id = frame_id
    message.header.stamp.sec = 1
    pose = message.pose if kind == messages.POSE_STAMPED else message.pose.pose
    pose.position.x, pose.orientation.w = x, 1.0
    if kind != messages.POSE_STAMPED:
        message.pose.covariance[0] = message.pose.covariance[7] = variance
    return serialize_message(message)


@pytest.mark.parametrize(('kind', 'variance', 'expected'), [
    (messages.POSE_STAMPED, 0.0, 0.04), (messages.POSE, 0.0, 0.04), (messages.POSE, 0.5, 0.5),
    (messages.ODOMETRY, 0.0, 0.04), (messages.ODOMETRY, 0.5, 0.5)])
def test_a_reference_is_a_vehicle_as_uncertain_as_it_tells(kind, variance, expected):
    endpoint, handlers, scans = listen(
        '/uwb/n_7/n_3', kinds={'/cap': kind}, ranges=(PAIR,), references=('3 /cap',),
        reference_std=0.2)
    handlers['/cap'](stamped(kind, variance=variance))
    handlers['/uwb/n_7/n_3'](measured(1.0))
    endpoint.ranges.gather(math.inf)
    scan = scans[0][1]
    assert scan.kind.tolist() == [[VEHICLE]]
    np.testing.assert_allclose(scan.position[0, 0], [2, 0, 0])
    np.testing.assert_allclose(np.diagonal(scan.covariance[0, 0])[:2], expected)


def test_a_reference_in_another_frame_is_refused():
    _, handlers, _ = listen(kinds={'/cap': messages.POSE_STAMPED}, references=('3 /cap',))
    with pytest.raises(MessageError, match="reference 3: frame_id 'odom' is not allowed, must be "
                                           "'map', as global_frame_id says"):
        handlers['/cap'](stamped(messages.POSE_STAMPED, frame_id='odom'))


# --- through the localizer -------------------------------------------------------------------

def drive(order):
    """Return the estimates of a vehicle at rest at (0, 0), topics interleaved in some order."""
    localizer = Localizer({'method': 'mcl', 'seed': 3, 'range_std': 0.3})
    endpoint = Endpoint(localizer, ['/v'], 'map', InputConfig(
        ranges=(PAIR,), anchors=(*ANCHORS, '8 -5 0')))
    distance = {'/uwb/n_7/n_5': 3.0, '/uwb/n_7/n_6': 4.0, '/uwb/n_7/n_8': 5.0}
    takers = dict(endpoint.inputs) | endpoint.ranges.discover(
        dict.fromkeys(distance, messages.RANGE))
    rows = [(0.1 * k, topic, measured(0.1 * k, far)) for k in range(1, 40)
            for topic, far in distance.items()]
    rows += [(0.05 * k, '/v/odom', messages.encode_odometry(
        Pose(0.05 * k, np.zeros(3), 0.0), 'odom', 'base')) for k in range(1, 80)]
    found = []
    for _, topic, data in sorted(rows, key=order):
        takers[topic][1](data)
        found += endpoint.due()
    endpoint.ranges.gather(math.inf)
    return found + localizer.finish()


def test_ranges_alone_place_a_vehicle_however_its_topics_interleave():
    by_time = drive(lambda row: row[0])
    late = drive(lambda row: (row[0] + 0.3 * (row[1] == '/uwb/n_7/n_6')))
    assert len(by_time) == 39
    np.testing.assert_allclose(by_time[-1].mean, 0, atol=0.5)
    for one, other in zip(by_time, late, strict=True):
        assert one.stamp == other.stamp
        np.testing.assert_array_equal(one.mean, other.mean)


def test_a_looped_bag_starts_the_localizer_anew():
    endpoint, handlers, scans = listen('/uwb/n_7/n_5', ranges=(PAIR,), anchors=ANCHORS)
    for stamp in (100.0, 101.0, 1.0, 2.0):
        handlers['/uwb/n_7/n_5'](measured(stamp))
    assert endpoint.localizer.restarts == 1
    assert endpoint.localizer.now == 2.0
    handlers['/uwb/n_7/n_5'](measured(3.0))
    assert [scan.stamp for _, scan in scans][-2:] == [1.0, 2.0]


def test_ranges_to_several_anchors_may_share_a_topic_and_a_stamp():
    endpoint, handlers, scans = listen('/uwb', ranges=('/uwb',), anchors=ANCHORS)
    for frame_id in ('anchor_5', 'anchor_6'):
        handlers['/uwb'](measured(1.0, frame_id=frame_id))
    assert senders(endpoint, scans) == [[5, 6]]
    with pytest.raises(MessageError, match='must be after the last one'):
        handlers['/uwb'](measured(1.0, frame_id='anchor_6'))


def test_a_range_that_goes_back_is_refused():
    _, handlers, _ = listen('/uwb/n_7/n_5', ranges=(PAIR,), anchors=ANCHORS)
    handlers['/uwb/n_7/n_5'](measured(5.0))
    with pytest.raises(MessageError, match=r'range: stamp 4\.000000 s is not allowed'):
        handlers['/uwb/n_7/n_5'](measured(4.0))


# --- what is asked for in vain ---------------------------------------------------------------

def test_a_pattern_without_a_topic_is_told_with_what_there_is():
    endpoint, _, _ = listen('/uwb/a', ranges=('/uwb/b', '/uwb/a'))
    assert endpoint.ranges.unmet({'/uwb/a': messages.RANGE}) == [
        "ranges: '/uwb/b' matches no topic of sensor_msgs/msg/Range, of which there are /uwb/a"]


@pytest.mark.parametrize(('topics', 'end'), [
    ({'/x': messages.ODOMETRY}, 'is not there, must be one of /x'),
    ({'/cap': messages.RANGE}, 'has type sensor_msgs/msg/Range, must have one of '
     'geometry_msgs/msg/PoseWithCovarianceStamped, geometry_msgs/msg/PoseStamped, '
     'nav_msgs/msg/Odometry')])
def test_a_reference_without_poses_is_told(topics, end):
    endpoint, _, _ = listen(kinds=topics, references=('3 /cap',))
    assert endpoint.ranges.unmet(topics) == [f'references: topic /cap of id 3 {end}']


def test_nothing_is_missed_where_nothing_is_asked_for():
    endpoint, handlers, _ = listen('/uwb/a')
    assert (endpoint.ranges.unmet({}), handlers) == ([], {})


@pytest.mark.parametrize(('settings', 'error'), [
    ({'ranges': ('(',)}, "ranges: '(' is not allowed, must be a topic or a regular expression"),
    ({'anchors': ('5 1',)}, "anchors: '5 1' is not allowed, must be 'id x y' or 'id x y z'"),
    ({'anchors': ('x 1 2',)}, "anchors: 'x 1 2' is not allowed"),
    ({'anchors': ('',)}, "anchors: '' is not allowed"),
    ({'anchors': ('5 1 nan',)}, "anchors: '5 1 nan' is not allowed"),
    ({'anchors': ('5 1 2', '5 1 3')}, 'anchors: id 5 comes twice'),
    ({'anchors': ('4294967296 1 2',)}, 'is not allowed'),
    ({'references': ('3',)}, "references: '3' is not allowed, must be 'id topic'"),
    ({'references': ('3 a', '3 b')}, 'references: id 3 comes twice'),
    ({'references': ('5 a',), 'anchors': ('5 1 2',)}, 'id 5 is not allowed, stands in anchors'),
    ({'reference_std': 0.0}, 'reference_std: 0.0 is not allowed, must be a number above 0 m')])
def test_inputs_are_refused(settings, error):
    with pytest.raises(ConfigError, match=re.escape(error)):
        InputConfig(**settings)


def test_an_epoch_of_ranges_may_not_be_longer_than_epochs_wait():
    with pytest.raises(ConfigError, match='range_epoch: 2 is not allowed, must be at most '
                                          'max_wait, 0.5 s'):
        listen(ranges=('/uwb',), range_epoch=2.0)
