"""How figures look and how they stand in a page."""

import re
import xml.etree.ElementTree as ElementTree

from fleets import fleet, legend
import numpy as np
from tsmcl_ros.evaluation import plots
from tsmcl_ros.evaluation.plots import canvas


def test_dollars_in_a_name_are_no_mathematics(ax):
    plots.error_cdf(ax, {r'$\nonsense$': np.ones(2), 'b': np.ones(2)})

    ElementTree.fromstring(plots.svg(ax.figure, 'cdf'))


def test_a_name_that_starts_with_an_underscore_is_in_the_legend(ax):
    plots.error_cdf(ax, {'_a': np.ones(2), 'b': np.ones(2)})

    assert [text.strip() for text in legend(ax)] == ['_a', 'b']


def test_svg_takes_its_ink_from_the_text_around_it(ax):
    plots.map_view(ax, fleet(1))

    text = plots.svg(ax.figure, 'map')

    assert 'currentColor' in text
    assert canvas.INK not in text


def test_ids_of_two_figures_do_not_meet_in_one_page(ax):
    plots.error_cdf(ax, {'a': np.ones(2), 'b': np.ones(2)})

    first, second = (set(re.findall(r'\bid="([^"]+)"', plots.svg(ax.figure, name)))
                     for name in ('one', 'two'))

    assert first and not first & second


def test_every_reference_in_a_figure_has_its_target(ax):
    plots.map_view(ax, fleet(3), np.zeros((3, 3)), np.full(3, 9.0))
    text = plots.svg(ax.figure, 'map')

    used = set(re.findall(r'(?:"|url\()#([^")]+)', text))

    assert used and used <= set(re.findall(r'\bid="([^"]+)"', text))


def test_the_same_plot_gives_the_same_text():
    texts = []
    for _ in range(2):
        figure, ax = plots.panel()
        plots.map_view(ax, fleet(40), np.zeros((3, 3)), np.full(3, 9.0))
        texts.append(plots.svg(figure, 'map'))

    assert texts[0] == texts[1]
