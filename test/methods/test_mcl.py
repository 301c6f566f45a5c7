"""MCL's rejection and redraw: who survives, who replaces the rejected, and with which weight."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats
from tsmcl_ros.methods.grid import Grid, GridConfig
from tsmcl_ros.methods.mcl import Mcl, MclConfig
from tsmcl_ros.model.motion import motion_model, MotionConfig
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import EvidenceConfig, RadioConfig
from tsmcl_ros.types import Motion, Observation, Prior, Silence

SIGNIFICANCE = 1e-3
KNOWN = {'motion_model': 'odometry', 'odom_heading': 'known', 'odom_std': 0.0, 'alpha3': 0.0,
         'alpha4': 0.0}
RANDOM = {'motion_model': 'random', 'max_speed': 50.0}


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def mcl(motion: dict[str, Any], vehicles: int = 1, softness: float = 1e-3, **settings: Any
        ) -> Mcl:
    """Return MCL on disks of 100 m with the paper's 50 particles, without jitter."""
    channel = Channel(RadioConfig(radio_range=100.0, edge_softness=softness),
                      EvidenceConfig(outlier_fraction=0.0))
    config = MclConfig(**{'min_particles': 50, 'max_particles': 2000, 'jitter': 0.0,
                          'resample_threshold': 0.5, 'exclusion': 25.0, 'max_redraws': 20,
                          **settings})
    return Mcl(config, channel, motion_model(MotionConfig(**motion), 2, True), vehicles, 2, rng())


def listen(*rows: list[tuple[float, float]], **fields: object) -> Observation:
    """Let each vehicle hear references at its row of positions [m]."""
    observation = Observation.empty(len(rows), max(map(len, rows)), 2, 1.0)
    for vehicle, positions in enumerate(rows):
        observation.sender[vehicle, :len(positions)] = np.arange(len(positions))
        observation.position[vehicle, :len(positions)] = np.reshape(positions, (-1, 2))
    for name, value in fields.items():
        getattr(observation, name)[:] = value
    return observation


def still(vehicles: int = 1) -> Motion:
    return Motion(1.0, np.zeros((vehicles, 2)), np.zeros(vehicles))


def prior(vehicle: int = 0, x: float = 0.0, std: float = 1.0) -> Prior:
    return Prior(vehicle, np.array([x, 0.0]), std ** 2 * np.eye(2))


def distance(filter_: Mcl, x: float = 0.0, vehicle: int = 0) -> np.ndarray:
    return np.linalg.norm(filter_.particles[vehicle] - [x, 0.0], axis=1)


def distinct(filter_: Mcl, vehicle: int = 0) -> int:
    return len(np.unique(filter_.particles[vehicle], axis=0))


# Who survives


def test_every_survivor_of_hard_disks_satisfies_all_constraints() -> None:
    filter_ = mcl(RANDOM)
    observation = listen([(0.0, 0.0), (120.0, 0.0), (160.0, 0.0)], hops=[1, 1, 2])
    silent = Silence(known=np.ones((1, 1), bool), sender=np.array([[9]]),
                     position=np.array([[[60.0, 90.0]]], np.float32),
                     max_range=np.full((1, 1), np.nan, np.float32))
    observation = Observation(**{**vars(observation), 'silent': silent})
    for _ in range(10):
        filter_.predict(Motion(1.0))
        assert not filter_.update(observation).reinitialized[0]
        points = filter_.particles[0]
        # Edges are a millimetre wide, and float32 is good to one here.
        assert distance(filter_).max() < 100.02
        assert distance(filter_, 120.0).max() < 100.02
        assert distance(filter_, 160.0).min() > 99.98
        assert distance(filter_, 160.0).max() < 200.02
        assert np.linalg.norm(points - [60.0, 90.0], axis=1).min() > 99.98


def test_survival_is_as_probable_as_what_was_heard() -> None:
    filter_ = mcl(KNOWN, softness=20.0, min_particles=20_000, max_particles=20_000, max_redraws=0)
    filter_.start(prior(x=110.0, std=0.0))
    # Marked by a height that no evidence sees: who has been replaced carries another's.
    filter_.cloud.states[0, :, 1] = np.linspace(-1e-2, 1e-2, 20_000)
    before = filter_.particles.copy()
    filter_.filter(filter_.channel.evidence(listen([(0.0, 0.0)])), np.array([True]))
    survived = int((filter_.particles == before).all(axis=2).sum())
    probability = 1 / (1 + np.exp((110.0 - 100.0) / 20.0))
    assert stats.binomtest(survived, 20_000, probability).pvalue > SIGNIFICANCE


def test_measurements_reject_nobody() -> None:
    filter_ = mcl(KNOWN)
    filter_.start(prior(std=5.0))
    before = filter_.particles.copy()
    observation = listen([(0.0, 0.0)], max_range=0.0, range=3.0, range_std=1.0)
    filter_.filter(filter_.channel.evidence(observation).presence, np.array([True]))
    np.testing.assert_array_equal(filter_.particles, before)


def test_measurements_weigh_the_survivors() -> None:
    filter_ = mcl(KNOWN, min_particles=20_000, max_particles=20_000)
    filter_.start(prior(std=5.0))
    estimate = filter_.update(listen([(1e4, 0.0)], max_range=0.0, range=1e4 - 3.0, range_std=5.0))
    # Prior and range are equally sure: half way, and half the variance, along the line of sight.
    assert estimate.mean[0, 0] == pytest.approx(1.5, abs=0.15)
    assert estimate.covariance[0, 0, 0] == pytest.approx(12.5, rel=0.08)
    assert estimate.covariance[0, 1, 1] == pytest.approx(25.0, rel=0.08)


def test_a_vehicle_that_heard_nothing_keeps_its_particles() -> None:
    filter_ = mcl(RANDOM, vehicles=2)
    for vehicle in range(2):
        filter_.start(prior(vehicle, x=95.0, std=20.0))
    filter_.predict(Motion(1.0))
    before = filter_.particles[1].copy()
    filter_.update(listen([(0.0, 0.0)], []))
    np.testing.assert_array_equal(filter_.particles[1], before)


# Who replaces the rejected


def test_redraws_replace_the_rejected_by_others() -> None:
    filter_ = mcl(RANDOM)
    filter_.start(prior(x=95.0, std=10.0))
    filter_.predict(Motion(1.0))
    filter_.update(listen([(0.0, 0.0)]))
    assert distinct(filter_) == 50
    assert distance(filter_).max() < 100.02


def test_without_redraws_survivors_are_copied() -> None:
    filter_ = mcl(RANDOM, max_redraws=0)
    filter_.start(prior(x=95.0, std=10.0))
    filter_.predict(Motion(1.0))
    inside = int((distance(filter_) < 100.0).sum())
    filter_.update(listen([(0.0, 0.0)]))
    assert 0 < inside < 50
    assert distinct(filter_) == inside


def test_copies_of_a_single_survivor_part() -> None:
    filter_ = mcl(KNOWN, max_redraws=0, jitter=0.05)
    filter_.start(prior(x=500.0, std=10.0))
    filter_.cloud.states[0, 0, :2] = 0
    filter_.predict(Motion(1.0, np.zeros((1, 2)), np.zeros(1)))
    estimate = filter_.update(listen([(0.0, 0.0)]))
    assert distinct(filter_) == 50
    assert np.linalg.eigvalsh(estimate.covariance[0]).min() > 0


def test_copies_are_spread_over_all_survivors() -> None:
    filter_ = mcl(KNOWN, max_redraws=0, min_particles=20_000, max_particles=20_000)
    filter_.start(prior(x=500.0, std=0.0))
    filter_.cloud.states[0, ::1000, 0] = np.arange(20)
    filter_.filter(filter_.channel.evidence(listen([(0.0, 0.0)])), np.array([True]))
    counts = np.bincount(filter_.particles[0, :, 0].astype(int), minlength=20)
    assert counts.sum() == 20_000
    assert stats.chisquare(counts).pvalue > SIGNIFICANCE


def test_redraws_are_predicted_by_each_vehicle_s_own_motion() -> None:
    filter_ = mcl({**KNOWN, 'odom_std': 5.0}, vehicles=2)
    for vehicle in range(2):
        filter_.start(prior(vehicle, std=0.0))
    filter_.predict(Motion(1.0, np.array([[200.0, 0.0], [-200.0, 0.0]]), np.zeros(2)))
    filter_.update(listen([(105.0, 0.0)], [(-105.0, 0.0)]))
    for vehicle, x in enumerate((200.0, -200.0)):
        assert distinct(filter_, vehicle) == 50
        # Half of a Gaussian of 5 m was rejected; nobody is further than six times that.
        assert distance(filter_, x, vehicle).max() < 30.0


def test_what_is_redrawn_has_its_parent_s_weight() -> None:
    """
    Where rejection and weights meet, compare with the exact grid.

    A disk's edge rejects half of the prediction at every epoch, while ranges weigh across.
    """
    motion = motion_model(MotionConfig(**{**KNOWN, 'odom_std': 10.0}), 2, True)
    channel = Channel(RadioConfig(range_std=30.0, edge_softness=0.5),
                      EvidenceConfig(outlier_fraction=0.0))
    exact = Grid(GridConfig(grid_cell=3.0, grid_x_min=800.0, grid_x_max=1010.0, grid_y_min=-150.0,
                            grid_y_max=150.0), channel, motion, 1, 2, rng())
    filter_ = Mcl(MclConfig(min_particles=20_000, max_particles=20_000, jitter=0.0), channel,
                  motion, 1, 2, rng())
    draw = rng(2)
    for epoch in range(10):
        observation = listen([(0.0, 0.0), (0.0, 5000.0)], max_range=[1000.0, 0.0],
                             range=[np.nan, 5000.0 + draw.normal(0, 30.0)])
        for method in (exact, filter_):
            if epoch:
                method.predict(Motion(1.0, np.array([[10.0, 0.0]]), np.zeros(1)))
            else:
                method.start(Prior(0, np.array([980.0, 0.0]), np.diag([100.0, 1600.0])))
        expected, estimate = exact.update(observation), filter_.update(observation)
    # 16 m wide, of 20 000 particles: rejection keeps them coming from few parents, so that
    # seeds differ by 0.3 m. Weights left with the slot instead cost 7 m.
    np.testing.assert_allclose(estimate.mean, expected.mean, atol=1.2)
    np.testing.assert_allclose(np.sqrt(np.diagonal(estimate.covariance, axis1=1, axis2=2)),
                               np.sqrt(np.diagonal(expected.covariance, axis1=1, axis2=2)),
                               atol=1.2)


def test_a_new_belief_is_not_redrawn_from_the_old_one() -> None:
    filter_ = mcl({**KNOWN, 'odom_std': 1.0})
    filter_.start(prior())
    filter_.predict(still())
    filter_.start(prior(x=150.0, std=5.0))
    filter_.update(listen([(50.0, 0.0)]))
    # The old belief, 0 m, lies in the disk around 50 m as well.
    assert distance(filter_, 150.0).max() < 30.0


def test_what_was_updated_is_not_redrawn_from_what_it_was_before() -> None:
    filter_ = mcl({**KNOWN, 'odom_std': 30.0})
    filter_.start(prior())
    filter_.predict(still())
    filter_.update(listen([(-100.0, 0.0)]))
    filter_.update(listen([(0.0, -100.0)]))
    assert distance(filter_, -100.0).max() < 100.02


# When nobody survives


def test_a_vehicle_without_survivors_starts_from_what_it_hears_and_tells_so() -> None:
    filter_ = mcl(RANDOM, vehicles=2)
    for vehicle, x in enumerate((500.0, 50.0)):
        filter_.start(prior(vehicle, x))
    filter_.predict(Motion(1.0))
    estimate = filter_.update(listen([(0.0, 0.0)], [(0.0, 0.0)]))
    np.testing.assert_array_equal(estimate.reinitialized, [True, False])
    for vehicle in range(2):
        assert distance(filter_, 0.0, vehicle).max() < 100.02
    assert distance(filter_, 50.0, 1).max() < 60.0


def test_a_single_survivor_is_enough() -> None:
    filter_ = mcl(KNOWN, max_redraws=0)
    filter_.start(prior(x=500.0))
    filter_.cloud.states[0, 17] = [50.0, 0.0]
    assert not filter_.update(listen([(0.0, 0.0)])).reinitialized[0]
    np.testing.assert_array_equal(filter_.particles[0], np.broadcast_to([50.0, 0.0], (50, 2)))


def test_ranges_that_no_particle_explains_start_anew_as_well() -> None:
    filter_ = mcl(KNOWN)
    filter_.start(prior(std=0.1))
    ranges = listen([(0.0, 0.0), (50.0, 0.0), (0.0, 50.0)], range=[40.0, 30.0, 30.0],
                    range_std=0.5)
    assert filter_.update(ranges).reinitialized[0]
