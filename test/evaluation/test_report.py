"""The report: one page, complete, safe, and the same every time."""

from functools import cache
from html.parser import HTMLParser
import re

import numpy as np
import pytest
from tsmcl_ros.evaluation.condition import Condition
from tsmcl_ros.evaluation.metrics import compare, mean_of
from tsmcl_ros.evaluation.recording import Run
from tsmcl_ros.evaluation.report import render, write_report
from tsmcl_ros.types import Trajectory


@cache
def vehicle(seed):
    rng = np.random.default_rng(seed)
    stamp = np.arange(30.0)
    path = np.cumsum(rng.normal(0, 5, (30, 2)), axis=0)
    return compare(
        Trajectory(stamp, path + rng.normal(0, 1, (30, 2)), np.full(30, np.nan),
                   np.tile(np.eye(2), (30, 1, 1))),
        Trajectory(stamp, path, np.zeros(30)))


@cache
def run(label='walk', vehicles=1, notes=(), outages=(), told=False, about=(), particles=200.0):
    names = [f'veh_{index}' for index in range(vehicles)]
    return Run(label, {name: vehicle(index) for index, name in enumerate(names)},
               np.zeros((2, 3)), np.array([30.0, np.nan]), outages, notes,
               np.array([4, 9], np.int32),
               {name: condition(particles) for name in names} if told else {}, dict(about))


@cache
def condition(particles):
    """Return a condition that names sender 9 half of the time, and sender 4 hardly ever."""
    stamp = np.arange(30.0)
    every = np.full(30, particles)
    return Condition(stamp, np.arange(30) % 3, every, every / 2, {4: 0.01, 9: 0.5, 77: 0.5})


class Page(HTMLParser):
    """The page's elements, attributes and text; refuses elements that are not closed in order."""

    VOID = frozenset({'meta', 'br'})

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.attributes, self.rows, self.words = [], [], [], [], []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs
        if tag == 'tr':
            self.rows.append([])
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ('style', 'script'):
            self.words.append(data)
        if self.open and self.open[-1] in ('td', 'th'):
            self.rows[-1].append(data)


def climbing():
    """Return a run of a vehicle whose height is estimated."""
    stamp, path = np.arange(9.0), np.outer(np.arange(9.0), np.ones(3))
    part = compare(Trajectory(stamp, path + 1, stamp, np.tile(np.eye(3), (9, 1, 1))),
                   Trajectory(stamp, path, stamp))
    return Run('climb', {'veh_0': part}, np.zeros((2, 3)), np.full(2, np.nan), (), ())


def comments(*runs):
    """Return what is written in the plots: matplotlib draws it, and says it in a comment."""
    return {text.strip() for text in re.findall('<!--(.*?)-->', text_of(*runs))}


@cache
def text_of(*runs, command='evaluate walk', parameters=(), mean=None):
    return render(runs, command, dict(parameters), mean)


def page(*runs, **options):
    return Page(text_of(*runs, **options))


@pytest.mark.parametrize('runs', [(run(),), (run(vehicles=40),), (run('a'), run('b'))])
def test_every_element_is_closed_in_order(runs):
    page(*runs)


def test_the_page_loads_nothing():
    text = text_of(run(vehicles=40))

    targets = re.findall(r'(?:\bsrc|\bhref)="([^"]*)"|url\(([^)]*)\)', text)

    assert all(target.startswith(('#', 'data:')) for pair in targets for target in pair if target)
    assert '<link' not in text and '@import' not in text and '<script' not in text


def test_a_policy_lets_the_browser_hold_that_it_loads_nothing():
    policy = dict(page(run()).attributes)['content']

    assert policy.startswith("default-src 'none'")


def test_the_table_holds_the_metrics():
    one = run()

    assert ['walk', *one.overall.cells()] in page(one).rows


def test_several_runs_are_rows_of_one_table():
    rows = [row[0] for row in page(run('a'), run('b')).rows if len(row) > 2]

    assert rows == ['run', 'a', 'b']


def test_the_mean_is_the_last_row():
    mean = mean_of([run('a').overall, run('b').overall])

    assert ['mean', *mean.cells()] in page(run('a'), run('b'), mean=mean).rows


def test_every_vehicle_has_a_row():
    rows = [row[0] for row in page(run(vehicles=3)).rows]

    assert rows[-3:] == ['veh_0', 'veh_1', 'veh_2']


@pytest.mark.parametrize(('vehicles', 'unfolded'), [(3, True), (40, False)])
def test_the_table_of_a_large_fleet_is_folded(vehicles, unfolded):
    assert (('open', None) in page(run(vehicles=vehicles)).attributes) is unfolded


def test_one_run_has_its_four_plots():
    assert page(run()).tags.count('svg') == 4


def test_what_localizers_say_of_themselves_is_one_plot_more():
    assert page(run(told=True)).tags.count('svg') == 5
    assert {'OK', 'STALE', 'LOST'} <= comments(run(told=True))


def test_estimators_without_particles_have_no_plot_of_them():
    assert page(run(told=True, particles=1.0)).tags.count('svg') == 4


def test_suspects_are_told_and_those_that_are_anchors_marked():
    words = ' '.join(page(run(vehicles=3, told=True)).words)

    assert 'Suspected senders: 9 (by 3 of the vehicles), 77 (by 3 of the vehicles).' in words
    assert {'suspect', '9'} <= comments(run(vehicles=3, told=True))
    assert '77' not in comments(run(vehicles=3, told=True))


def test_a_vehicle_that_knows_its_height_is_seen_from_aside_too():
    assert page(climbing()).tags.count('svg') == 5
    assert 'z [m]' in comments(climbing())


def test_several_runs_share_the_plots_that_compare_them():
    assert page(run('a'), run('b')).tags.count('svg') == 3 + 2 * 3


def test_ids_are_unique_in_the_page():
    ids = [value for name, value in page(run('a'), run('b')).attributes if name == 'id']

    assert len(ids) == len(set(ids))


def test_command_and_parameters_are_shown():
    words = page(run(), command='evaluate walk --skip 5', parameters=(('skip', '5 s'),)).words

    assert {'evaluate walk --skip 5', 'skip', '5 s'} <= set(words)


def test_each_run_tells_how_its_bag_was_made():
    about = (('command', 'localize_bag walk'), ('localizer', 'seed: 1\nmethod: <mcl>\n'))

    words = page(run(about=about)).words

    assert {'How this run was made', 'localize_bag walk', 'localizer',
            'seed: 1\nmethod: <mcl>'} <= set(words)


def test_a_bag_that_does_not_say_how_it_was_made_is_not_asked():
    assert 'How this run was made' not in page(run()).words


def test_notes_are_shown():
    assert '3 poses are odd' in page(run(notes=('3 poses are odd',))).words


def test_the_longest_outage_is_told():
    words = ' '.join(page(run(outages=((1.0, 8.0), (10.0, 22.0)))).words)

    assert '2 outages of more than 5 s without beacons, the longest 12 s' in words


def test_what_users_name_is_escaped():
    evil = '<script>alert("1")</script>&amp;'

    text = render([run(evil, 2, notes=(evil,)), run('b')], evil, {evil: evil})

    assert '<script' not in text
    assert evil in Page(text).words


def test_dark_pages_are_provided_for():
    assert '@media (prefers-color-scheme: dark)' in text_of(run())


def test_printing_is_provided_for():
    assert '@media print' in text_of(run())


def test_the_same_runs_give_the_same_report():
    again = render([run(vehicles=40)], 'evaluate walk', {})

    assert again == text_of(run(vehicles=40))


def test_the_report_is_one_file(tmp_path):
    write_report(tmp_path / 'report.html', [run()], 'evaluate walk', {})

    assert [path.name for path in tmp_path.iterdir()] == ['report.html']
    assert (tmp_path / 'report.html').read_text('utf-8') == text_of(run())
