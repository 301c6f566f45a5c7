"""Importing real and bad logs, as a user does."""

import filecmp

import numpy as np
import pytest
from tsmcl_ros import messages
from tsmcl_ros.bag import Reader
from tsmcl_ros.scripts.import_csv import main


@pytest.fixture
def log(tmp_path):
    """Make a small log with everything in it."""
    folder = tmp_path / 'log'
    folder.mkdir()
    texts = {
        'anchors': 'id,x,y,z\n1,0,0,\n2,10,0,\n',
        'beacons': 't,anchor,range,rssi\n0.1,1,5,-60\n0.4,2,6,-80\n0.6,1,5,-62\n',
        'odometry': 't,x,y,yaw\n0,0,0,0\n0.4,1,0,0.1\n',
        'truth': 't,x,y,z,yaw\n0.2,3,4,,\n0.5,4,4,,\n'}
    for name, text in texts.items():
        (folder / f'{name}.csv').write_text(text)
    return folder


def read(path):
    with Reader(path) as reader:
        return list(reader.messages())


def test_messages_come_in_order_of_time_the_anchor_map_first(log, tmp_path):
    assert main([str(log), str(tmp_path / 'bag')]) == 0
    assert [(one.topic, one.stamp) for one in read(tmp_path / 'bag')] == [
        ('/anchor_map', 0.0), ('/veh_0/odom', 0.0), ('/veh_0/ground_truth', 0.2),
        ('/veh_0/odom', 0.4), ('/veh_0/beacons', 0.4), ('/veh_0/ground_truth', 0.5),
        ('/veh_0/beacons', 0.6)]
    with Reader(tmp_path / 'bag') as reader:
        assert reader.latched == {'/anchor_map'}
        assert reader.topics == {
            '/anchor_map': messages.POINT_CLOUD, '/veh_0/beacons': messages.POINT_CLOUD,
            '/veh_0/odom': messages.ODOMETRY, '/veh_0/ground_truth': messages.ODOMETRY}


def test_log_times_are_the_stamps_of_the_messages(log, tmp_path):
    main([str(log), str(tmp_path / 'bag')])
    for one in read(tmp_path / 'bag'):
        if one.type == messages.POINT_CLOUD:
            scan, frame_id = messages.decode_beacons(one.data)
            assert (scan.stamp, frame_id) == (one.stamp, 'map')
        else:
            assert messages.decode_odometry(one.data).stamp == one.stamp


def test_one_line_tells_what_was_imported(log, tmp_path, capsys):
    main([str(log), str(tmp_path / 'bag')])
    assert capsys.readouterr().out == (
        f'{tmp_path}/bag: 2 anchors, 3 beacons in 2 epochs, 2 poses of odometry, '
        '2 poses of ground truth\n')


def test_the_bag_says_by_which_command_it_was_made(log, tmp_path):
    main([str(log), str(tmp_path / 'bag'), '--epoch', '1'])
    with Reader(tmp_path / 'bag') as reader:
        assert reader.about == {'command': f'import_csv {log} {tmp_path / "bag"} --epoch 1'}


def test_options_choose_epoch_storage_and_vehicle(log, tmp_path, capsys):
    main([str(log), str(tmp_path / 'bag'), '--epoch', '0.2', '--storage', 'sqlite3', '--id', '7'])
    assert '3 beacons in 3 epochs' in capsys.readouterr().out
    assert (tmp_path / 'bag' / 'bag.db3').exists()
    with Reader(tmp_path / 'bag') as reader:
        assert {topic.rpartition('/')[0] for topic in reader.topics} == {'', '/veh_7'}


def test_a_threshold_makes_the_bag_range_free(log, tmp_path):
    main([str(log), str(tmp_path / 'bag'), '--threshold', '-72'])
    scans = [messages.decode_beacons(one.data)[0] for one in read(tmp_path / 'bag')
             if one.topic == '/veh_0/beacons']
    assert [scan.sender.tolist() for scan in scans] == [[[1]], [[1]]]
    assert all(np.isnan(scan.rssi).all() and np.isnan(scan.range).all() for scan in scans)


def test_an_unknown_yaw_stays_unknown(log, tmp_path):
    main([str(log), str(tmp_path / 'bag')])
    truth = messages.decode_odometries(
        [one.data for one in read(tmp_path / 'bag') if one.topic == '/veh_0/ground_truth'])
    assert np.isnan(truth.yaw).all()
    np.testing.assert_array_equal(truth.position, [[3, 4, 0], [4, 4, 0]])


def test_a_bad_row_is_one_line_and_exit_code_1_and_leaves_no_bag(log, tmp_path, capsys):
    with (log / 'beacons.csv').open('a') as file:
        file.write('0.7,1,-5,\n')
    assert main([str(log), str(tmp_path / 'bag')]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"error: {log}/beacons.csv:5: range '-5' is not allowed")
    assert error.count('\n') == 1
    assert not (tmp_path / 'bag').exists()


def test_a_bag_that_exists_is_left_alone(log, tmp_path, capsys):
    (tmp_path / 'bag').mkdir()
    assert main([str(log), str(tmp_path / 'bag')]) == 1
    assert capsys.readouterr().err == (
        f'error: {tmp_path}/bag: exists already, bags are never overwritten\n')
    assert not list((tmp_path / 'bag').iterdir())


@pytest.mark.parametrize('arguments', [
    [], ['log'], ['log', 'bag', '--epoch', '0'], ['log', 'bag', '--epoch', 'x'],
    ['log', 'bag', '--threshold', 'nan'], ['log', 'bag', '--storage', 'db3'],
    ['log', 'bag', '--id', '-1'], ['log', 'bag', '--nonsense']])
def test_wrong_usage_is_exit_code_2(arguments, capsys):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert 'usage: import_csv' in capsys.readouterr().err


def test_the_same_log_gives_the_same_bag(log, tmp_path, monkeypatch):
    for name in ('a', 'b'):
        (tmp_path / name).mkdir()
        # The command that made it is part of the bag.
        monkeypatch.chdir(tmp_path / name)
        main([str(log), 'bag'])
    assert filecmp.cmp(tmp_path / 'a/bag/bag.mcap', tmp_path / 'b/bag/bag.mcap', shallow=False)


def test_plaza1_is_imported_as_written(run, shared_data, tmp_path):
    code, output = run('scripts.import_csv', shared_data / 'plaza1', 'out/plaza1')
    assert code == 0, output
    note, summary = output.splitlines()
    assert note.endswith('beacons.csv: put into order of time, which goes back in line 1990, 2868')
    assert summary == ('out/plaza1: 4 anchors, 3529 beacons in 1962 epochs, 9657 poses of '
                       'odometry, 9658 poses of ground truth')
    found = read(tmp_path / 'out' / 'plaza1')
    anchors, frame_id = messages.decode_beacons(found[0].data)
    assert (found[0].topic, frame_id) == ('/anchor_map', 'map')
    assert anchors.sender.tolist() == [[0, 1, 5, 6]]
    stamps = [one.stamp for one in found]
    assert stamps == sorted(stamps)
    scans = [messages.decode_beacons(one.data)[0] for one in found if 'beacons' in one.topic]
    assert np.diff([scan.stamp for scan in scans]).max() == pytest.approx(97, abs=1)  # the outage
    truth = messages.decode_odometries([one.data for one in found if 'truth' in one.topic])
    rows = np.loadtxt(shared_data / 'plaza1' / 'truth.csv', delimiter=',', skiprows=1,
                      usecols=(0, 1, 2, 4))
    np.testing.assert_array_equal(truth.stamp, rows[:, 0])
    np.testing.assert_array_equal(truth.position[:, :2], rows[:, 1:3])
    np.testing.assert_allclose(np.exp(1j * truth.yaw), np.exp(1j * rows[:, 3]), atol=1e-12)


def test_the_ble_tracks_are_imported_with_and_without_rssi(shared_data, tmp_path, capsys):
    tracks = sorted(shared_data.glob('ble_*'))
    assert len(tracks) == 5
    for track in tracks:
        assert main([str(track), str(tmp_path / track.name)]) == 0
        assert main([str(track), str(tmp_path / 'free' / track.name), '--threshold', '-72']) == 0
        scans = [messages.decode_beacons(one.data)[0] for one in read(tmp_path / track.name)
                 if one.topic == '/veh_0/beacons']
        assert all(np.isfinite(scan.rssi).all() for scan in scans)
        assert np.mean([scan.sender.size for scan in scans]) > 8
    assert '12 anchors' in capsys.readouterr().out
