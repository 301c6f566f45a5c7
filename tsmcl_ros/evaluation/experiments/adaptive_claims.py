"""What the paper on adaptive beacon periods claims, beside what the networks of it do."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from tsmcl_ros.evaluation.monte_carlo import (
    bootstrap_interval,
    Finding,
    Interval,
    ratio_interval,
)
from tsmcl_ros.types import Array

# Variance of the ranges [m^2] and number of anchors; of each and a scheme, columns by name.
Setting = tuple[float, int]
Found = Mapping[tuple[float, int, str], Mapping[str, Array]]

FIXED = ('omega 1', 'omega 5')
SCHEMES = (*FIXED, 'adaptive')  # the three that the paper compares
# What else is compared with the fixed ones: the paper's parameters, a period that costs as much.
PAPER, YARDSTICK = 'adaptive, paper', 'omega 3'
AT = {'sampled_error_m': 'at samples', 'error_m': 'at every period'}
# "Close to" another scheme is what is at most this much above it.
_CLOSE = 1.2


def settings(found: Found) -> list[Setting]:
    """Return the settings, in order."""
    return list(dict.fromkeys(case[:2] for case in found))


def mean(values: Array) -> Interval:
    """Return the mean over vehicles."""
    return bootstrap_interval(np.mean, values)


def ratio(found: Found, setting: Setting, scheme: str, other: str, name: str) -> Interval:
    """Return a quantity of one scheme over that of another, in the same networks."""
    return ratio_interval(np.mean, *(found[*setting, each][name] for each in (scheme, other)))


def score(found: Found, setting: Setting, scheme: str, name: str) -> Interval:
    """
    Return error / largest error + cost / largest cost over three schemes; small is good.

    These are both of the paper's fixed ones and the adaptive one, or what is scored in its place.
    """
    schemes = SCHEMES if scheme in SCHEMES else (*FIXED, scheme)
    return bootstrap_interval(
        lambda part: float(_scores(part)[schemes.index(scheme)]),
        _stacked(found, setting, name, schemes))


def judge_error(found: Found) -> Iterator[Finding]:
    """Compare the adaptive period's error with those of both fixed ones."""
    for setting in settings(found):
        for name, where in AT.items():
            over = ratio(found, setting, 'adaptive', 'omega 1', name)
            yield Finding(
                f'{_named(setting)}: the error of the adaptive period is close to that of '
                f'omega 1, {where}', f'{over} times it', '',
                _verdict(over.value <= _CLOSE, over.low <= _CLOSE))
            yield _far_below(found, setting, name)


def judge_noise(found: Found) -> Iterator[Finding]:
    """Say where the adaptive period is better than the fixed one, and how errors go with noise."""
    for setting in settings(found):
        for name in AT:
            yield _far_below(found, setting, name)
    for name, where in AT.items():
        errors = [float(found[*setting, 'adaptive'][name].mean()) for setting in settings(found)]
        lowest = int(np.argmin(errors))
        yield Finding(
            f'errors of the adaptive period first fall, then rise with the noise, {where}',
            ', '.join(f'{error:.2f}' for error in errors) + ' m', '',
            'reproduced' if 0 < lowest < len(errors) - 1 else
            'not reproduced: they rise' if lowest == 0 else 'not reproduced: they fall')


def judge_density(found: Found) -> Iterator[Finding]:
    """Say how errors go with the share of anchors."""
    for scheme in SCHEMES:
        errors = [float(found[*setting, scheme]['sampled_error_m'].mean())
                  for setting in settings(found)]
        yield Finding(
            f'{scheme}: the error falls with the share of anchors, at samples',
            ', '.join(f'{error:.2f}' for error in errors) + ' m', '',
            _verdict(errors[-1] < errors[0], False))
    for setting in settings(found):
        yield _far_below(found, setting, 'sampled_error_m')
    yield from judge_score(found)


def judge_traffic(found: Found) -> Iterator[Finding]:
    """Compare the adaptive period's bits on the air with those of both fixed ones."""
    for setting in settings(found):
        few, many = (ratio(found, setting, 'adaptive', other, 'bits')
                     for other in ('omega 5', 'omega 1'))
        yield Finding(
            f'{_named(setting)}: the air cost of the adaptive period is close to that of omega 5',
            f'{few} times it, {many} times that of omega 1', '',
            _verdict(few.value <= _CLOSE, few.low <= _CLOSE))


def judge_score(found: Found) -> Iterator[Finding]:
    """Say whether the adaptive period has the best score, by how much, and what adapting adds."""
    for setting in settings(found):
        for name, where in AT.items():
            yield _best_score(found, setting, name, 'adaptive', 'the adaptive period')
            if (*setting, PAPER) in found:
                yield _best_score(found, setting, name, PAPER, "the paper's adaptive period")
            if (*setting, YARDSTICK) in found:
                schemes = (*SCHEMES, YARDSTICK)
                gain = bootstrap_interval(
                    lambda part: float(np.subtract(*_scores(part)[2:])),
                    _stacked(found, setting, name, schemes))
                yield Finding(
                    f'{_named(setting)}: adapting betters the score of a fixed period of about '
                    f'the same cost, {YARDSTICK}, {where}', f'{gain} off it', '',
                    'it does' if gain.high < 0 else 'it worsens it' if gain.low > 0 else
                    'neither better nor worse, within the interval')


CLAIMS: dict[str, Callable[[Found], Iterator[Finding]]] = {
    'error': judge_error, 'noise': judge_noise, 'density': judge_density,
    'traffic': judge_traffic, 'score': judge_score,
}


def _far_below(found: Found, setting: Setting, name: str) -> Finding:
    below = ratio(found, setting, 'adaptive', 'omega 5', name)
    verdict = 'not reproduced: it is not below at all'
    if below.high < 1:
        verdict = 'reproduced' if below.value < 0.8 else 'below, but not far'
    return Finding(
        f'{_named(setting)}: the error of the adaptive period is far below that of omega 5, '
        f'{AT[name]}', f'{below} times it', '', verdict)


def _best_score(found: Found, setting: Setting, name: str, scheme: str, called: str) -> Finding:
    schemes = (*FIXED, scheme)
    part = _stacked(found, setting, name, schemes)
    lead = bootstrap_interval(
        lambda part: float(_scores(part)[2] - _scores(part)[:2].min()), part)
    told = ', '.join(f'{each} {value:.3f}' for each, value in zip(
        schemes, _scores(part), strict=True))
    return Finding(
        f'{_named(setting)}: {called} has the best score of the three, {AT[name]}',
        f'{told}; {lead} off the better fixed one', '', _verdict(lead.value < 0, lead.low < 0))


def _stacked(found: Found, setting: Setting, name: str, schemes: Sequence[str]) -> Array:
    """Return errors and bits (2, S, U) of these schemes."""
    return np.array([[found[*setting, scheme][column] for scheme in schemes]
                     for column in (name, 'bits')])


def _scores(part: Array) -> Array:
    """Return the score (S,) of each scheme from errors and bits (2, S, U)."""
    means = part.mean(axis=2)
    return np.asarray((means / means.max(axis=1, keepdims=True)).sum(axis=0))


def _named(setting: Setting) -> str:
    variance, anchors = setting
    return f'variance {variance:g} m^2, {anchors} anchors'


def _verdict(holds: bool, possible: bool) -> str:
    if holds:
        return 'reproduced'
    return 'not reproduced, though within the interval' if possible else 'not reproduced'
