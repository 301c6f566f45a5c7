"""Fitting path losses from the command line."""

from pathlib import Path

import numpy as np
import pytest
from tsmcl_ros.config import load_yaml
from tsmcl_ros.scripts.fit_path_loss import main

CONFIG = Path(__file__).parent.parent.parent / 'config'
KEYS = ('rssi_at_reference', 'path_loss_exponent', 'sigma_db', 'anchor_path_loss')


def write_log(folder, truth=True, rssi=True):
    """Make a log of a walk past two anchors, the second of which is heard three times."""
    folder.mkdir()
    rng = np.random.default_rng(1)
    stamp = np.linspace(0, 50, 300)
    power = -50 - 20 * np.log10(np.hypot(stamp, 3)) + rng.normal(0, 3, 300)
    power[-3:] = -80
    sender = np.ones(300, int)
    sender[-3:] = 2
    (folder / 'anchors.csv').write_text('id,x,y,z\n1,0,3,2\n2,50,3,2\n')
    (folder / 'beacons.csv').write_text('t,anchor,range,rssi\n' + ''.join(
        f'{t:.3f},{one},,{f"{p:.0f}" if rssi else ""}\n'
        for t, one, p in zip(stamp, sender, power, strict=True)))
    if truth:
        (folder / 'truth.csv').write_text('t,x,y,z,yaw\n0,0,0,,\n50,50,0,,\n')
    return str(folder)


def test_parameters_are_printed_with_the_command_that_made_them(tmp_path, capsys):
    log = write_log(tmp_path / 'log')
    assert main([log, '--inflate', '2']) == 0
    out = capsys.readouterr().out
    assert out.startswith('# Path losses fitted to 300 beacons of 2 anchors, P_0 at 1 m:\n'
                          f'#     fit_path_loss {log} --inflate 2\n/**:\n')
    assert "\n    - '1 -" in out


def test_an_anchor_with_too_few_beacons_is_named(tmp_path, capsys):
    main([write_log(tmp_path / 'log')])
    out, err = capsys.readouterr()
    assert err == ('note: anchor 2 has the path loss of all together: 3 beacons are too few, '
                   'must be at least 20\n')
    assert "- '2 " not in out


def test_inflation_multiplies_each_sigma_and_nothing_else(tmp_path):
    log = write_log(tmp_path / 'log')
    main([log, '--out', str(tmp_path / 'plain')])
    main([log, '--inflate', '2', '--out', str(tmp_path / 'inflated')])
    one, two = load_yaml(tmp_path / 'plain'), load_yaml(tmp_path / 'inflated')
    assert two['sigma_db'] == pytest.approx(2 * one['sigma_db'], abs=0.1)
    assert {**two, 'sigma_db': 0, 'anchor_path_loss': 0} == {
        **one, 'sigma_db': 0, 'anchor_path_loss': 0}
    *head, sigma = two['anchor_path_loss'][0].split()
    *head_of_one, sigma_of_one = one['anchor_path_loss'][0].split()
    assert head == head_of_one
    assert float(sigma) == pytest.approx(2 * float(sigma_of_one), abs=0.1)


def test_parameters_can_be_written_to_a_file(tmp_path, capsys):
    path = tmp_path / 'radio.yaml'
    assert main([write_log(tmp_path / 'log'), '--out', str(path)]) == 0
    assert capsys.readouterr().out == (
        f'{path}: the path loss of all anchors, and 1 of single ones\n')
    assert load_yaml(path)['radio_model'] == 'lognormal'


def test_a_file_that_exists_is_left_alone(tmp_path, capsys):
    path = tmp_path / 'radio.yaml'
    path.write_text('mine')
    assert main([write_log(tmp_path / 'log'), '--out', str(path)]) == 1
    assert f'error: {path}: File exists\n' in capsys.readouterr().err
    assert path.read_text() == 'mine'


@pytest.mark.parametrize(('content', 'reason'), [
    ({'truth': False}, 'has no truth.csv, which tells the distances to fit to'),
    ({'rssi': False}, 'has no beacon with an rssi within the time of the truth')])
def test_a_log_that_cannot_be_fitted_to_is_named(content, reason, tmp_path, capsys):
    good, bad = write_log(tmp_path / 'good'), write_log(tmp_path / 'bad', **content)
    assert main([good, bad]) == 1
    assert capsys.readouterr().err == f'error: {bad}: {reason}\n'


def test_a_missing_log_is_named(tmp_path, capsys):
    assert main([str(tmp_path / 'none')]) == 1
    assert capsys.readouterr().err.startswith(f'error: {tmp_path}/none: there is no such folder')


@pytest.mark.parametrize('arguments', [
    [], ['log', '--inflate', '0'], ['log', '--inflate', 'x'], ['log', '--min-distance', 'nan'],
    ['log', '--nonsense']])
def test_wrong_usage_is_exit_code_2(arguments, capsys):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert 'usage: fit_path_loss' in capsys.readouterr().err


@pytest.mark.parametrize(('config', 'options'), [
    ('ble_rssi', ['--inflate', '1.5']), ('ble_range_free', [])])
def test_the_parameter_files_of_the_ble_radios_hold_what_is_fitted(
        config, options, shared_data, tmp_path):
    logs = sorted(map(str, shared_data.glob('ble_*')))
    assert len(logs) == 5
    assert main([*logs, *options, '--out', str(tmp_path / 'radio.yaml')]) == 0
    fitted, shipped = load_yaml(tmp_path / 'radio.yaml'), load_yaml(CONFIG / f'{config}.yaml')
    assert len(fitted['anchor_path_loss']) == 12
    assert {key: shipped[key] for key in KEYS} == {key: fitted[key] for key in KEYS}
