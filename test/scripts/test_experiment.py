"""The experiment script, from the command line to files and exit codes."""

from contextlib import redirect_stdout
import io
import json
import shutil

import pytest
from tsmcl_ros.evaluation.experiments import EXPERIMENTS
from tsmcl_ros.scripts.experiment import main

pytestmark = pytest.mark.accuracy

NAME = 'ts_mcl_convergence'
BRIEF = 'ts_mcl_radius'


@pytest.fixture(scope='module')
def everything(tmp_path_factory):
    """Return the folder of a quick run of all experiments in this process, and what it prints."""
    folder = tmp_path_factory.mktemp('quick') / 'new'
    printed = io.StringIO()
    with redirect_stdout(printed):
        assert main(['all', '--quick', '--quiet', '--workers', '1', '--seed', '4',
                     '--out', str(folder)]) == 0
    return folder, printed.getvalue()


@pytest.fixture
def quick(everything):
    """Return the folder of the quick run."""
    return everything[0]


def test_all_runs_every_experiment_and_writes_their_page(quick):
    assert {path.name for path in quick.iterdir()} == {
        'reproduction.md',
        *(f'{name}.{kind}' for name in EXPERIMENTS for kind in ('csv', 'json', 'png'))}


@pytest.mark.parametrize('name', EXPERIMENTS)
def test_each_experiment_is_judged_drawn_and_shown(name, everything):
    folder, printed = everything
    document = json.loads((folder / f'{name}.json').read_text())
    page = (folder / 'reproduction.md').read_text()

    assert (folder / f'{name}.png').read_bytes().startswith(b'\x89PNG')
    assert len((folder / f'{name}.csv').read_text().splitlines()) > 2
    assert document['findings']
    for finding in document['findings']:
        assert finding['claim'] in page
        assert finding['claim'] in printed
        assert finding['verdict']


def test_the_settings_are_those_given(quick):
    document = json.loads((quick / f'{NAME}.json').read_text())

    assert (document['seed'], document['quick'], document['workers']) == (4, True, 1)
    assert document['runs'] == EXPERIMENTS[NAME][1].runs
    assert document['duration_s'] > 0


def test_two_processes_write_the_same_rows(quick, run, tmp_path):
    code, output = run('scripts.experiment', BRIEF, '--quick', '--seed', 4, '--workers', 2,
                       '--out', tmp_path)

    assert code == 0, output
    assert (tmp_path / f'{BRIEF}.csv').read_bytes() == (quick / f'{BRIEF}.csv').read_bytes()


def test_it_prints_a_table_and_verdicts(everything):
    for text in ('vehicles know', '+ odometry', 'bootstrap', 'exact grid', 'not reproducible',
                 'too small to judge by', f'{NAME}.csv'):
        assert text in everything[1]


def test_the_number_of_runs_can_be_given(tmp_path):
    assert main(['period_factor', '--quick', '--quiet', '--runs', '3', '--workers', '1',
                 '--out', str(tmp_path)]) == 0

    assert json.loads((tmp_path / 'period_factor.json').read_text())['runs'] == 3


@pytest.mark.parametrize('name', ['ts_mcl_time', 'grey_straight', 'coop_time', 'adaptive_track'])
def test_results_can_be_judged_and_drawn_again_without_running_anything(name, quick, tmp_path):
    for kind in ('csv', 'json'):
        shutil.copy(quick / f'{name}.{kind}', tmp_path)
    assert main([name, '--quick', '--again', '--out', str(tmp_path)]) == 0

    new, old = (json.loads((folder / f'{name}.json').read_text()) for folder in (tmp_path, quick))
    assert new == old
    assert (tmp_path / f'{name}.png').read_bytes().startswith(b'\x89PNG')


def test_results_that_are_there_have_their_number_of_runs(capsys, tmp_path):
    with pytest.raises(SystemExit) as stop:
        main([NAME, '--again', '--runs', '2', '--out', str(tmp_path)])
    assert stop.value.code == 2
    assert '--again judges the runs that are there' in capsys.readouterr().err


def test_results_of_full_size_are_not_there_after_a_quick_run(quick, capsys):
    assert main([NAME, '--again', '--out', str(quick)]) == 1
    assert 'was made with other settings' in capsys.readouterr().err


def test_the_page_can_be_written_again_elsewhere_without_running_anything(quick, capsys, tmp_path):
    page = tmp_path / 'docs' / 'claims.md'

    assert main(['report', '--out', str(quick), '--report', str(page)]) == 0
    assert f'## {NAME}' in page.read_text()
    assert str(page) in capsys.readouterr().out


def test_a_page_of_nothing_is_refused(capsys, tmp_path):
    assert main(['report', '--out', str(tmp_path)]) == 1
    assert 'holds no results' in capsys.readouterr().err


def test_the_list_names_every_experiment(capsys):
    assert main(['--list']) == 0

    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(EXPERIMENTS)


@pytest.mark.parametrize('arguments', [['nonsense'], []])
def test_an_unknown_experiment_is_wrong_usage_and_the_known_are_named(capsys, arguments):
    with pytest.raises(SystemExit) as raised:
        main(arguments)

    assert raised.value.code == 2
    assert NAME in capsys.readouterr().err


@pytest.mark.parametrize('option', [['--runs', '0'], ['--workers', 'x'], ['--seed', '-1']])
def test_a_number_that_is_none_is_wrong_usage(capsys, option):
    with pytest.raises(SystemExit) as raised:
        main([NAME, *option])

    assert raised.value.code == 2
    assert f'{option[1]} is not allowed' in capsys.readouterr().err


def test_a_folder_that_cannot_be_written_ends_it_at_once(capsys, tmp_path):
    (tmp_path / 'file').write_text('')

    assert main([NAME, '--out', str(tmp_path / 'file' / 'below')]) == 1

    error = capsys.readouterr().err
    assert error.startswith('error: ') and len(error.splitlines()) == 1
    assert str(tmp_path / 'file') in error
