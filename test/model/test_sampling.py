"""Even sampling, against scipy's measure of evenness and random numbers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from tsmcl_ros.model.sampling import even_shares, subsets


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.mark.parametrize('dimension', [2, 3])
@pytest.mark.parametrize('count', [50, 400])
def test_even_shares_fill_the_box_more_evenly_than_random_ones(
        dimension: int, count: int) -> None:
    even = even_shares(np.arange(count), 1, dimension, rng())[0]
    random = np.mean([stats.qmc.discrepancy(rng(seed).random((count, dimension)))
                      for seed in range(10)])
    assert stats.qmc.discrepancy(even) < random / 3


def test_each_even_share_is_uniform_on_its_own() -> None:
    shares = even_shares(np.arange(7), 5000, 2, rng())
    assert ((shares >= 0) & (shares < 1)).all()
    for index in (0, 6):
        for axis in (0, 1):
            assert stats.kstest(shares[:, index, axis], 'uniform').pvalue > 1e-3


def test_subsets_are_of_rows_that_count() -> None:
    rows = np.array([[True, False, True, True, True], [True, True, True, False, True]])
    chosen = subsets(rows, 3, 20)
    assert (chosen.sum(axis=2) == 3).all()
    assert not (chosen & ~rows[:, None]).any()


def test_subsets_differ() -> None:
    chosen = subsets(np.ones((1, 6), bool), 3, 60)
    assert len(np.unique(chosen[0], axis=0)) > 15  # of 20 that there are
