"""The evaluate script, from bags to files and exit codes."""

import contextlib
import io
import json
import os
from pathlib import Path
import subprocess
import sys
import sysconfig
from typing import Any, NamedTuple

import numpy as np
import pytest
from tsmcl_ros.scripts.evaluate import main, read_all, summarize
from tsmcl_ros.types import BagError, Trajectory

KEYS = {'rmse_m', 'mean_m', 'median_m', 'p95_m', 'max_m', 'nees', 'availability', 'epochs'}


@pytest.fixture(scope='module')
def walk(record, tmp_path_factory):
    """Return a function that records vehicles whose estimates are off by some noise [m]."""

    def walk_one(name, sigma=1.0, vehicles=1):
        rng = np.random.default_rng(vehicles)
        topics = {}
        for index in range(vehicles):
            stamp = 1.77e9 + np.arange(0, 60.1, 0.5)
            path = np.cumsum(rng.normal(0, 1, (len(stamp), 2)), axis=0)
            found = path[::2] + rng.normal(0, sigma, path[::2].shape)
            topics[f'/veh_{index}/ground_truth'] = Trajectory(stamp, path, np.zeros(len(stamp)))
            topics[f'/veh_{index}/pose'] = Trajectory(
                stamp[::2], found, np.full(len(found), np.nan),
                np.tile(sigma**2 * np.eye(2), (len(found), 1, 1)))
        return record(tmp_path_factory.mktemp('bags') / name, topics)

    return walk_one


class Evaluated(NamedTuple):
    """One run of the script: what it printed, where it wrote, and metrics.json."""

    bags: list[Path]
    out: Path
    lines: list[str]
    metrics: dict[str, Any]


def evaluated(bags, out, *options):
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        assert main([*map(str, bags), '--out', str(out), *options]) == 0
    document = json.loads((out / 'metrics.json').read_text())
    return Evaluated(bags, out, printed.getvalue().splitlines(), document)


@pytest.fixture(scope='module')
def one(walk, tmp_path_factory):
    return evaluated([walk('a', vehicles=2)], tmp_path_factory.mktemp('one'), '--skip', '5')


@pytest.fixture(scope='module')
def two(walk, tmp_path_factory):
    return evaluated([walk('a', 1.0), walk('b', 3.0)], tmp_path_factory.mktemp('two'),
                     '--mean', '--label', 'MCL', 'TS-MCL')


def test_one_bags_metrics_json_has_the_agreed_layout(one):
    parts = [one.metrics['overall'], *one.metrics['vehicles'].values()]

    assert set(one.metrics) == {'overall', 'vehicles'}
    assert set(one.metrics['vehicles']) == {'veh_0', 'veh_1'}
    assert [set(part) for part in parts] == [KEYS] * 3


def test_several_bags_metrics_json_holds_each_under_its_label(two):
    assert {name: set(bag) for name, bag in two.metrics['bags'].items()} == {
        'MCL': {'overall', 'vehicles'}, 'TS-MCL': {'overall', 'vehicles'}}


def test_the_mean_is_over_the_bags(two):
    rmse = [bag['overall']['rmse_m'] for bag in two.metrics['bags'].values()]

    assert two.metrics['mean']['rmse_m'] == pytest.approx(np.mean(rmse))


def test_skip_leaves_out_the_first_seconds(one):
    assert one.metrics['vehicles']['veh_0']['epochs'] == 56


def test_metrics_that_are_not_finite_are_null(record, tmp_path):
    stamp, path = np.arange(3.0), np.zeros((3, 2))
    bag = record(tmp_path / 'a', {
        '/ground_truth': Trajectory(stamp, path, stamp),
        '/pose': Trajectory(stamp, path + 1, stamp, np.zeros((3, 2, 2)))})

    assert evaluated([bag], tmp_path / 'out').metrics['overall']['nees'] is None


def test_evo_ape_finds_the_same_rmse_in_the_exported_files(one, tmp_path):
    shown = subprocess.run(
        [Path(sysconfig.get_path('scripts'), 'evo_ape'), 'tum', 'veh_1.truth.tum', 'veh_1.tum'],
        cwd=one.out / 'tum', env={**os.environ, 'HOME': str(tmp_path)},
        capture_output=True, text=True, check=True).stdout

    rmse = next(float(line.split()[1]) for line in shown.splitlines() if 'rmse' in line)
    # evo prints six decimals.
    assert rmse == pytest.approx(one.metrics['vehicles']['veh_1']['rmse_m'], abs=1e-6)


def test_trajectories_of_several_bags_lie_in_a_folder_each(two):
    names = {str(path.relative_to(two.out / 'tum')) for path in two.out.glob('tum/*/*.tum')}

    assert names == {f'{label}/veh_0{kind}.tum'
                     for label in ('MCL', 'TS-MCL') for kind in ('', '.truth')}


def test_the_table_has_a_row_a_bag_and_the_mean(two):
    assert [line.split()[0] for line in two.lines[1:4]] == ['MCL', 'TS-MCL', 'mean']


def test_the_table_holds_what_metrics_json_does(one):
    overall = one.metrics['overall']

    assert one.lines[1].split() == [
        'a', *(f'{overall[name]:.3f}' for name in (
            'rmse_m', 'mean_m', 'median_m', 'p95_m', 'max_m')),
        '100.0', '%', f'{overall["nees"]:.2f}', '112', '2', 'of', '2']


def test_the_last_line_says_where_the_results_are(one):
    assert one.lines[-1].endswith(f' {one.out}')


def test_the_report_shows_the_command(one):
    report = (one.out / 'report.html').read_text('utf-8')

    assert f'evaluate {one.bags[0]} --out {one.out} --skip 5' in report


def test_results_go_beside_the_bag(walk):
    bag = walk('a')

    main([str(bag)])

    folder = bag.parent / 'a_eval'
    assert {path.name for path in folder.iterdir()} == {'metrics.json', 'report.html', 'tum'}


def test_results_of_several_bags_go_beside_the_first(walk):
    bags = [walk('a'), walk('b')]

    main([str(bag) for bag in bags])

    assert (bags[0].parent / 'comparison_eval' / 'metrics.json').is_file()


def test_a_bag_can_be_named_by_the_folder_one_is_in(walk, monkeypatch):
    bag = walk('a')
    monkeypatch.chdir(bag)

    main(['.'])

    assert (bag.parent / 'a_eval' / 'metrics.json').is_file()


def test_a_second_evaluation_leaves_the_bag_and_replaces_the_first(walk):
    bag = walk('a')
    before = {path.name: path.read_bytes() for path in bag.iterdir()}
    first = evaluated([bag], bag.parent / 'out')

    second = evaluated([bag], bag.parent / 'out', '--skip', '30')

    assert (first.metrics['overall']['epochs'], second.metrics['overall']['epochs']) == (61, 31)
    assert {path.name: path.read_bytes() for path in bag.iterdir()} == before


def test_notes_go_to_standard_error(record, tmp_path, capsys):
    stamp, path = np.arange(3.0), np.zeros((3, 2))
    bag = record(tmp_path / 'a', {
        '/a/ground_truth': Trajectory(stamp, path, stamp),
        '/a/pose': Trajectory(stamp, path, stamp, np.tile(np.eye(2), (3, 1, 1))),
        '/b/ground_truth': Trajectory(stamp, path, stamp)})

    main([str(bag)])

    assert capsys.readouterr().err == 'note: a: no pose topic, so not evaluated: b\n'


def test_bags_whose_folders_share_a_name_go_by_their_paths(walk):
    bags = [walk('a'), walk('a')]

    assert [run.label for run in read_all(bags)] == [str(bag) for bag in bags]


def test_labels_that_would_share_files_are_refused(walk):
    with pytest.raises(BagError, match="two runs are called 'x y' and 'x_y': give each bag "
                                       'a --label of its own'):
        read_all([walk('a'), walk('b')], ['x y', 'x_y'])


def test_summarize_returns_the_table_that_evaluate_prints(one):
    assert summarize(one.bags, skip=5.0) == '\n'.join(one.lines[:-1])


@pytest.mark.parametrize('options', [
    [], ['a', '--skip', '-1'], ['a', '--skip', 'nan'], ['a', '--max-age', 'x'],
    ['a', 'b', '--label', 'x'], ['a', '--nonsense'],
])
def test_wrong_usage_exits_with_2(options, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(options)

    assert stopped.value.code == 2


def test_a_users_error_exits_with_1_and_one_line(run, tmp_path):
    code, output = run('scripts.evaluate', tmp_path / 'nowhere')

    assert code == 1
    assert len(output.splitlines()) == 1
    assert 'nowhere' in output


def test_a_folder_that_cannot_be_made_exits_with_1_and_one_line(walk, capsys):
    bag = walk('a')
    (bag.parent / 'taken').write_text('')

    assert main([str(bag), '--out', str(bag.parent / 'taken')]) == 1

    assert capsys.readouterr().err == f'error: {bag.parent / "taken"}: File exists\n'


def test_without_matplotlib_all_but_the_report_is_written(walk):
    bag = walk('a')
    code = ('import sys; sys.modules["matplotlib"] = None\n'
            'from tsmcl_ros.scripts.evaluate import main\n'
            'sys.exit(main(sys.argv[1:]))\n')

    done = subprocess.run([sys.executable, '-c', code, bag], capture_output=True, text=True)

    assert done.returncode == 0
    assert done.stderr.splitlines() == [
        'note: no report.html, as matplotlib is missing: pip install tsmcl_ros[plot]']
    assert {path.name for path in (bag.parent / 'a_eval').iterdir()} == {'metrics.json', 'tum'}
