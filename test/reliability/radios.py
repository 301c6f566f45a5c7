"""
What real radios are like, found out while running: recordings, and simulated ones that are worse.

Recordings are read from ../shared/data; where there are none, the section says so.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import redirect_stderr, redirect_stdout
import io
import math
import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from goals import Goal, Section
import numpy as np
from tsmcl_ros.config import load_yaml
from tsmcl_ros.csv_log import CsvLog, read_log
from tsmcl_ros.evaluation.path_loss import as_parameters, fit_anchors, gather, join
from tsmcl_ros.evaluation.recording import read_runs
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.scripts import import_csv
from tsmcl_ros.scripts.localize_bag import localize_bag
from tsmcl_ros.world import make_world
import yaml

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get('TSMCL_SHARED_DATA') or ROOT.parent / 'shared' / 'data')
SEEDS = (11, 12)
TAG_SEEDS = tuple(range(10, 18))
RANGES = {'measure_range': True, 'range_std': 1.0, 'radio_range': 1500.0, 'odom_heading': 'known'}
RSSI = {'radio_model': 'lognormal', 'rssi_at_reference': -40.0, 'path_loss_exponent': 2.5,
        'sigma_db': 4.0, 'sensitivity': -120.0, 'measure_rssi': True, 'odom_heading': 'known'}
TIERS = ('odom:=/cali/turtle01/odom', 'ground_truth:=/vrpn_client_node/turtlebot1_cap/pose')
Row = list[str]


def measure() -> Section:
    """Localize by radios whose figures are wrong at first."""
    tables, goals = [], []
    if DATA.is_dir():
        with TemporaryDirectory() as folder:
            for part in (_mower, _tag, _robot):
                rows, found = part(Path(folder))
                tables.append(rows)
                goals += found
    for part in (_simulated_ranges, _simulated_rssi):
        rows, found = part()
        tables.append(rows)
        goals += found
    return Section(
        'Real radios',
        'What is told of a radio is off: scale and offset of ranges, P_0 and n of path losses. '
        f'Seeds {", ".join(map(str, SEEDS))}; estimates are +- one standard deviation. That of '
        f'differences is their standard error over the seeds {TAG_SEEDS[0]} to {TAG_SEEDS[-1]}. '
        'Nothing but the fits by truth that stand beside them looks at the truth. The path losses '
        'of the Bluetooth tag are those of config/ble_rssi.yaml, those fitted to the four other '
        'tracks, or one for all sniffers, of which each may be off for long.',
        tables, goals)


def _mower(folder: Path) -> tuple[list[Row], list[Goal]]:
    log = read_log(DATA / 'plaza1')
    scale, bias = _fitted(log)
    bag = _imported(DATA / 'plaza1', folder)
    rows, errors = [['plaza1, raw ranges', 'RMSE', 'range scale', 'range bias [m]'],
                    ['fit by truth', '', f'{scale:.4f}', f'{bias:.3f}']], []
    for seed in SEEDS:
        error, told = _run(bag, {'seed': seed}, folder)
        errors.append(error)
        rows.append([f'seed {seed}', f'{error:.2f} m', *told.values()])
    return rows, [Goal('plaza1, raw ranges: RMSE of the worst seed', max(errors), 0.6, unit='m')]


def _fitted(log: CsvLog) -> tuple[float, float]:
    """Return scale and offset that fit a log's ranges best, robustly, given its truth."""
    assert log.truth is not None
    stamp, path = log.truth.stamp, log.truth.position
    here = np.stack([np.interp(log.stamp, stamp, path[:, axis]) for axis in (0, 1)], axis=1)
    index = np.searchsorted(log.anchors.sender[0], log.sender)
    distance = np.linalg.norm(here - log.anchors.position[0, index, :2], axis=1)
    sound = np.isfinite(log.range)
    for _ in range(5):
        scale, bias = np.polyfit(distance[sound], log.range[sound], 1)
        off = np.abs(log.range - scale * distance - bias)
        sound = np.isfinite(log.range) & (off < 3 * 1.4826 * np.median(off[sound]))
    return float(scale), float(bias)


def _tag(folder: Path) -> tuple[list[Row], list[Goal]]:
    tracks = sorted(DATA.glob('ble_*'))
    bags = {track: _imported(track, folder) for track in tracks}
    samples = {track: gather(read_log(track)) for track in tracks}
    config = load_yaml(ROOT / 'config' / 'ble_rssi.yaml')

    def others(track: Path, is_pooled: bool) -> dict[str, Any]:
        pooled, single, _ = fit_anchors(join(samples[one] for one in tracks if one != track))
        fitted = yaml.safe_load(as_parameters(pooled, {} if is_pooled else single, 1.5))
        found = {**config, 'anchor_path_loss': (), **fitted['/**']['ros__parameters']}
        return {**found, 'anchor_rssi_time': 1000.0} if is_pooled else found

    rows, goals = [['Bluetooth tag, path losses', 'fixed', 'online', 'difference']], []
    for name, settings in {
        'of config/ble_rssi.yaml': dict.fromkeys(tracks, config),
        'of the other tracks': {track: others(track, False) for track in tracks},
        'of the other tracks, one for all sniffers': {
            track: others(track, True) for track in tracks},
    }.items():
        fixed, online = (np.array([np.mean([
            _run(bags[track], {**settings[track], 'rssi_calibration': mode, 'seed': seed}, folder,
                 5.0)[0] for track in tracks]) for seed in TAG_SEEDS])
            for mode in ('off', 'online'))
        less = online - fixed
        error = float(less.std(ddof=1)) / math.sqrt(len(less))
        rows.append([name, f'{fixed.mean():.3f} m', f'{online.mean():.3f} m',
                     f'{less.mean():+.3f} +- {error:.3f} m'])
        goals.append(Goal(
            f'Bluetooth tag, path losses {name}: difference of mean RMSE and two of its standard '
            'errors', float(less.mean()) + 2 * error, 0.0, unit='m'))
    return rows, goals


def _robot(folder: Path) -> tuple[list[Row], list[Goal]]:
    config = load_yaml(ROOT / 'config' / 'tiers.yaml')
    rows, errors = [['TIERS', 'RMSE', 'range scale', 'range bias [m]']], []
    for seed in SEEDS:
        for name, settings in {
            'as in config/tiers.yaml': {},
            'range_bias 0, off': {'range_bias': 0.0},
            'range_bias 0, online': {'range_bias': 0.0, 'range_calibration': 'online'},
        }.items():
            error, told = _run(
                DATA / 'tiers_bag', {**config, **settings, 'seed': seed}, folder, remap=TIERS)
            rows.append([f'{name}, seed {seed}', f'{error:.2f} m',
                         *(told.values() or ('', ''))])
        errors.append(error)
    return rows, [Goal('TIERS, range_bias 0, online: RMSE of the worst seed', max(errors), 0.3,
                       unit='m')]


def _simulated_ranges() -> tuple[list[Row], list[Goal]]:
    rows, ratios = [['4 vehicles, ranges', 'off', 'online', 'known', 'estimated']], []
    for scale, bias in (
            (0.93, 0.0), (1.0, 0.0), (1.1, 0.0), (1.0, 1.0), (0.95, -1.0), (1.07, 1.0)):
        truth = {'range_scale': scale, 'range_bias': bias}
        found = [_simulate({**RANGES, **truth}, {**RANGES, **told, 'range_bias_std': 1.0})
                 for told in ({'range_calibration': 'off'}, {},
                              {**truth, 'range_calibration': 'off'})]
        rows.append(_row(f'scale {scale}, offset {bias} m', found))
        ratios.append(found[1][0] / found[2][0])
    return rows, [Goal('simulated ranges: RMSE over that where scale and offset are known, worst',
                       max(ratios), 1.5)]


def _simulated_rssi() -> tuple[list[Row], list[Goal]]:
    rows, ratios = [['4 vehicles, rssi', 'off', 'online', 'known', 'estimated']], []
    for p_0, n in ((0.0, 0.0), (6.0, 0.0), (-6.0, 0.0), (0.0, 0.5), (0.0, -0.5)):
        wrong = {'rssi_at_reference': -40.0 + p_0, 'path_loss_exponent': 2.5 + n}
        found = [_simulate(RSSI, {**RSSI, **told}) for told in (
            {**wrong, 'rssi_calibration': 'off'}, {**wrong, 'rssi_calibration': 'online'}, {})]
        rows.append(_row(f'P_0 {p_0:+g} dB, n {n:+g}', found))
        if p_0 or n:
            ratios.append(found[1][0] / found[0][0])
    return rows, [Goal('simulated rssi: RMSE over that where they stay wrong, worst',
                       max(ratios), 0.5)]


def _simulate(outside: Mapping[str, Any], inside: Mapping[str, Any]
              ) -> tuple[float, dict[str, str]]:
    """Return the RMSE [m] in the second half of 60 epochs, and what was learnt."""
    world = make_world({**outside, 'vehicles': 4, 'odom_noise': 0.5},
                       np.random.default_rng(SEEDS[0]))
    settings = {name: value for name, value in inside.items() if name != 'measure_range'}
    localizer = Localizer({**settings, 'odom_std': 0.5, 'seed': SEEDS[0]}, 4)
    localizer.anchor_map(world.anchors)
    squared = []
    for _ in range(60):
        epoch = world.step()
        estimate = localizer.epoch(epoch.observation, epoch.odom_position, epoch.odom_yaw)
        squared.append(np.square(estimate.mean - epoch.position).sum(axis=1))
    return (float(np.sqrt(np.nanmean(squared[30:]))),
            localizer.channel.calibrated(untaught=False))


def _row(name: str, found: list[tuple[float, dict[str, str]]]) -> Row:
    return [name, *(f'{error:.1f} m' for error, _ in found), ', '.join(found[1][1].values())]


def _imported(log: Path, folder: Path) -> Path:
    bag = folder / log.name
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        import_csv.main([str(log), str(bag), '--quiet'])
    return bag


def _run(bag: Path, settings: Mapping[str, Any], folder: Path, skip: float = 0.0,
         remap: tuple[str, ...] = ()) -> tuple[float, Mapping[str, str]]:
    """Return the RMSE [m] of a bag, and what was learnt of the radio."""
    own = {name: value for name, value in settings.items() if name != 'global_frame_id'}
    with TemporaryDirectory(dir=folder) as out:
        outcome = localize_bag(f'{bag}', f'{out}/out', own, remap=remap,
                               frame_id=settings.get('global_frame_id', 'map'))
        [run] = read_runs(f'{out}/out', skip=skip)
    return run.overall.rmse_m, outcome.calibrated
