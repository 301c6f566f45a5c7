"""CSV logs: what is read, how it is gathered, and how what is wrong is named."""

import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tsmcl_ros.csv_log import read_log
from tsmcl_ros.types import LogError

ANCHORS = 'id,x,y,z\n3,1.5,-2.5,2.0\n1,10,20,\n'
BEACONS = 't,anchor,range,rssi\n0.1,1,5.5,\n0.2,3,,-70\n0.7,1,,\n'


def log_folder(path, anchors=ANCHORS, beacons=BEACONS, odometry=None, truth=None):
    texts = {'anchors': anchors, 'beacons': beacons, 'odometry': odometry, 'truth': truth}
    for name, text in texts.items():
        if text is not None:
            (path / f'{name}.csv').write_text(text)
    return path


def test_anchors_are_one_scan_in_order_of_id(tmp_path):
    anchors = read_log(log_folder(tmp_path)).anchors
    assert anchors.stamp == 0.1
    assert anchors.sender.tolist() == [[1, 3]]
    assert anchors.position.tolist() == [[[10, 20, 0], [1.5, -2.5, 2]]]
    assert not anchors.covariance.any()


def test_empty_cells_of_beacons_are_unknown(tmp_path):
    log = read_log(log_folder(tmp_path))
    np.testing.assert_array_equal(log.stamp, [0.1, 0.2, 0.7])
    np.testing.assert_array_equal(log.sender, [1, 3, 1])
    np.testing.assert_array_equal(log.range, [5.5, np.nan, np.nan])
    np.testing.assert_array_equal(log.rssi, [np.nan, -70, np.nan])
    assert log.odometry is None
    assert log.truth is None
    assert log.notes == ()


def test_poses_are_read_with_unknown_height_zero_and_unknown_yaw_nan(tmp_path):
    log = read_log(log_folder(
        tmp_path, odometry='t,x,y,yaw\n0,1,2,0.5\n0.5,3,4,0.6\n',
        truth='t,x,y,z,yaw\n0.05,1,2,3,0.5\n1,4,5,,\n'))
    np.testing.assert_array_equal(log.odometry.position, [[1, 2, 0], [3, 4, 0]])
    np.testing.assert_array_equal(log.odometry.yaw, [0.5, 0.6])
    np.testing.assert_array_equal(log.truth.stamp, [0.05, 1])
    np.testing.assert_array_equal(log.truth.position, [[1, 2, 3], [4, 5, 0]])
    np.testing.assert_array_equal(log.truth.yaw, [0.5, np.nan])
    assert log.anchors.stamp == 0.0


def test_columns_may_stand_in_any_order_among_others_and_cells_be_spaced(tmp_path):
    log = read_log(log_folder(
        tmp_path, anchors='\ufeffz, y,x ,name,id\r\n2,-2.5, 1.5,hall, 3\r\n\r\n',
        beacons='rssi,anchor,range,t\n-70,3,1,0.5\n'))
    assert log.anchors.position.tolist() == [[[1.5, -2.5, 2]]]
    assert (log.stamp[0], log.sender[0], log.range[0], log.rssi[0]) == (0.5, 3, 1, -70)


def test_beacons_logged_late_are_put_into_order_and_noted(tmp_path):
    log = read_log(log_folder(
        tmp_path, beacons='t,anchor,range,rssi\n1,1,10,\n2,1,20,\n0.5,3,5,\n1.5,1,15,\n1,3,11,\n'))
    np.testing.assert_array_equal(log.stamp, [0.5, 1, 1, 1.5, 2])
    np.testing.assert_array_equal(log.range, [5, 10, 11, 15, 20])
    note, = log.notes
    assert note.endswith('beacons.csv: put into order of time, which goes back in line 4, 6')


def test_beacons_with_an_impossible_rssi_are_left_out_and_noted(tmp_path):
    rows = ''.join(f'{t},1,,{42 if t % 2 else -60}\n' for t in range(14))
    log = read_log(log_folder(tmp_path, beacons=f't,anchor,range,rssi\n{rows}20,1,,0\n'))
    np.testing.assert_array_equal(log.stamp, [0, 2, 4, 6, 8, 10, 12])
    note, = log.notes
    assert note.endswith('rssi of 0 dBm or more, in line 3, 5, 7, 9, 11 and 3 more')


def test_a_range_free_log_knows_only_who_was_heard(tmp_path):
    log = read_log(log_folder(
        tmp_path, beacons='t,anchor,range,rssi\n0,1,5,-72\n1,3,6,-72.5\n2,3,,-50\n3,1,,\n'))
    free = log.range_free(-72)
    np.testing.assert_array_equal(free.stamp, [0, 2])
    np.testing.assert_array_equal(free.sender, [1, 3])
    assert np.isnan(free.range).all()
    assert np.isnan(free.rssi).all()
    np.testing.assert_array_equal(free.anchors.sender, log.anchors.sender)


@pytest.mark.parametrize(('rssi', 'error'), [
    ('-80', 'no beacon has an rssi of at least -72 dBm: the strongest has -80 dBm'),
    ('', 'no beacon has an rssi of at least -72 dBm: none has an rssi'),
])
def test_a_threshold_that_nothing_reaches_is_an_error(tmp_path, rssi, error):
    log = read_log(log_folder(tmp_path, beacons=f't,anchor,range,rssi\n0,1,5,{rssi}\n'))
    with pytest.raises(LogError, match=error):
        log.range_free(-72)


def test_an_epoch_is_what_was_heard_in_it_stamped_with_its_last_beacon(tmp_path):
    log = read_log(log_folder(
        tmp_path,
        beacons='t,anchor,range,rssi\n0.1,1,5,\n0.4,3,7,\n0.5,3,8,\n1.9,1,9,\n2.0,1,9.5,\n'))
    scans = list(log.epochs(0.5))
    assert [scan.stamp for scan in scans] == [0.4, 0.5, 1.9, 2.0]
    assert [scan.sender[0].tolist() for scan in scans] == [[1, 3], [3], [1], [1]]
    assert [scan.range[0].tolist() for scan in scans] == [[5, 7], [8], [9], [9.5]]
    assert scans[0].position.tolist() == [[[10, 20, 0], [1.5, -2.5, 2]]]
    assert all(np.isnan(scan.max_range).all() and scan.kind.max() == 0 and scan.hops.min() == 1
               for scan in scans)


def test_of_repeated_beacons_the_rssi_is_averaged_and_the_last_range_taken(tmp_path):
    log = read_log(log_folder(
        tmp_path, beacons='t,anchor,range,rssi\n0,1,5,-70\n0.1,3,1,\n0.2,1,6,-73\n0.3,1,,-76\n'))
    scan, = log.epochs(0.5)
    assert scan.sender.tolist() == [[1, 3]]
    assert scan.range.tolist() == [[6, 1]]
    assert scan.rssi[0, 0] == -73
    assert math.isnan(scan.rssi[0, 1])


@settings(max_examples=30)
@given(period=st.sampled_from([0.1, 0.2, 0.3, 0.5, 0.7, 1.0]), count=st.integers(1, 300))
def test_a_beacon_at_the_beginning_of_a_period_belongs_to_it(tmp_path_factory, period, count):
    rows = ''.join(f'{k * period:.4f},1,1,\n' for k in range(count))
    folder = tmp_path_factory.mktemp('log')
    log = read_log(log_folder(folder, beacons=f't,anchor,range,rssi\n{rows}'))
    assert len(list(log.epochs(period))) == count


BAD_ROWS = {
    't that is no number': ('beacons', 'x,1,2,-70', "t 'x' is not allowed, must be a number at"),
    't that is empty': ('beacons', ',1,2,-70', "t '' is not allowed, must be a number at least 0"),
    'negative t': ('beacons', '-0.1,1,2,-70', "t '-0.1' is not allowed, must be a number at"),
    't beyond stamps': ('beacons', '2147483648,1,2,-70', 'must be .* at most 2147483647'),
    't that is NaN': ('beacons', 'nan,1,2,-70', "t 'nan' is not allowed"),
    'unknown anchor': ('beacons', '1,7,2,-70', 'anchor 7 is not in anchors.csv, must be one of'),
    'anchor that is no number': ('beacons', '1,a,2,-70', "anchor 'a' .* must be a whole number"),
    'broken anchor': ('beacons', '1,1.5,2,-70', "anchor '1.5' is not allowed"),
    'empty anchor': ('beacons', '1,,2,-70', "anchor '' is not allowed"),
    'negative range': ('beacons', '1,1,-2,', "range '-2' is not allowed, must be a number at least"
                                             ' 0 and at most 1000000, or empty where unknown'),
    'range beyond all sense': ('beacons', '1,1,1e39,', "range '1e39' is not allowed"),
    'rssi beyond all sense': ('beacons', '1,1,,-1e39', "rssi '-1e39' is not allowed"),
    'infinite range': ('beacons', '1,1,inf,', "range 'inf' is not allowed"),
    'rssi that is no number': ('beacons', '1,1,,weak', "rssi 'weak' is not allowed, must be a"),
    'number with an underscore': ('beacons', '1,1,1_0,', "range '1_0' is not allowed"),
    'too few cells': ('beacons', '1,1,2', 'has 3 cells, must have 4: t,anchor,range,rssi'),
    'too many cells': ('beacons', '1,1,2,-70,5', 'has 5 cells, must have 4'),
    'negative id': ('anchors', '-1,0,0,0', "id '-1' .* must be a whole number at least 0 and at"),
    'id beyond 32 bits': ('anchors', '4294967296,0,0,0', 'at most 4294967295'),
    'id that comes twice': ('anchors', '3,0,0,0', 'id 3 is claimed by two anchors, the other is '
                            'in line 2'),
    'position that is empty': ('anchors', '5,,0,0', "x '' is not allowed"),
    'position beyond 100 km': ('anchors', '5,456789,0,0', "x '456789' is not allowed, must be a nu"
                               'mber at least -100000 and at most 1000'),
    'yaw that is empty': ('odometry', '9,0,0,', "yaw '' is not allowed, must be a number"),
    'odometry that goes back': ('odometry', '0.5,0,0,0', 't 0.5 goes back, must be at least 1 as'),
    'truth that goes back': ('truth', '0.5,0,0,0,0', 't 0.5 goes back, must be at least 1 as in'),
    'truth that is no number': ('truth', '2,0,north,0,0', "y 'north' is not allowed"),
}


@pytest.mark.parametrize('what', BAD_ROWS)
def test_a_bad_row_is_named_by_file_and_line(tmp_path, what):
    name, row, error = BAD_ROWS[what]
    texts = {'anchors': ANCHORS, 'beacons': BEACONS, 'odometry': 't,x,y,yaw\n1,0,0,0\n',
             'truth': 't,x,y,z,yaw\n1,0,0,0,0\n'}
    line = texts[name].count('\n') + 1
    texts[name] += row + '\n'
    with pytest.raises(LogError, match=f'^{tmp_path}/{name}.csv:{line}: .*{error}'):
        read_log(log_folder(tmp_path, **texts))


def test_blank_lines_do_not_shift_the_line_of_an_error(tmp_path):
    with pytest.raises(LogError, match='beacons.csv:4: t'):
        read_log(log_folder(tmp_path, beacons='t,anchor,range,rssi\n\n1,1,2,\nx,1,2,\n'))


@pytest.mark.parametrize(('files', 'error'), [
    ({'anchors': None}, 'anchors.csv: cannot be read: No such file'),
    ({'beacons': None}, 'beacons.csv: cannot be read: No such file'),
    ({'anchors': ''}, 'anchors.csv:1: columns id, x, y, z are missing, must have id,x,y,z'),
    ({'beacons': 't,anchor,rssi\n'}, 'beacons.csv:1: columns range are missing, must have t,a'),
    ({'beacons': 't,anchor,range,rssi\n'}, 'beacons.csv: holds no rows below its header'),
    ({'beacons': 't,anchor,range,rssi\n1,1,,5\n'}, 'beacons.csv: holds no beacons'),
    ({'truth': 't,x,y,z,yaw\n'}, 'truth.csv: holds no rows below its header'),
])
def test_what_is_no_log_is_refused(tmp_path, files, error):
    with pytest.raises(LogError, match=error):
        read_log(log_folder(tmp_path, **files))


def test_a_file_that_is_no_text_is_refused(tmp_path):
    log_folder(tmp_path)
    (tmp_path / 'beacons.csv').write_bytes(b't,anchor,range,rssi\n\xff\xfe,1,,\n')
    with pytest.raises(LogError, match='beacons.csv: is not a CSV file in UTF-8'):
        read_log(tmp_path)


def test_what_is_no_folder_is_refused(tmp_path):
    with pytest.raises(LogError, match='none: there is no such folder, a CSV log is one with'):
        read_log(tmp_path / 'none')
    (tmp_path / 'file').write_text('')
    with pytest.raises(LogError, match='file: is no folder'):
        read_log(tmp_path / 'file')


@given(st.text('0123456789,.-+eEnaif_"\n\r\0 ', max_size=60))
def test_arbitrary_rows_raise_a_log_error_at_most(tmp_path_factory, text):
    folder = tmp_path_factory.getbasetemp() / 'arbitrary'
    folder.mkdir(exist_ok=True)
    log_folder(folder, beacons='t,anchor,range,rssi\n1,1,2,-70\n' + text)
    try:
        list(read_log(folder).epochs(0.5))
    except LogError as error:
        assert '\n' not in str(error)


def test_an_id_beyond_all_floats_is_refused(tmp_path):
    folder = log_folder(tmp_path, anchors=f'id,x,y,z\n{"9" * 400},0,0,0\n')
    with pytest.raises(LogError, match=r"anchors.csv:2: id '9+' is not allowed, must be a whole"):
        read_log(folder)
