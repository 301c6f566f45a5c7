"""What is read from bags, held against what was recorded."""

import numpy as np
import pytest
from tsmcl_ros import messages
from tsmcl_ros.bag import Writer
from tsmcl_ros.evaluation.metrics import evaluate
from tsmcl_ros.evaluation.recording import read_runs
from tsmcl_ros.messages import POSE
from tsmcl_ros.types import BagError, MessageError, Observation, Trajectory

CLOCK = 1.77e9


def truth(start=0.0, end=100.0):
    stamp = CLOCK + np.arange(start, end + 0.1, 0.5)
    position = np.column_stack([3.0 * (stamp - CLOCK), 0.0 * stamp])
    return Trajectory(stamp, position, np.zeros(len(stamp)))


def estimate(error=1.0, start=0.0, end=100.0):
    """Return an estimate that is always this far [m] off to the left."""
    stamp = CLOCK + np.arange(start, end + 0.1, 1.0)
    position = np.column_stack([3.0 * (stamp - CLOCK), np.full(len(stamp), error)])
    return Trajectory(stamp, position, np.full(len(stamp), np.nan),
                      np.tile(np.eye(2), (len(stamp), 1, 1)))


def nothing():
    return Trajectory(np.empty(0), np.empty((0, 2)), np.empty(0), np.empty((0, 2, 2)))


def scan(stamp, ids=(7,), max_range=np.nan):
    observation = Observation.empty(1, len(ids), 3, CLOCK + stamp)
    observation.sender[0] = ids
    observation.position[0] = np.arange(3.0 * len(ids)).reshape(-1, 3)
    observation.max_range[:] = max_range
    return observation


@pytest.fixture
def walk(record, tmp_path):
    """Return a function that records topics as a bag called walk."""
    return lambda topics: record(tmp_path / 'walk', topics)


def test_a_run_is_what_was_recorded_compared(walk):
    bag = walk({'/veh_0/ground_truth': truth(), '/veh_0/pose': estimate(2.0)})

    [run] = read_runs(bag)

    # The stamps of 2026 come back to the microsecond, in which the vehicle moves 3 um.
    expected = evaluate(estimate(2.0), truth())
    assert run.vehicles.keys() == {'veh_0'}
    assert run.overall.rmse_m == pytest.approx(expected.rmse_m, abs=1e-5)
    assert run.overall.nees == pytest.approx(expected.nees, abs=1e-4)
    assert (run.overall.epochs, run.overall.availability) == (101, 1.0)


def test_a_run_is_named_by_the_bags_folder(walk):
    bag = walk({'/veh_0/ground_truth': truth(), '/veh_0/pose': estimate()})

    assert read_runs(bag)[0].label == 'walk'


def test_skip_and_max_age_are_heeded(walk):
    bag = walk({'/veh_0/ground_truth': truth(), '/veh_0/pose': estimate()})

    [run] = read_runs(bag, skip=50.0, max_age=0.25)

    assert run.overall.epochs == 51
    assert run.overall.availability == pytest.approx(0.25)


def test_vehicles_are_listed_by_number(walk):
    topics = {}
    for index in (10, 2, 0):
        topics[f'/veh_{index}/ground_truth'] = truth()
        topics[f'/veh_{index}/pose'] = estimate()

    [run] = read_runs(walk(topics))

    assert list(run.vehicles) == ['veh_0', 'veh_2', 'veh_10']


def test_topics_without_namespace_are_one_vehicle(walk):
    bag = walk({'/ground_truth': truth(), '/pose': estimate(3.0)})

    assert list(read_runs(bag)[0].vehicles) == ['vehicle']


def test_topics_in_any_namespace_are_found(walk):
    bag = walk({'/lab/tag_3/ground_truth': truth(), '/lab/tag_3/pose': estimate()})

    assert list(read_runs(bag)[0].vehicles) == ['lab/tag_3']


def test_methods_below_a_vehicles_namespace_are_runs_of_their_own(walk):
    bag = walk({'/veh_0/ground_truth': truth(), '/veh_0/mcl/pose': estimate(4.0),
                '/veh_0/ts_mcl/pose': estimate(2.0)})

    runs = read_runs(bag)

    assert {run.label: round(run.overall.rmse_m, 3) for run in runs} == {
        'walk/mcl': 4.0, 'walk/ts_mcl': 2.0}


def test_a_vehicle_that_was_never_localized_counts_as_unavailable(walk):
    bag = walk({
        '/veh_0/ground_truth': truth(), '/veh_0/pose': estimate(),
        '/veh_1/ground_truth': truth(), '/veh_1/pose': nothing()})

    assert read_runs(bag)[0].overall.availability == pytest.approx(0.5)


def test_a_vehicle_without_a_pose_topic_is_named_and_not_evaluated(walk):
    bag = walk({'/veh_0/ground_truth': truth(), '/veh_0/pose': estimate(),
                '/veh_1/ground_truth': truth()})

    [run] = read_runs(bag)

    assert run.overall.availability == 1.0
    assert 'veh_1' in run.notes[0]


def test_a_pose_topic_without_ground_truth_is_named_and_not_evaluated(walk):
    bag = walk({'/veh_0/ground_truth': truth(), '/veh_0/pose': estimate(),
                '/veh_1/pose': estimate(50.0)})

    [run] = read_runs(bag)

    assert run.overall.max_m == pytest.approx(1.0, abs=1e-4)
    assert '/veh_1/pose' in run.notes[0]


def test_poses_outside_the_time_of_the_truth_are_counted_in_a_note(walk):
    bag = walk({'/veh_0/ground_truth': truth(end=50.0), '/veh_0/pose': estimate()})

    assert read_runs(bag)[0].notes[0].startswith('50 poses')


def test_skipped_poses_are_worth_no_note(walk):
    bag = walk({'/veh_0/ground_truth': truth(), '/veh_0/pose': estimate()})

    assert read_runs(bag, skip=5.0)[0].notes == ()


def test_the_anchor_map_is_read(walk):
    bag = walk({'/anchor_map': [scan(0, (4, 9), 30.0)],
                '/veh_0/ground_truth': truth(), '/veh_0/pose': estimate()})

    [run] = read_runs(bag)

    assert run.anchors.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert run.radio_range.tolist() == [30, 30]
    assert run.anchor_ids.tolist() == [4, 9]


def test_a_bag_without_an_anchor_map_has_no_anchors(walk):
    bag = walk({'/veh_0/ground_truth': truth(), '/veh_0/pose': estimate()})

    assert read_runs(bag)[0].anchors.shape == (0, 3)


def test_an_outage_is_when_nobody_hears_a_beacon(walk):
    def heard(*spans):
        return [scan(stamp) for begin, end in spans for stamp in np.arange(begin, end + 1.0)]

    bag = walk({
        '/veh_0/ground_truth': truth(), '/veh_0/pose': estimate(),
        '/veh_0/beacons': heard((0, 30), (70, 100)),
        '/veh_1/ground_truth': truth(), '/veh_1/pose': estimate(),
        '/veh_1/beacons': heard((0, 40), (60, 100))})

    assert read_runs(bag)[0].outages == ((CLOCK + 40, CLOCK + 60),)


def test_scans_in_which_nobody_was_heard_do_not_end_an_outage(walk):
    scans = [scan(stamp, () if 20 < stamp < 50 else (7,)) for stamp in range(101)]

    bag = walk({'/veh_0/ground_truth': truth(), '/veh_0/pose': estimate(),
                '/veh_0/beacons': scans})

    assert read_runs(bag)[0].outages == ((CLOCK + 20, CLOCK + 50),)


def test_a_bag_without_beacons_says_nothing_of_outages(walk):
    bag = walk({'/veh_0/ground_truth': truth(), '/veh_0/pose': estimate()})

    assert read_runs(bag)[0].outages == ()


def told(stamp, name, level=0, **values):
    """Return a row of diagnostics with one diagnosis."""
    values = {'particles': '200', 'effective particles': '50', 'suspects': '', **values}
    diagnosis = messages.Diagnosis(level, f'fleet: {name}', 'so', name, values)
    return CLOCK + stamp, messages.encode_diagnostics(CLOCK + stamp, [diagnosis])


def test_what_localizers_say_of_their_vehicles_is_read(walk):
    rows = [told(10.0, '/veh_0'), told(20.0, '/veh_0', 2, suspects='3, 4'),
            told(20.5, '/another/robots/motor', 1)]
    bag = walk({'/veh_0/ground_truth': truth(), '/veh_0/pose': estimate(),
                '/diagnostics': (messages.DIAGNOSTICS, rows)})

    conditions = read_runs(bag)[0].conditions

    assert conditions.keys() == {'veh_0'}
    assert conditions['veh_0'].level.tolist() == [0, 2]
    assert conditions['veh_0'].suspects == {3: 0.5, 4: 0.5}


def test_methods_below_a_vehicles_namespace_have_conditions_of_their_own(walk):
    rows = [told(10.0, '/veh_0/mcl', 1), told(10.0, '/veh_0/ts_mcl', 2)]
    bag = walk({'/veh_0/ground_truth': truth(), '/veh_0/mcl/pose': estimate(4.0),
                '/veh_0/ts_mcl/pose': estimate(), '/diagnostics': (messages.DIAGNOSTICS, rows)})

    assert [run.conditions['veh_0'].level.tolist() for run in read_runs(bag)] == [[1], [2]]


def test_a_localizer_without_namespace_is_known_by_that_of_ros(walk):
    bag = walk({'/ground_truth': truth(), '/pose': estimate(),
                '/diagnostics': (messages.DIAGNOSTICS, [told(10.0, '/', 1)])})

    assert read_runs(bag)[0].conditions['vehicle'].level.tolist() == [1]


def test_a_bag_without_diagnostics_has_no_conditions(walk):
    bag = walk({'/veh_0/ground_truth': truth(), '/veh_0/pose': estimate()})

    assert read_runs(bag)[0].conditions == {}


def test_what_a_bag_is_about_is_read(record, tmp_path):
    topics = {'/veh_0/ground_truth': truth(), '/veh_0/pose': estimate()}
    bag = record(tmp_path / 'walk', topics, {'command': 'walk on'})

    assert read_runs(bag)[0].about == {'command': 'walk on'}


def test_a_bag_without_poses_is_refused_saying_what_it_holds(walk):
    bag = walk({'/veh_0/ground_truth': truth(), '/veh_0/odom': truth()})

    with pytest.raises(BagError, match='walk: holds no pose: needed is .*PoseWithCovariance'
                                       'Stamped, found /veh_0/ground_truth, /veh_0/odom$'):
        read_runs(bag)


def test_a_bag_without_ground_truth_is_refused_saying_what_it_holds(walk):
    bag = walk({'/veh_0/pose': estimate()})

    with pytest.raises(BagError, match='holds no ground_truth: .*found /veh_0/pose$'):
        read_runs(bag)


def test_a_bag_whose_poses_and_truths_do_not_belong_together_is_refused(walk):
    bag = walk({'/a/pose': estimate(), '/b/ground_truth': truth()})

    with pytest.raises(BagError, match='no pose belongs to a ground truth: found /a/pose and '
                       '/b/ground_truth, needed is one of each in the same namespace'):
        read_runs(bag)


def test_no_overlap_in_time_is_refused_saying_both_spans(walk):
    bag = walk({'/veh_0/ground_truth': truth(0, 10),
                '/veh_0/pose': estimate(start=20, end=30)})

    with pytest.raises(BagError, match=r'poses span 1770000020\.000 to 1770000030\.000 s, '
                                       r'truth spans 1770000000\.000 to 1770000010\.000 s$'):
        read_runs(bag)


def test_skipping_everything_is_refused(walk):
    bag = walk({'/veh_0/ground_truth': truth(), '/veh_0/pose': estimate()})

    with pytest.raises(BagError, match='the first 500 s are skipped'):
        read_runs(bag, skip=500.0)


def test_only_empty_pose_topics_are_refused(walk):
    bag = walk({'/veh_0/ground_truth': truth(), '/veh_0/pose': nothing()})

    with pytest.raises(BagError, match='poses span no time, as there is no message'):
        read_runs(bag)


def test_a_malformed_pose_is_refused_naming_bag_and_topic(tmp_path):
    with Writer(tmp_path / 'walk') as bag:
        bag.topic('/pose', POSE)
        bag.write('/pose', 1.0, b'\0\1\0\0too short')
        bag.topic('/ground_truth', 'nav_msgs/msg/Odometry')

    with pytest.raises(MessageError, match='walk: /pose: '):
        read_runs(tmp_path / 'walk')


def test_a_missing_bag_is_refused(tmp_path):
    with pytest.raises(BagError, match='nowhere'):
        read_runs(tmp_path / 'nowhere')
