"""MCB's redraws in boxes: that they are MCL's, in fewer draws."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tsmcl_ros.methods.grid import Grid, GridConfig
from tsmcl_ros.methods.mcb import Mcb, McbConfig
from tsmcl_ros.methods.mcl import Mcl, MclConfig
from tsmcl_ros.model.motion import motion_model, MotionConfig
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import EvidenceConfig, RadioConfig
from tsmcl_ros.types import Motion, Observation, Prior

CHANNEL = Channel(RadioConfig(radio_range=100.0, edge_softness=0.1, range_std=30.0),
                  EvidenceConfig(outlier_fraction=0.0))
RANDOM = {'motion_model': 'random', 'max_speed': 50.0}
ODOMETRY = {'motion_model': 'odometry', 'odom_heading': 'known', 'odom_std': 20.0, 'alpha3': 0.0,
            'alpha4': 0.0}


def make(kind: Any, config: Any, motion: dict[str, Any], vehicles: int = 1, **settings: Any
         ) -> Any:
    settings = {'min_particles': 50, 'max_particles': 2000, 'jitter': 0.0, **settings}
    return kind(config(**settings), CHANNEL, motion_model(MotionConfig(**motion), 2, True),
                vehicles, 2, np.random.default_rng(1))


def listen(positions: list[tuple[float, float]], vehicles: int = 1, **fields: object
           ) -> Observation:
    observation = Observation.empty(vehicles, len(positions), 2, 1.0)
    observation.sender[:] = np.arange(len(positions))
    observation.position[:] = positions
    for name, value in fields.items():
        getattr(observation, name)[:] = value
    return observation


def still(vehicles: int = 1) -> Motion:
    return Motion(1.0, np.zeros((vehicles, 2)), np.zeros(vehicles))


@pytest.mark.parametrize('motion', [RANDOM, ODOMETRY])
def test_the_posterior_is_that_of_the_exact_filter(motion: dict[str, Any]) -> None:
    # Between two disks' edges on one side, a relayed one on the other, and a range that weighs.
    exact = Grid(GridConfig(grid_cell=2.0, grid_x_min=-150.0, grid_x_max=150.0, grid_y_min=-150.0,
                            grid_y_max=150.0), CHANNEL,
                 motion_model(MotionConfig(**motion), 2, True), 1, 2, np.random.default_rng(1))
    boxed = make(Mcb, McbConfig, motion, min_particles=20_000, max_particles=20_000)
    draw = np.random.default_rng(2)
    for epoch in range(8):
        observation = listen([(80.0, 0.0), (0.0, 90.0), (-150.0, 0.0), (0.0, -500.0)],
                             hops=[1, 1, 2, 1], max_range=[np.nan, np.nan, np.nan, 0.0],
                             range=[np.nan, np.nan, np.nan, 530.0 + draw.normal(0, 30.0)])
        for method in (exact, boxed):
            if epoch:
                method.predict(still())
            else:
                method.start(Prior(0, np.array([20.0, 20.0]), 400.0 * np.eye(2)))
        expected, estimate = exact.update(observation), boxed.update(observation)
    # 20 to 30 m wide, of 20 000 particles.
    np.testing.assert_allclose(estimate.mean, expected.mean, atol=0.8)
    np.testing.assert_allclose(np.sqrt(np.diagonal(estimate.covariance, axis1=1, axis2=2)),
                               np.sqrt(np.diagonal(expected.covariance, axis1=1, axis2=2)),
                               atol=0.8)


def test_fewer_draws_are_needed_than_by_mcl_where_the_motion_leads_far() -> None:
    # A lens of 40 m within a motion disk of 200 m.
    draws = {}
    for kind, config in ((Mcl, MclConfig), (Mcb, McbConfig)):
        filter_ = make(kind, config, {'motion_model': 'random', 'max_speed': 200.0}, 40,
                       max_redraws=1000)
        for vehicle in range(40):
            filter_.start(Prior(vehicle, np.zeros(2), 25.0 * np.eye(2)))
        filter_.predict(still(40))
        filter_.update(listen([(-80.0, 0.0), (80.0, 0.0)], 40))
        assert (filter_.draws >= 50).all()
        draws[kind] = filter_.draws.mean() - 50  # the prediction is tried by both
    assert draws[Mcb] < 0.12 * draws[Mcl]


def test_a_vehicle_whose_motion_box_misses_the_anchor_box_starts_anew() -> None:
    filter_ = make(Mcb, McbConfig, RANDOM, 2)
    for vehicle, x in enumerate((500.0, 50.0)):
        filter_.start(Prior(vehicle, np.array([x, 0.0]), np.eye(2)))
    filter_.predict(still(2))
    estimate = filter_.update(listen([(0.0, 0.0)], 2))
    np.testing.assert_array_equal(estimate.reinitialized, [True, False])


def test_references_without_a_range_leave_boxes_unbounded() -> None:
    filter_ = make(Mcb, McbConfig, RANDOM)
    filter_.start(Prior(0, np.zeros(2), 25.0 * np.eye(2)))
    filter_.predict(still())
    estimate = filter_.update(listen([(1e4, 0.0)], max_range=0.0, range=1e4, range_std=1.0))
    assert np.abs(estimate.mean).max() < 60
