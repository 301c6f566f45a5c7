"""Recordings of other people's radios through the localizer, to the accuracy that is promised."""

from functools import cache
import json
from pathlib import Path
import time

import numpy as np
import pytest
from tsmcl_ros import csv_log, messages
from tsmcl_ros.bag import Reader
from tsmcl_ros.config import load_yaml
from tsmcl_ros.evaluation.metrics import nees_band
from tsmcl_ros.evaluation.path_loss import as_parameters, fit_anchors, gather, join
from tsmcl_ros.evaluation.recording import read_runs
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.messages.diagnostics import FAILURE
from tsmcl_ros.scripts import evaluate, import_csv, localize_bag
from tsmcl_ros.world import make_world
import yaml

pytestmark = pytest.mark.accuracy

CONFIG = Path(__file__).parent.parent / 'config'
SETTLING = 5.0  # s, left out at the start of each BLE track


def complaints(bag):
    """Return what a localized bag says of vehicles that it takes for lost, and of suspects."""
    with Reader(bag) as reader:
        diagnoses = [diagnosis for message in reader.messages(['/diagnostics'])
                     for diagnosis in messages.decode_diagnostics(message.data)[1]]
    assert diagnoses
    return [diagnosis.message for diagnosis in diagnoses
            if diagnosis.level == FAILURE or diagnosis.values['suspects']]


# --- a robot mower with ranging radios and odometry ------------------------------------------

@pytest.fixture(scope='module')
def plaza1(shared_data, tmp_path_factory):
    """Return the evaluation of the three command lines that the README shows."""
    folder = tmp_path_factory.mktemp('plaza1')
    bag, out = str(folder / 'plaza1'), str(folder / 'plaza1_out')
    assert import_csv.main([str(shared_data / 'plaza1'), bag]) == 0
    assert localize_bag.main([bag, '--out', out, '--seed', '1']) == 0
    assert evaluate.main([out]) == 0
    document = json.loads((folder / 'plaza1_out_eval' / 'metrics.json').read_text())
    [run] = read_runs(out)
    return document, run.vehicles['veh_0'], run.outages, complaints(out), out


def test_plaza1_is_localized_to_3_m_by_raw_ranges(plaza1):
    document, *_ = plaza1
    assert document['overall']['rmse_m'] <= 3.0
    assert document['overall']['median_m'] <= 1.5


def test_plaza1_is_localized_to_0_6_m_as_its_radio_is_found_out(plaza1):
    document, *_ = plaza1
    assert document['overall']['rmse_m'] <= 0.6


def test_plaza1_tells_what_its_ranges_are_like(plaza1):
    *_, bag = plaza1
    with Reader(bag) as reader:
        *_, last = reader.messages(['/diagnostics'])
    values = messages.decode_diagnostics(last.data)[1][0].values
    assert float(values['range scale'].split(' +- ')[0]) == pytest.approx(1.069, abs=0.01)
    assert float(values['range bias [m]'].split(' +- ')[0]) == pytest.approx(0.03, abs=0.3)


def test_plaza1_has_poses_through_its_outage(plaza1):
    document, track, outages, *_ = plaza1
    assert document['overall']['availability'] > 0.99
    begin, end = max(outages, key=lambda outage: outage[1] - outage[0])
    assert end - begin == pytest.approx(97, abs=1)
    within = (track.truth.stamp > begin) & (track.truth.stamp < end)
    assert within.sum() == 48
    assert track.error[within].max() < 10


def test_plaza1_knows_how_uncertain_an_outage_makes_it(plaza1):
    _, track, outages, *_ = plaza1
    begin, end = max(outages, key=lambda outage: outage[1] - outage[0])
    within = (track.truth.stamp > begin) & (track.truth.stamp < end)
    assert track.spread[within].max() > 3 * track.spread[within][0]
    assert (track.error[within] < 3 * track.spread[within]).all()


def test_plaza1_is_tracked_to_the_end(plaza1):
    _, track, *_ = plaza1
    late = track.truth.stamp > track.end - 600
    assert np.sqrt(np.mean(track.error[late] ** 2)) < 1.5


def test_plaza1_is_never_called_lost_and_nobody_is_suspected(plaza1):
    *_, complaints, _ = plaza1
    assert complaints == []


@pytest.fixture(scope='module')
def without_wheels(shared_data):
    """Return a function that follows the mower without odometry, from 620 s to 1110 s."""
    log = csv_log.read_log(shared_data / 'plaza1')
    epochs = [epoch for epoch in log.epochs(0.5) if 620 < epoch.stamp < 1110]

    @cache
    def follow(predictor):
        localizer = Localizer({'outage_predictor': predictor, 'seed': 1})
        localizer.anchor_map(log.anchors)
        estimates = []
        for epoch in epochs:
            localizer.beacons(0, epoch)
            estimates += localizer.due()
        stamp = np.array([one.stamp for one in estimates])
        truth = np.stack([np.interp(stamp, log.truth.stamp, log.truth.position[:, axis])
                          for axis in range(2)], axis=1)
        off = np.array([one.mean[0] for one in estimates]) - truth
        covariance = np.array([one.covariance[0] for one in estimates])
        nees = np.einsum('ti,tij,tj->t', off, np.linalg.inv(covariance), off)
        return stamp, np.linalg.norm(off, axis=1), nees

    return follow


@pytest.mark.parametrize('predictor', ['velocity', 'grey_ekf'])
def test_plaza1_without_odometry_is_not_led_astray_by_its_last_velocity(
        without_wheels, predictor):
    stamp, forgotten, _ = without_wheels(predictor)
    _, kept, _ = without_wheels('none')
    within = (stamp > 948) & (stamp < 1043)
    assert within.sum() == 48
    assert forgotten[within][-1] < 0.5 * kept[within][-1]
    assert forgotten[within].max() < 40


@pytest.mark.parametrize('predictor', ['velocity', 'grey_ekf'])
def test_plaza1_without_odometry_is_honest_before_during_and_after_the_outage(
        without_wheels, predictor):
    stamp, _, nees = without_wheels(predictor)
    low, high = nees_band(2, 1)  # epochs of one outage are one sample
    for begin, end in ((660, 947), (948, 1043), (1044, 1110)):
        assert low < nees[(stamp > begin) & (stamp < end)].mean() < high


# --- a walked Bluetooth tag ------------------------------------------------------------------

@pytest.fixture(scope='module')
def tracks(shared_data):
    paths = sorted(shared_data.glob('ble_*'))
    assert len(paths) == 5
    return paths


@pytest.fixture(scope='module')
def bags(tracks, tmp_path_factory):
    """Return a function that imports a track."""
    folder = tmp_path_factory.mktemp('ble')

    def imported(track, *options):
        bag = folder / '_'.join([track.name, *options])
        if not bag.exists():
            assert import_csv.main([str(track), str(bag), *options]) == 0
        return bag

    return imported


def rmse(bag, out, settings):
    localize_bag.localize_bag(str(bag), str(out), {**settings, 'seed': 1})
    [run] = read_runs(out, skip=SETTLING)
    return run.overall.rmse_m


KINDS = pytest.mark.parametrize(('config', 'options', 'inflation', 'bound'), [
    ('ble_rssi', (), 1.5, 2.1), ('ble_range_free', ('--threshold', '-72'), 1.0, 2.9)])


@KINDS
def test_the_tag_is_localized_with_one_parameter_file(
        config, options, inflation, bound, tracks, bags, tmp_path):
    settings = load_yaml(CONFIG / f'{config}.yaml')
    errors = [rmse(bags(track, *options), tmp_path / track.name, settings) for track in tracks]
    assert np.mean(errors) <= bound
    # It is where it is believed to be, and no sniffer is a suspect.
    assert [complaints(tmp_path / track.name) for track in tracks] == [[]] * len(tracks)


@KINDS
def test_the_path_losses_hold_for_tracks_that_they_are_not_fitted_to(
        config, options, inflation, bound, tracks, bags, tmp_path):
    samples = {track: gather(csv_log.read_log(track)) for track in tracks}
    errors = []
    for track in tracks:
        pooled, single, _ = fit_anchors(join(samples[one] for one in tracks if one != track))
        fitted = yaml.safe_load(as_parameters(pooled, single, inflation))
        settings = {**load_yaml(CONFIG / f'{config}.yaml'), **fitted['/**']['ros__parameters']}
        errors.append(rmse(bags(track, *options), tmp_path / track.name, settings))
    assert np.mean(errors) <= bound


def test_the_tag_is_localized_better_together_with_what_its_rssi_are_off(tracks, bags, tmp_path):
    """By path losses of four tracks on the fifth; config/ble_rssi.yaml's are fitted to all."""
    samples = {track: gather(csv_log.read_log(track)) for track in tracks}
    errors = {'off': [], 'online': []}
    for track in tracks:
        pooled, single, _ = fit_anchors(join(samples[one] for one in tracks if one != track))
        fitted = yaml.safe_load(as_parameters(pooled, single, 1.5))
        settings = {**load_yaml(CONFIG / 'ble_rssi.yaml'), **fitted['/**']['ros__parameters']}
        for mode, found in errors.items():
            found.append(rmse(bags(track), tmp_path / f'{track.name}_{mode}',
                              {**settings, 'rssi_calibration': mode}))
    assert np.mean(errors['online']) < np.mean(errors['off'])


# --- simulated cars in a city of 3 km ---------------------------------------------------------

def test_40_cars_in_a_city_find_themselves_by_beacons_of_1_km(shared_data):
    trace = shared_data / 'sumo_grid40' / 'fcd40.xml.gz'
    world = make_world(
        {'mobility': 'fcd', 'trace': str(trace), 'vehicles': 40, 'radio_range': 1000.0},
        np.random.default_rng(1))
    localizer = Localizer({**load_yaml(CONFIG / 'range_free.yaml'), 'seed': 1}, 40)
    localizer.anchor_map(world.anchors)
    errors = []
    for _ in range(240):
        epoch = world.step()
        estimate = localizer.epoch(epoch.observation, epoch.odom_position, epoch.odom_yaw)
        errors.append(np.linalg.norm(estimate.mean - epoch.position, axis=1))
    # Cars that wait at traffic lights learn slowly: 5000 particles get no further.
    assert np.median(errors[:20]) > 100
    assert np.median(errors[-20:]) < 20


# --- robots with ultra-wideband radios, in a bag of ROS 2 as it was recorded ------------------

TIERS = ('--params', str(CONFIG / 'tiers.yaml'), '--remap', 'odom:=/cali/turtle01/odom',
         '--remap', 'ground_truth:=/vrpn_client_node/turtlebot1_cap/pose')


@pytest.fixture(scope='module')
def tiers(shared_data, tmp_path_factory):
    """Return the bag that the README's command line makes."""
    out = str(tmp_path_factory.mktemp('tiers') / 'out')
    assert localize_bag.main(
        [str(shared_data / 'tiers_bag'), '--out', out, '--seed', '1', *TIERS]) == 0
    return out


def test_turtlebot1_is_localized_among_others_better_than_its_ranges_err(tiers):
    """They err by 0.2 to 0.45 m all the time, and by as much more as robots shade them."""
    [run] = read_runs(tiers)
    assert run.overall.availability > 0.99
    assert np.sqrt(np.mean(run.error ** 2)) < 0.3
    assert run.anchors.tolist() == [pytest.approx([5.30, 6.18, 0.0])]


def test_turtlebot1_is_never_called_lost_and_nobody_is_suspected(tiers):
    assert complaints(tiers) == []


def test_poses_have_the_stamps_of_the_radios_not_of_the_recording(tiers):
    with Reader(tiers) as reader:
        message = next(reader.messages(['/pose']))
    stamp = messages.decode_pose(message.data).stamp
    assert time.gmtime(stamp)[:2] == (2022, 10)
    assert time.gmtime(message.stamp)[:2] == (2022, 11)


def test_odometry_that_nobody_recorded_is_named(shared_data, tmp_path, capsys):
    options = [word.replace('/cali/turtle01/odom', '/turtle01/odom') for word in TIERS]
    assert localize_bag.main(
        [str(shared_data / 'tiers_bag'), '--out', str(tmp_path / 'out'), *options]) == 0
    assert ('note: /turtle01/odom, which odom is remapped to, has no messages'
            in capsys.readouterr().err.splitlines())


def test_what_cannot_be_used_of_a_bag_is_named_once(shared_data, tmp_path, capsys):
    assert localize_bag.main([
        str(shared_data / 'tiers_bag'), '--out', str(tmp_path / 'out'), *TIERS,
        '--ranges', r'/uwb/tof/n_7/n_(\d+)/distance']) == 0
    notes = capsys.readouterr().err.splitlines()
    assert sorted(note.split(',')[0] for note in notes) == [
        'note: header stamps are 4160411.0 s before the time of recording or arrival: epochs and '
        'poses go by the header stamps',
        'note: left out ranges',
        'note: skipped what is of type depthai_ros_msgs/msg/SpatialDetectionArray']
