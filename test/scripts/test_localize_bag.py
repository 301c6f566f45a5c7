"""Running bags through the localizer from the command line."""

from collections import Counter
from dataclasses import replace
import re
import signal
import sqlite3
import time

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_typestore, Stores
from tsmcl_ros import messages
from tsmcl_ros.bag import Reader, Writer
from tsmcl_ros.config import load_yaml
from tsmcl_ros.methods import METHODS
from tsmcl_ros.scripts.localize_bag import main
from tsmcl_ros.types import Observation, Odometry

CORNERS = np.array([[0, 0, 2], [100, 0, 2], [0, 100, 2], [100, 100, 2]], np.float32)
QUICK = ['--min-particles', '50', '--max-particles', '200', '--range-std', '1', '--max-speed', '5']


def scan(stamp, place):
    heard = replace(Observation.empty(1, 4, 3, stamp), sender=np.array([[1, 2, 3, 4]]))
    heard.position[0] = CORNERS
    heard.range[0] = np.linalg.norm(CORNERS[:, :2] - place, axis=1)
    return heard


def place(stamp, vehicle=0):
    return np.array([20 + stamp, 30 + 40.0 * vehicle])


def beacons(stamp, vehicle=0, frame_id='map'):
    return messages.encode_beacons(scan(stamp, place(stamp, vehicle)), frame_id)[0]


def pose(stamp, vehicle=0, frame_id='odom'):
    return messages.encode_odometry(
        Odometry(stamp, np.append(place(stamp, vehicle), 0.0), 0.0), frame_id, 'base_link')


def drive(vehicles=('/veh_0',), seconds=10, frame_id='map'):
    """Return rows (log time, topic, type, data) of vehicles driving along x."""
    table = scan(0.0, np.zeros(2))
    table.range[:] = np.nan
    rows = [(0.0, '/anchor_map', messages.POINT_CLOUD,
             messages.encode_beacons(table, frame_id)[0])]
    for vehicle, name in enumerate(vehicles):
        for tick in range(4 * seconds + 1):
            stamp = tick / 4
            rows.append((stamp, f'{name}/odom', messages.ODOMETRY, pose(stamp, vehicle)))
            rows.append((stamp, f'{name}/ground_truth', messages.ODOMETRY,
                         pose(stamp, vehicle, frame_id)))
            if tick % 4 == 0:
                rows.append((stamp, f'{name}/beacons', messages.POINT_CLOUD,
                             beacons(stamp, vehicle, frame_id)))
    return sorted(rows, key=lambda row: row[0])


def write(path, rows, storage='mcap'):
    with Writer(path, storage) as bag:
        for stamp, topic, kind, data in rows:
            bag.topic(topic, kind, latched=topic == '/anchor_map')
            bag.write(topic, stamp, data)
    return path


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Make a bag of one vehicle and ten seconds."""
    return write(tmp_path_factory.mktemp('bags') / 'drive', drive())


def localize(bag, out, *options):
    return main([str(bag), '--out', str(out), *QUICK, *options])


def read(path, *topics):
    with Reader(path) as reader:
        return [(one.topic, one.stamp, one.data) for one in reader.messages(topics or None)]


def poses(path, vehicle='/veh_0'):
    return [messages.decode_pose(data) for _, _, data in read(path, f'{vehicle}/pose')]


# --- what comes out --------------------------------------------------------------------------

def test_a_pose_is_written_for_every_epoch(bag, tmp_path):
    assert localize(bag, tmp_path / 'out') == 0
    found = poses(tmp_path / 'out')
    assert [one.stamp for one in found] == list(range(11))
    np.testing.assert_allclose(found[-1].position[:2], place(10.0), atol=1.5)


def test_one_line_says_what_was_made(bag, tmp_path, capsys):
    localize(bag, tmp_path / 'out')
    made, complaints = capsys.readouterr()
    line, told = made.splitlines()
    assert (line, complaints) == (f'{tmp_path}/out: 11 poses, vehicles: 1', '')
    assert told.startswith('range scale 1.00')


def test_the_bag_says_by_which_command_and_parameters_it_was_made(bag, tmp_path):
    localize(bag, tmp_path / 'out', '--seed', '3')
    with Reader(tmp_path / 'out') as reader:
        about = reader.about
    assert about['command'].startswith(f'localize_bag {bag} --out {tmp_path / "out"}')
    (tmp_path / 'params.yaml').write_text(about['localizer'])
    parameters = load_yaml(tmp_path / 'params.yaml')
    assert (parameters['seed'], parameters['max_particles']) == (3, 200)
    assert about.keys() == {'command', 'localizer'}


def test_the_bag_says_how_the_old_one_was_made(tmp_path):
    with Writer(tmp_path / 'drive', about={'command': 'simulate'}) as writer:
        for stamp, topic, kind, data in drive(seconds=1):
            writer.topic(topic, kind)
            writer.write(topic, stamp, data)
    localize(tmp_path / 'drive', tmp_path / 'out')
    with Reader(tmp_path / 'out') as reader:
        assert reader.about['input: command'] == 'simulate'


def test_anchors_beacons_and_truth_are_carried_over_as_they_are(bag, tmp_path):
    localize(bag, tmp_path / 'out')
    kept = ['/anchor_map', '/veh_0/beacons', '/veh_0/ground_truth']
    assert read(tmp_path / 'out', *kept) == read(bag, *kept)
    with Reader(tmp_path / 'out') as reader:
        assert set(reader.topics) == {*kept, '/veh_0/pose', '/diagnostics'}
        assert reader.latched == {'/anchor_map', '/veh_0/pose'}


def test_messages_are_in_order_of_log_time(bag, tmp_path):
    localize(bag, tmp_path / 'out')
    stamps = [stamp for _, stamp, _ in read(tmp_path / 'out')]
    assert stamps == sorted(stamps)


def test_mcap_and_rosbags_open_what_was_made(bag, tmp_path):
    localize(bag, tmp_path / 'out')
    with (tmp_path / 'out' / 'out.mcap').open('rb') as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_summary().statistics.message_count == len(read(tmp_path / 'out'))
        assert len(list(reader.iter_messages(['/veh_0/pose']))) == 11
    with AnyReader([tmp_path / 'out'],
                   default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        [topic] = [item for item in reader.connections if item.topic == '/veh_0/pose']
        [*_, (connection, _, data)] = reader.messages([topic])
        last = reader.deserialize(data, connection.msgtype)
    assert last.header.frame_id == 'map'
    assert last.header.stamp.sec == 10
    assert last.pose.pose.position.x == pytest.approx(30, abs=1.5)


def test_mcaps_own_decoder_understands_every_message(bag, tmp_path):
    localize(bag, tmp_path / 'out')
    with Reader(tmp_path / 'out') as reader:
        counts = reader.counts
    with (tmp_path / 'out' / 'out.mcap').open('rb') as stream:
        found = Counter(channel.topic for _, channel, _, decoded in make_reader(
            stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages() if decoded)
    assert found == {topic: count for topic, count in counts.items() if count}
    assert {'/diagnostics', '/veh_0/pose', '/anchor_map'} <= found.keys()


def test_the_new_bag_can_be_sqlite3(bag, tmp_path):
    assert localize(bag, tmp_path / 'out', '--storage', 'sqlite3') == 0
    assert (tmp_path / 'out' / 'out.db3').exists()
    assert len(poses(tmp_path / 'out')) == 11


def test_the_old_bag_can_be_sqlite3(tmp_path):
    bag = write(tmp_path / 'drive', drive(), 'sqlite3')
    assert localize(bag, tmp_path / 'out') == 0
    assert len(poses(tmp_path / 'out')) == 11


def test_all_vehicles_of_a_bag_are_localized(tmp_path, capsys):
    names = ('/veh_2', '/veh_10', '/lab/robot')
    localize(write(tmp_path / 'drive', drive(names)), tmp_path / 'out')
    line, _ = capsys.readouterr().out.splitlines()
    assert line == f'{tmp_path}/out: 33 poses, vehicles: 3'
    for vehicle, name in enumerate(names):
        last = poses(tmp_path / 'out', name)[-1]
        np.testing.assert_allclose(last.position[:2], place(10.0, vehicle), atol=2.5)


# --- the same again --------------------------------------------------------------------------

def test_the_same_seed_gives_the_same_bytes(bag, tmp_path):
    for name in ('a', 'b'):
        localize(bag, tmp_path / name, '--seed', '5')
    assert read(tmp_path / 'a', '/veh_0/pose') == read(tmp_path / 'b', '/veh_0/pose')


def test_another_seed_gives_others(bag, tmp_path):
    for name in ('5', '6'):
        localize(bag, tmp_path / name, '--seed', name)
    assert read(tmp_path / '5', '/veh_0/pose') != read(tmp_path / '6', '/veh_0/pose')


def test_the_storage_of_the_bag_does_not_matter(bag, tmp_path):
    other = write(tmp_path / 'drive', drive(), 'sqlite3')
    localize(bag, tmp_path / 'a')
    localize(other, tmp_path / 'b')
    assert read(tmp_path / 'a', '/veh_0/pose') == read(tmp_path / 'b', '/veh_0/pose')


# --- parameters ------------------------------------------------------------------------------

def test_parameters_come_from_a_file_and_options_win(bag, tmp_path):
    path = tmp_path / 'params.yaml'
    path.write_text('/**:\n  ros__parameters:\n    seed: 5\n    outage_period: 0.25\n')
    assert localize(bag, tmp_path / 'a', '--params', str(path), '--outage-period', '0.5') == 0
    assert localize(bag, tmp_path / 'b', '--seed', '5', '--outage-period', '0.5') == 0
    assert read(tmp_path / 'a', '/veh_0/pose') == read(tmp_path / 'b', '/veh_0/pose')
    assert len(poses(tmp_path / 'a')) == 21


def test_a_parameter_file_of_the_node_serves_here_too(tmp_path):
    path = tmp_path / 'params.yaml'
    path.write_text('/**:\n  ros__parameters:\n    use_sim_time: true\n    tf_broadcast: true\n'
                    '    global_frame_id: world\n    seed: 5\n')
    bag = write(tmp_path / 'drive', drive(frame_id='world'))
    assert localize(bag, tmp_path / 'out', '--params', str(path)) == 0
    assert {one.frame_id for one in poses(tmp_path / 'out')} == {'world'}


def test_the_maps_frame_is_an_option(tmp_path):
    bag = write(tmp_path / 'drive', drive(frame_id='world'))
    assert localize(bag, tmp_path / 'out', '--global-frame-id', 'world') == 0
    assert len(poses(tmp_path / 'out')) == 11


# --- user errors: one line, and what to do ---------------------------------------------------

def refused(capsys, bag, out, *options):
    """Return the one line that a refusal says."""
    assert main([str(bag), '--out', str(out), *options]) == 1
    printed, error = capsys.readouterr()
    assert printed == ''
    assert error.startswith('error: ')
    assert error.count('\n') == 1
    return error.removeprefix('error: ').rstrip('\n')


def test_a_missing_bag_is_named(tmp_path, capsys):
    assert refused(capsys, tmp_path / 'none', tmp_path / 'out') == (
        f'{tmp_path}/none: there is no such bag')
    assert not (tmp_path / 'out').exists()


def test_an_empty_folder_is_no_bag(tmp_path, capsys):
    (tmp_path / 'empty').mkdir()
    assert 'is an empty folder; a bag has a metadata.yaml' in refused(
        capsys, tmp_path / 'empty', tmp_path / 'out')


def test_a_bag_without_messages_is_named(tmp_path, capsys):
    with Writer(tmp_path / 'bag') as bag:
        bag.topic('/veh_0/beacons', messages.POINT_CLOUD)
    assert refused(capsys, tmp_path / 'bag', tmp_path / 'out') == (
        f'{tmp_path}/bag: holds no messages')


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_truncated_bag_is_named(storage, tmp_path, capsys):
    path = write(tmp_path / 'bag', drive(), storage)
    [file] = [item for item in path.iterdir() if item.suffix != '.yaml']
    file.write_bytes(file.read_bytes()[:file.stat().st_size // 2])
    error = refused(capsys, path, tmp_path / 'out')
    assert 'cannot be read, it is truncated or damaged' in error


def test_a_database_that_is_none_is_named(tmp_path, capsys):
    path = write(tmp_path / 'bag', drive(), 'sqlite3')
    (path / 'bag.db3').write_bytes(b'x' * 5000)
    assert f'{path}' in refused(capsys, path, tmp_path / 'out')


def test_a_bag_that_exists_is_never_overwritten(bag, tmp_path, capsys):
    localize(bag, tmp_path / 'out')
    before = (tmp_path / 'out' / 'out.mcap').read_bytes()
    capsys.readouterr()
    assert refused(capsys, bag, tmp_path / 'out') == (
        f'{tmp_path}/out: exists already, bags are never overwritten')
    assert (tmp_path / 'out' / 'out.mcap').read_bytes() == before


def test_a_bag_is_not_written_into_itself(bag, capsys):
    assert 'exists already' in refused(capsys, bag, bag)


def test_a_bag_without_a_topic_of_beacons_lists_what_it_has(tmp_path, capsys):
    path = write(tmp_path / 'bag', [row for row in drive() if 'beacons' not in row[1]])
    assert refused(capsys, path, tmp_path / 'out') == (
        f'{path}: has no topic NAMESPACE/beacons of type sensor_msgs/msg/PointCloud2, has '
        '/anchor_map, /veh_0/ground_truth, /veh_0/odom')


def test_what_the_anchors_transmit_is_not_what_a_vehicle_hears(tmp_path, capsys):
    path = write(tmp_path / 'bag', [(1.0, '/beacons', messages.POINT_CLOUD, beacons(1.0))])
    assert 'has no topic NAMESPACE/beacons' in refused(capsys, path, tmp_path / 'out')


def test_a_topic_of_beacons_without_messages_is_named(tmp_path, capsys):
    rows = [row for row in drive() if 'beacons' not in row[1]]
    with Writer(tmp_path / 'bag') as bag:
        bag.topic('/veh_0/beacons', messages.POINT_CLOUD)
        for stamp, topic, kind, data in rows:
            bag.topic(topic, kind)
            bag.write(topic, stamp, data)
    assert refused(capsys, tmp_path / 'bag', tmp_path / 'out') == (
        f'{tmp_path}/bag: has no message on /veh_0/beacons')


@pytest.mark.parametrize(('options', 'line'), [
    (['--method', 'kalman'],
     f"method: 'kalman' is not allowed, must be one of {', '.join(METHODS)}"),
    (['--min-particles', '0'], 'min_particles: 0 is not allowed, must be a whole number at least'),
    (['--seed', 'x'], "seed: 'x' is not allowed, must be a whole number at least 0"),
    (['--min-particles', '300', '--max-particles', '200'], 'max_particles: 200 is not allowed'),
    (['--method', 'grid'], 'motion_model must be random'),
    (['--params', 'none.yaml'], 'none.yaml: cannot read the parameter file')])
def test_a_value_that_is_not_allowed_says_what_is(options, line, bag, tmp_path, capsys):
    assert line in refused(capsys, bag, tmp_path / 'out', *options)


def test_an_unknown_parameter_in_a_file_names_the_nearest(bag, tmp_path, capsys):
    path = tmp_path / 'params.yaml'
    path.write_text('/**:\n  ros__parameters:\n    min_particle: 5\n')
    assert "unknown parameter 'min_particle', did you mean min_particles" in refused(
        capsys, bag, tmp_path / 'out', '--params', str(path))
    assert not (tmp_path / 'out').exists()


@pytest.mark.parametrize('arguments', [
    [], ['bag'], ['bag', '--out', 'x', '--nonsense', '1'],
    ['bag', '--out', 'x', '--storage', 'y']])
def test_wrong_usage_is_exit_code_2(arguments, capsys):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert 'usage: localize_bag' in capsys.readouterr().err


# --- bags with something wrong in them -------------------------------------------------------

def spoilt(rows, spoil):
    """Return the rows with the data of some of them spoilt."""
    return [(stamp, topic, kind, spoil(stamp, topic, data)) for stamp, topic, kind, data in rows]


def test_damaged_messages_are_counted_and_the_rest_is_localized(tmp_path, capsys):
    path = write(tmp_path / 'bag', spoilt(drive(), lambda stamp, topic, data: (
        data[:100 + int(stamp)] if topic == '/veh_0/beacons' and stamp in (4, 5, 6) else
        data[:-1] if topic == '/veh_0/odom' and stamp == 7 else data)))
    assert localize(path, tmp_path / 'out') == 0
    error = capsys.readouterr().err
    assert [line.partition(': ')[2].partition(': ')[0] for line in error.splitlines()] == [
        'rejected 3 messages of /veh_0/beacons', 'rejected 1 messages of /veh_0/odom']
    found = poses(tmp_path / 'out')
    assert [one.stamp for one in found] == [0, 1, 2, 3, 5, 7, 8, 9, 10]  # 5 is a prediction
    np.testing.assert_allclose(found[-1].position[:2], place(10.0), atol=1.5)


def test_messages_that_come_twice_are_reported_with_their_stamps(tmp_path, capsys):
    rows = drive()
    localize(write(tmp_path / 'bag', sorted(rows + rows[30:60], key=lambda row: row[0])),
             tmp_path / 'out')
    error = capsys.readouterr().err
    assert 'of /veh_0/odom: odometry: stamp ' in error
    assert 'is not allowed, must be after the last one' in error
    assert len(error.splitlines()) == 2  # one for the odometry, one for the beacons
    assert len(poses(tmp_path / 'out')) == 11


def test_many_reasons_are_summed_up(tmp_path, capsys):
    letters = iter('abcdefghijklmnop')
    rows = spoilt(drive(), lambda _, topic, data: (
        data if topic != '/veh_0/beacons' else beacons(1.0, frame_id=next(letters))))
    assert localize(write(tmp_path / 'bag', rows), tmp_path / 'out') == 0
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 6
    assert lines[-1] == 'note: rejected 6 messages more, for 6 other reasons'


def test_a_topic_of_another_type_is_reported(tmp_path, capsys):
    rows = [(stamp, topic, messages.CLOCK, messages.encode_clock(stamp))
            if topic == '/veh_0/odom' else (stamp, topic, kind, data)
            for stamp, topic, kind, data in drive()]
    assert localize(write(tmp_path / 'bag', rows), tmp_path / 'out') == 0
    assert capsys.readouterr().err == (
        'note: rejected 41 messages of /veh_0/odom: type rosgraph_msgs/msg/Clock is not allowed, '
        'must be nav_msgs/msg/Odometry\n')
    assert len(poses(tmp_path / 'out')) == 11


def test_topics_of_the_same_name_but_another_type_stay_behind(tmp_path):
    rows = [*drive(), (10.0, '/camera/ground_truth', messages.CLOCK, messages.encode_clock(0.0))]
    assert localize(write(tmp_path / 'bag', rows), tmp_path / 'out') == 0
    with Reader(tmp_path / 'out') as reader:
        assert '/camera/ground_truth' not in reader.topics


def test_topics_of_unknown_types_are_passed_over(tmp_path):
    path = write(tmp_path / 'bag', [
        *drive(), (10.0, '/foo/ground_truth', messages.CLOCK, messages.encode_clock(0.0))],
        'sqlite3')
    with sqlite3.connect(path / 'bag.db3') as database:
        database.execute("update topics set type = 'foo_msgs/msg/Bar' where name like '/foo%'")
    metadata = path / 'metadata.yaml'
    metadata.write_text(metadata.read_text().replace(messages.CLOCK, 'foo_msgs/msg/Bar'))
    with Reader(path) as reader:
        assert reader.topics['/foo/ground_truth'] == 'foo_msgs/msg/Bar'
    assert localize(path, tmp_path / 'out') == 0


def test_a_bag_whose_time_starts_over_is_localized_twice(tmp_path, capsys):
    rows = drive(seconds=20)
    again = [(stamp + 30, *row) for stamp, *row in rows]
    assert localize(write(tmp_path / 'bag', rows + again), tmp_path / 'out') == 0
    assert capsys.readouterr().err == 'note: started anew where time jumped, 1 times\n'
    data = [one for _, _, one in read(tmp_path / 'out', '/veh_0/pose')]
    assert len(data) == 42
    assert data[:21] == data[21:]


def test_stopping_leaves_a_complete_bag(start, tmp_path):
    path = write(tmp_path / 'bag', drive(seconds=300))
    process = start('scripts.localize_bag', path, '--out', tmp_path / 'out',
                    '--min-particles', 20_000, '--max-particles', 20_000)
    while not (tmp_path / 'out' / 'out.mcap').exists():
        assert process.process.poll() is None, process.output
        time.sleep(0.02)
    assert process.stop(signal.SIGTERM) == 0
    assert 'Traceback' not in process.output
    assert (tmp_path / 'out' / 'metadata.yaml').exists()
    with (tmp_path / 'out' / 'out.mcap').open('rb') as file:
        assert make_reader(file, validate_crcs=True).get_summary() is not None


# --- topics by other names -------------------------------------------------------------------

def renamed(rows, **names):
    return [(stamp, names.get(topic.rpartition('/')[2], topic), kind, data)
            for stamp, topic, kind, data in rows]


def test_remapped_topics_serve_as_those_they_stand_for(bag, tmp_path):
    other = write(tmp_path / 'other', renamed(drive(), odom='/wheels', ground_truth='/mocap'))
    assert localize(other, tmp_path / 'a', '--remap', 'odom:=/wheels',
                    '--remap', 'ground_truth:=/mocap') == 0
    assert localize(bag, tmp_path / 'b') == 0
    assert read(tmp_path / 'a') == read(tmp_path / 'b')


def test_a_remapped_topic_that_is_not_there_is_named(bag, tmp_path, capsys):
    assert 'has no topic /veh_0/wheels, which odom is remapped to; has /anchor_map' in refused(
        capsys, bag, tmp_path / 'out', '--remap', 'odom:=wheels')


def test_ground_truth_without_poses_is_refused(bag, tmp_path, capsys):
    assert 'ground_truth: topic /anchor_map has type sensor_msgs/msg/PointCloud2, must' in refused(
        capsys, bag, tmp_path / 'out', '--remap', 'ground_truth:=/anchor_map')


@pytest.mark.parametrize(('rules', 'line'), [
    (['odom=/x'], "remap: 'odom=/x' is not allowed, must be FROM:=TO with FROM one of beacons"),
    (['tf:=/x'], "remap: 'tf:=/x' is not allowed"),
    (['odom:=/x', 'odom:=/y'], 'remap: odom comes twice, must come once')])
def test_remappings_are_refused(rules, line, bag, tmp_path, capsys):
    options = [word for rule in rules for word in ('--remap', rule)]
    assert line in refused(capsys, bag, tmp_path / 'out', *options)


def test_the_vehicles_can_be_chosen(tmp_path, capsys):
    path = write(tmp_path / 'drive', drive(('/veh_0', '/veh_1')))
    assert localize(path, tmp_path / 'out', '--namespace', 'veh_1') == 0
    line, _ = capsys.readouterr().out.splitlines()
    assert line == f'{tmp_path}/out: 11 poses, vehicles: 1'


# --- ranges as drivers publish them ----------------------------------------------------------

def ranged(names=('/veh_0',)):
    """Return the drive without beacons, but with ranges to the anchors at the four corners."""
    rows = [row for row in drive(names) if 'beacons' not in row[1]]
    for vehicle, name in enumerate(names):
        for stamp in np.arange(0.5, 10.0, 0.5).tolist():
            for number, corner in enumerate(CORNERS[:, :2], start=1):
                distance = float(np.linalg.norm(place(stamp, vehicle) - corner))
                data = messages.encode_range(
                    messages.RangeReading(stamp, '', distance, 0, 0, 0.01))
                rows.append((stamp, f'{name}/uwb/n_{number}', messages.RANGE, data))
    return sorted(rows, key=lambda row: row[0])


def test_ranges_of_several_vehicles_place_them_and_become_their_beacons(tmp_path):
    names = ('/veh_0', '/veh_1')
    bag = write(tmp_path / 'bag', ranged(names))
    assert localize(bag, tmp_path / 'out', '--ranges', r'uwb/n_(\d+)',
                    '--range-calibration', 'off', '--seed', '1') == 0
    for vehicle, name in enumerate(names):
        last = poses(tmp_path / 'out', name)[-1]
        np.testing.assert_allclose(last.position[:2], place(last.stamp, vehicle), atol=1.0)
        data = [data for topic, _, data in read(tmp_path / 'out') if topic == f'{name}/beacons']
        assert len(data) == 19
        assert messages.decode_beacons(data[0])[0].sender.tolist() == [[1, 2, 3, 4]]


def test_what_was_learnt_of_the_radio_is_told_at_the_end(tmp_path, capsys):
    bag = write(tmp_path / 'bag', ranged())
    assert localize(bag, tmp_path / 'out', '--ranges', r'uwb/n_(\d+)', '--seed', '1') == 0
    told = capsys.readouterr().out.splitlines()[1]
    number = r'-?\d+\.\d+ \+- \d+\.\d+'
    assert re.fullmatch(rf'range scale {number}, range bias \[m\] {number}', told)


def test_who_has_ranges_but_names_none_is_told_how(tmp_path, capsys):
    bag = write(tmp_path / 'bag', ranged())
    assert refused(capsys, bag, tmp_path / 'out') == (
        f'{bag}: has no topic NAMESPACE/beacons of type sensor_msgs/msg/PointCloud2, but of type '
        'sensor_msgs/msg/Range, /veh_0/uwb/n_1, /veh_0/uwb/n_2, /veh_0/uwb/n_3, /veh_0/uwb/n_4: '
        'name in ranges which to use')


def test_a_pattern_that_matches_nothing_is_named(tmp_path, capsys):
    bag = write(tmp_path / 'bag', [row for row in drive() if 'beacons' not in row[1]])
    assert refused(capsys, bag, tmp_path / 'out', '--ranges', r'/uwb/(\d+)') == (
        f"{bag}: ranges: '/uwb/(\\d+)' matches no topic of sensor_msgs/msg/Range, of which there "
        'is none')


def test_what_only_some_of_the_ranges_need_is_noted(tmp_path, capsys):
    bag = write(tmp_path / 'bag', ranged())
    assert localize(bag, tmp_path / 'out', '--ranges', r'uwb/n_(\d+),/ble', '--references',
                    '9 /robot/pose') == 0
    assert capsys.readouterr().err.splitlines() == [
        "note: ranges: '/ble' matches no topic of sensor_msgs/msg/Range, of which there are "
        '/veh_0/uwb/n_1, /veh_0/uwb/n_2, /veh_0/uwb/n_3, /veh_0/uwb/n_4',
        'note: references: topic /robot/pose of id 9 is not there, must be one of '
        '/veh_0/ground_truth, /veh_0/odom']


def test_beacons_of_strangers_are_ignored_and_noted(bag, tmp_path, capsys):
    assert localize(bag, tmp_path / 'out', '--anchor-allowlist', '1,3-4') == 0
    note, = capsys.readouterr().err.splitlines()
    assert re.fullmatch(
        r'note: ignored beacons and ranges, \d+ of id 2, whom neither anchor_allowlist nor '
        'vehicle_allowlist names', note)


def test_beacons_that_cannot_be_true_are_left_out_and_noted(tmp_path, capsys):
    rows = drive()
    for at, (stamp, topic, kind, _) in enumerate(rows):
        if topic == '/veh_0/beacons':
            heard = scan(stamp, place(stamp))
            heard.range[0, 1] = -1
            rows[at] = stamp, topic, kind, messages.encode_beacons(heard, 'map')[0]
    assert localize(write(tmp_path / 'bag', rows), tmp_path / 'out') == 0
    assert capsys.readouterr().err.splitlines() == [
        'note: left out beacons that cannot be true, 11 of id 2, such as: range -1 of id 2 is not '
        'allowed, must be finite and at least 0, or NaN where not known']
    assert len(poses(tmp_path / 'out')) == 11


def test_a_namespace_without_beacons_is_named(bag, tmp_path, capsys):
    assert refused(capsys, bag, tmp_path / 'out', '--namespace', 'veh_9') == (
        f'{bag}: has no topic /veh_9/beacons')
