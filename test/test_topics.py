"""Which topics a name or a pattern stands for."""

import re

import pytest
from tsmcl_ros.topics import compiled, match_topic
from tsmcl_ros.types import ConfigError


@pytest.mark.parametrize(('pattern', 'namespace', 'matches'), [
    ('/uwb/n_5', '/', True), ('/uwb/n_5', '/veh_0', True), ('/uwb/n', '/', False),
    ('n_5', '/uwb', True), ('uwb/n_5', '/', True), ('n_5', '/', False), ('n_5', '/u', False),
    ('/uwb/n_.*', '/veh_0', True), ('(/uwb|/ble)/n_5', '/', True)])
def test_a_pattern_names_a_whole_topic_from_the_root_or_the_namespace(pattern, namespace, matches):
    assert bool(match_topic(re.compile(pattern), '/uwb/n_5', namespace)) is matches


@pytest.mark.parametrize('pattern', ['/uwb/(', '/n{99999999999}', '(' * 5000])
def test_what_is_no_pattern_is_refused(pattern):
    error = r"ranges: '.*' is not allowed, must be a topic or a regular expression: \w+"
    with pytest.raises(ConfigError, match=error):
        compiled('ranges', [pattern])


def test_a_pattern_that_python_only_warns_of_is_taken():
    assert compiled('ranges', ['/[[]'])[0].fullmatch('/[')
