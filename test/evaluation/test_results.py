"""The files of an experiment: what they hold, and that they can be read again."""

import csv
import json
from pathlib import Path
import sys

import numpy as np
import pytest
from tsmcl_ros.evaluation.monte_carlo import Outcome, run_experiment
from tsmcl_ros.evaluation.results import prepare_folder, read_results, write_results
from tsmcl_ros.types import TsmclError

sys.path.append(str(Path(__file__).parent))
from draws import Draws  # noqa: E402, I100

RECORD = {'quick': False, 'seed': 0, 'runs': 2, 'workers': 1, 'duration_s': 0.5}


def values(results):
    return [result.outcome.rows['value'].tolist() for result in results]


@pytest.fixture
def written(tmp_path):
    """Return a folder with the results of two runs, and those."""
    experiment = Draws()
    results = run_experiment(experiment, 0, 2)
    write_results(tmp_path, 'draws', experiment, results, experiment.judge(results), RECORD)
    return tmp_path, results


def test_the_csv_file_holds_every_row_led_by_its_case_and_run(tmp_path):
    experiment = Draws()
    results = run_experiment(experiment, 0, 2)

    write_results(tmp_path, 'draws', experiment, results, experiment.judge(results), {})

    with (tmp_path / 'draws.csv').open(newline='') as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ['scale', 'name', 'run', 'index', 'value']
    assert len(rows) == 2 * 2 * 3
    assert float(rows[-1]['value']) == pytest.approx(values(results)[-1][-1], rel=1e-5)


def test_an_unknown_number_is_an_empty_cell(tmp_path):
    class Unknown(Draws):

        def work(self, case, seed):
            return Outcome({'value': np.array([np.nan])}, 0.0)

    experiment = Unknown()
    results = run_experiment(experiment, 0, 1)
    write_results(tmp_path, 'draws', experiment, results, experiment.judge(results), {})

    assert (tmp_path / 'draws.csv').read_text().splitlines()[1] == '1.0,a,0,'


def test_the_json_file_says_what_made_the_rows_and_what_they_show(tmp_path):
    experiment = Draws(rows=4)
    results = run_experiment(experiment, 3, 1)

    written = write_results(
        tmp_path, 'draws', experiment, results, experiment.judge(results), {'seed': 3})

    assert written == ['draws.csv', 'draws.json', 'draws.png']
    document = json.loads((tmp_path / 'draws.json').read_text())
    assert document['seed'] == 3
    assert document['config'] == {'runs': 2, 'rows': 4}
    assert document['versions']['numpy'] == np.__version__
    assert document['cases'] == experiment.cases()
    assert document['findings'] == [
        {'claim': 'claim', 'measured': '1 m', 'limit': '', 'verdict': 'reached'}]


def test_without_matplotlib_there_is_no_figure(tmp_path):
    class Plotless(Draws):

        def draw(self, results, path):
            raise ModuleNotFoundError(name='matplotlib.figure')

    experiment = Plotless()
    results = run_experiment(experiment, 0, 1)

    written = write_results(
        tmp_path, 'draws', experiment, results, experiment.judge(results), {})

    assert written == ['draws.csv', 'draws.json']


def test_a_folder_that_cannot_be_made_is_found_out_beforehand(tmp_path):
    (tmp_path / 'file').write_text('')

    with pytest.raises(OSError):
        prepare_folder(tmp_path / 'file' / 'below')


def test_results_can_be_read_again(written):
    folder, results = written
    again, record = read_results(folder, 'draws', Draws())

    assert record == RECORD
    assert [(one.case, one.run) for one in again] == [(one.case, one.run) for one in results]
    for one, other in zip(again, results, strict=True):
        assert one.outcome.seconds == other.outcome.seconds
        assert one.outcome.rows['index'].tolist() == other.outcome.rows['index'].tolist()
        np.testing.assert_allclose(
            one.outcome.rows['value'], other.outcome.rows['value'], rtol=1e-5)


def test_an_unknown_number_is_read_as_one(tmp_path):
    class Unknown(Draws):

        def work(self, case, seed):
            return Outcome({'value': np.array([np.nan, 1.5])}, 0.0)

    results = run_experiment(Unknown(), 0, 2)
    write_results(tmp_path, 'draws', Unknown(), results, Unknown().judge(results), RECORD)
    again, _ = read_results(tmp_path, 'draws', Unknown())
    np.testing.assert_array_equal(values(again), [[np.nan, 1.5]] * 4)


def test_a_case_may_have_a_comma_in_its_name(tmp_path):
    class Named(Draws):

        def cases(self):
            return [{'name': 'ours, new'}, {'name': 'ours, "old"'}]

        def work(self, case, seed):
            return Outcome({'value': np.array([2.5])}, 0.0)

    results = run_experiment(Named(), 0, 2)
    write_results(tmp_path, 'draws', Named(), results, Named().judge(results), RECORD)
    again, _ = read_results(tmp_path, 'draws', Named())
    assert values(again) == [[2.5]] * 4
    with (tmp_path / 'draws.csv').open(newline='') as file:
        assert [row['name'] for row in csv.DictReader(file)] == [
            result.case['name'] for result in results]


def test_results_of_another_size_are_refused(written):
    with pytest.raises(TsmclError, match='draws.json: was made with other settings'):
        read_results(written[0], 'draws', Draws(rows=4))


def test_results_that_are_not_there_are_refused(tmp_path):
    with pytest.raises(TsmclError, match='draws.json: is missing; run the experiment first'):
        read_results(tmp_path, 'draws', Draws())


def test_rows_that_are_not_those_of_all_runs_are_refused(written):
    path = written[0] / 'draws.csv'
    path.write_text(''.join(path.read_text().splitlines(keepends=True)[:-3]))
    with pytest.raises(TsmclError, match='holds rows of 3 runs, must hold those of 4'):
        read_results(written[0], 'draws', Draws())


@pytest.mark.parametrize('text', [
    '', 'no heading\n', 'scale,name,run,index,value\n1.0,a,0,0,much\n',
    'scale,name,run,index,value\n1.0,a,0,0\n'])
def test_a_file_that_holds_no_rows_is_refused(written, text):
    (written[0] / 'draws.csv').write_text(text)
    with pytest.raises(TsmclError, match='draws.csv: does not hold rows of results'):
        read_results(written[0], 'draws', Draws())


def test_rows_of_other_cases_are_refused(written):
    path = written[0] / 'draws.csv'
    path.write_text(path.read_text().replace('2.0,b,', '3.0,c,'))
    with pytest.raises(TsmclError, match='that draws.json tells of'):
        read_results(written[0], 'draws', Draws())
