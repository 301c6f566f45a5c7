"""The page of claims, from the files that experiments leave."""

from dataclasses import asdict
import json
from pathlib import Path
import shutil

import pytest
from tsmcl_ros.evaluation.experiments import EXPERIMENTS
from tsmcl_ros.evaluation.reproduction import write_reproduction
from tsmcl_ros.types import TsmclError

DOCS = Path(__file__).parents[2] / 'docs'


def document(**changes):
    """Return what an experiment writes, as far as the page is concerned."""
    return {
        'title': 'the error of it', 'seed': 3, 'runs': 7, 'quick': False,
        'table': [['filter', 'RMSE [m]'], ['a | b', '1.0']],
        'findings': [
            {'claim': 'below 2 m', 'measured': '1.0 m', 'limit': '', 'verdict': 'reached'},
            {'claim': 'at 0 m', 'measured': '1.0 m', 'limit': '0.9 m', 'verdict': 'no'}],
        **changes}


@pytest.fixture
def folder(tmp_path):
    """Return a folder with the results of one experiment, `first`."""
    results = tmp_path / 'results'
    results.mkdir()
    (results / 'first.json').write_text(json.dumps(document()))
    (results / 'first.png').write_bytes(b'')
    return results


def test_every_finding_is_a_row(folder, tmp_path):
    write_reproduction(folder, ['first'], tmp_path / 'page.md')

    text = (tmp_path / 'page.md').read_text()
    assert '| [first](#first) | below 2 m | 1.0 m | - | reached |' in text
    assert '| [first](#first) | at 0 m | 1.0 m | 0.9 m | no |' in text


def test_the_figure_is_found_from_where_the_page_is(folder, tmp_path):
    write_reproduction(folder, ['first'], tmp_path / 'docs' / 'page.md')

    assert '](../results/first.png)' in (tmp_path / 'docs' / 'page.md').read_text()


def test_what_was_not_run_is_left_out_and_named(folder, tmp_path):
    assert write_reproduction(folder, ['first', 'second'], tmp_path / 'page.md') == ['second']
    assert 'second' not in (tmp_path / 'page.md').read_text()


def test_the_command_that_made_it_stands_there(folder, tmp_path):
    (folder / 'first.json').write_text(json.dumps(document(quick=True)))

    write_reproduction(folder, ['first'], tmp_path / 'page.md')

    text = (tmp_path / 'page.md').read_text()
    assert '`experiment first --quick --seed 3 --runs 7`, a quick run' in text


def test_bars_do_not_break_a_table(folder, tmp_path):
    write_reproduction(folder, ['first'], tmp_path / 'page.md')

    assert '| a \\| b | 1.0 |' in (tmp_path / 'page.md').read_text()


def test_a_folder_without_results_is_refused(tmp_path):
    with pytest.raises(TsmclError, match='holds no results'):
        write_reproduction(tmp_path, ['first'], tmp_path / 'page.md')


@pytest.mark.parametrize('text', ['{', '[]', '{"title": 1}'])
def test_a_file_that_is_none_of_an_experiment_is_refused_by_name(folder, tmp_path, text):
    (folder / 'first.json').write_text(text)

    with pytest.raises(TsmclError, match=r'first\.json: is not what'):
        write_reproduction(folder, ['first'], tmp_path / 'page.md')


def test_the_page_of_the_documentation_is_that_of_all_experiments_at_full_size(tmp_path):
    copied = shutil.copytree(DOCS / 'reproduction', tmp_path / 'docs' / 'reproduction')
    page = tmp_path / 'docs' / 'reproduction.md'

    assert write_reproduction(copied, list(EXPERIMENTS), page) == []
    assert page.read_text() == (DOCS / 'reproduction.md').read_text()
    assert 'a quick run' not in page.read_text()


@pytest.mark.parametrize('name', EXPERIMENTS)
def test_every_experiment_of_the_documentation_was_made_with_its_present_sizes(name):
    document = json.loads((DOCS / 'reproduction' / f'{name}.json').read_text())
    assert document['config'] == json.loads(json.dumps(asdict(EXPERIMENTS[name][0])))
